//! One query per element over the element's own tokens.

use super::{
    View,
    attention::{dot, softmax},
};

pub(super) fn token_pool(
    u: View<'_>,
    tokens_of: View<'_>,
    heads: usize,
    tokens: usize,
    scale: f32,
) -> Vec<f32> {
    let depth = tokens_of.channels;
    let mut y = Vec::with_capacity(u.rows * u.channels);
    for row in 0..u.rows {
        for head in 0..heads {
            let query = &u.row(row)[head * depth..][..depth];
            let scores: Vec<f64> = (0..tokens)
                .map(|token| f64::from(scale) * dot(query, tokens_of.row(row * tokens + token)))
                .collect();
            let weights = softmax(&scores);
            for channel in 0..depth {
                let sum: f64 = (0..tokens)
                    .map(|token| {
                        weights[token] * f64::from(tokens_of.row(row * tokens + token)[channel])
                    })
                    .sum();
                y.push(sum as f32);
            }
        }
    }
    y
}
