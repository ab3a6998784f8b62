//! Normalisation over the picture, over the channels, and to unit length.

use super::View;

/// Mean and `1 / sqrt(variance + eps)`.
fn moments(numbers: impl Iterator<Item = f64> + Clone, count: usize, eps: f32) -> (f64, f64) {
    let mean = numbers.clone().sum::<f64>() / count as f64;
    let variance = numbers.map(|x| (x - mean) * (x - mean)).sum::<f64>() / count as f64;
    (mean, 1.0 / (variance + f64::from(eps)).sqrt())
}

pub(super) fn instance_norm(x: View<'_>, eps: f32) -> Vec<f32> {
    let mut y = vec![0.0; x.rows * x.channels];
    for channel in 0..x.channels {
        let numbers = (0..x.rows).map(|row| f64::from(x.row(row)[channel]));
        let (mean, factor) = moments(numbers, x.rows, eps);
        for row in 0..x.rows {
            y[row * x.channels + channel] =
                ((f64::from(x.row(row)[channel]) - mean) * factor) as f32;
        }
    }
    y
}

pub(super) fn layer_norm(x: View<'_>, gain: &[f32], bias: &[f32], eps: f32) -> Vec<f32> {
    let mut y = Vec::with_capacity(x.rows * x.channels);
    for row in 0..x.rows {
        let (mean, factor) = moments(x.row(row).iter().map(|&x| f64::from(x)), x.channels, eps);
        for ((&x, &gain), &bias) in x.row(row).iter().zip(gain).zip(bias) {
            y.push(((f64::from(x) - mean) * factor * f64::from(gain) + f64::from(bias)) as f32);
        }
    }
    y
}

pub(super) fn l2_norm(x: View<'_>, eps: f32) -> Vec<f32> {
    let mut y = Vec::with_capacity(x.rows * x.channels);
    for row in 0..x.rows {
        let norm = x
            .row(row)
            .iter()
            .map(|&x| f64::from(x) * f64::from(x))
            .sum::<f64>()
            .sqrt();
        let divisor = norm.max(f64::from(eps));
        y.extend(x.row(row).iter().map(|&x| (f64::from(x) / divisor) as f32));
    }
    y
}
