//! Softmax over the places of a cell and "nowhere", laid out as a picture.

use super::View;

pub(super) fn detector_heat(x: View<'_>, block: usize) -> Vec<f32> {
    let width = x.grid.width * block;
    let mut y = vec![0.0; x.rows * block * block];
    for row in 0..x.rows {
        let logits = x.row(row);
        let largest = logits.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        let weights: Vec<f64> = logits
            .iter()
            .map(|&z| libm::exp(f64::from(z) - f64::from(largest)))
            .collect();
        let sum: f64 = weights.iter().sum();
        for (place, weight) in weights[..block * block].iter().enumerate() {
            let out_y = row / x.grid.width * block + place / block;
            let out_x = row % x.grid.width * block + place % block;
            y[out_y * width + out_x] = (weight / sum) as f32;
        }
    }
    y
}
