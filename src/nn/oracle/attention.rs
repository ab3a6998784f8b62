//! Multi-head attention.

use super::View;

/// Softmax of scores; `NEG_INFINITY` takes no part. All zero when nothing takes part.
pub(super) fn softmax(scores: &[f64]) -> Vec<f64> {
    let largest = scores.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
    if largest == f64::NEG_INFINITY {
        return vec![0.0; scores.len()];
    }
    let weights: Vec<f64> = scores.iter().map(|&s| libm::exp(s - largest)).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|w| w / sum).collect()
}

/// Scalar product.
pub(super) fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(&a, &b)| f64::from(a) * f64::from(b))
        .sum()
}

pub(super) fn attention(
    q: View<'_>,
    k: View<'_>,
    v: View<'_>,
    keep: Option<View<'_>>,
    heads: usize,
    scale: f32,
) -> Vec<f32> {
    let (depth, width) = (q.channels / heads, v.channels / heads);
    let mut y = Vec::with_capacity(q.rows * v.channels);
    for row in 0..q.rows {
        for head in 0..heads {
            let query = &q.row(row)[head * depth..][..depth];
            let scores: Vec<f64> = (0..k.rows)
                .map(|key| {
                    let takes_part = keep.is_none_or(|keep| keep.row(key)[0] > 0.0);
                    let score = f64::from(scale) * dot(query, &k.row(key)[head * depth..][..depth]);
                    if takes_part { score } else { f64::NEG_INFINITY }
                })
                .collect();
            let weights = softmax(&scores);
            for channel in head * width..(head + 1) * width {
                let sum: f64 = (0..k.rows)
                    .map(|key| weights[key] * f64::from(v.row(key)[channel]))
                    .sum();
                y.push(sum as f32);
            }
        }
    }
    y
}
