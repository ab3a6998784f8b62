//! Linear layers.

use super::{View, activate};
use crate::nn::op::Activation;

pub(super) fn linear(
    x: View<'_>,
    weight: &[f32],
    bias: Option<&[f32]>,
    residual: Option<View<'_>>,
    groups: usize,
    out: usize,
    activation: Activation,
) -> Vec<f32> {
    let depth = x.channels / groups;
    let mut y = Vec::with_capacity(x.rows * out);
    for row in 0..x.rows {
        for channel in 0..out {
            let group = channel / (out / groups);
            let inputs = &x.row(row)[group * depth..][..depth];
            let weights = &weight[channel * depth..][..depth];
            let product: f64 = inputs
                .iter()
                .zip(weights)
                .map(|(&a, &b)| f64::from(a) * f64::from(b))
                .sum();
            let sum = product
                + bias.map_or(0.0, |bias| f64::from(bias[channel]))
                + residual.map_or(0.0, |residual| f64::from(residual.row(row)[channel]));
            y.push(activate(activation, sum) as f32);
        }
    }
    y
}
