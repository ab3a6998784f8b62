//! 3x3 convolutions.

use super::{View, activate};
use crate::nn::{op::Activation, shape::Grid};

pub(super) fn conv3x3(
    x: View<'_>,
    weight: &[f32],
    bias: Option<&[f32]>,
    residual: Option<View<'_>>,
    stride: usize,
    out_grid: Grid,
    activation: Activation,
) -> Vec<f32> {
    let out = weight.len() / (9 * x.channels);
    let mut y = Vec::with_capacity(out_grid.pixels() * out);
    for out_y in 0..out_grid.height {
        for out_x in 0..out_grid.width {
            for channel in 0..out {
                let mut sum = bias.map_or(0.0, |bias| f64::from(bias[channel]));
                for input in 0..x.channels {
                    for tap_y in 0..3 {
                        for tap_x in 0..3 {
                            let w =
                                weight[((channel * x.channels + input) * 3 + tap_y) * 3 + tap_x];
                            let in_y = (out_y * stride + tap_y) as isize - 1;
                            let in_x = (out_x * stride + tap_x) as isize - 1;
                            sum += f64::from(w) * x.pixel(in_y, in_x, input);
                        }
                    }
                }
                if let Some(residual) = residual {
                    sum += f64::from(residual.row(out_y * out_grid.width + out_x)[channel]);
                }
                y.push(activate(activation, sum) as f32);
            }
        }
    }
    y
}
