//! Soft choice among anchors, with statistics of the choice.

use super::{
    View,
    attention::{dot, softmax},
};

pub(super) fn soft_choice(
    x: View<'_>,
    keys: &[f32],
    values: &[f32],
    width: usize,
    sharpness: f32,
) -> [Vec<f32>; 2] {
    let anchors = keys.len() / x.channels;
    let (mut chosen, mut statistics) = (Vec::new(), Vec::new());
    for row in 0..x.rows {
        let similarities: Vec<f64> = keys
            .chunks_exact(x.channels)
            .map(|key| dot(x.row(row), key))
            .collect();
        let scores: Vec<f64> = similarities
            .iter()
            .map(|s| s * f64::from(sharpness))
            .collect();
        let weights = softmax(&scores);
        let mean: Vec<f64> = (0..width)
            .map(|channel| {
                (0..anchors)
                    .map(|a| weights[a] * f64::from(values[a * width + channel]))
                    .sum()
            })
            .collect();
        let mut ranked = similarities;
        ranked.sort_unstable_by(f64::total_cmp);
        ranked.reverse();
        let (best, second) = (ranked[0], *ranked.get(1).unwrap_or(&ranked[0]));
        let entropy: f64 = weights
            .iter()
            .filter(|&&p| p > 0.0)
            .map(|&p| -p * libm::log(p))
            .sum();
        let spread: f64 = (0..anchors)
            .map(|a| {
                let offset =
                    |channel: usize| f64::from(values[a * width + channel]) - mean[channel];
                weights[a]
                    * (0..width)
                        .map(|channel| offset(channel) * offset(channel))
                        .sum::<f64>()
            })
            .sum();
        chosen.extend(mean.iter().map(|&m| m as f32));
        statistics.extend([best, second, best - second, entropy, spread.sqrt()].map(|s| s as f32));
    }
    [chosen, statistics]
}
