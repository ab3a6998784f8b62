//! Activations and sums.

use super::View;
use crate::nn::op::Activation;

/// The activation of one number.
pub fn activate(activation: Activation, x: f64) -> f64 {
    match activation {
        Activation::None => x,
        Activation::Relu => x.max(0.0),
        Activation::Gelu => 0.5 * x * (1.0 + libm::erf(x * std::f64::consts::FRAC_1_SQRT_2)),
        Activation::Sigmoid => 1.0 / (1.0 + libm::exp(-x)),
    }
}

pub(super) fn map(x: View<'_>, activation: Activation) -> Vec<f32> {
    let numbers = (0..x.rows).flat_map(|row| x.row(row));
    numbers
        .map(|&number| activate(activation, f64::from(number)) as f32)
        .collect()
}

pub(super) fn add(a: View<'_>, b: View<'_>, activation: Activation) -> Vec<f32> {
    (0..a.rows)
        .flat_map(|row| a.row(row).iter().zip(b.row(row)))
        .map(|(&a, &b)| activate(activation, f64::from(a) + f64::from(b)) as f32)
        .collect()
}
