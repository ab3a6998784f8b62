//! Reading a picture between its cells.

use super::View;
use crate::nn::op::{AxisMap, Filter};

/// Parameter of the cubic convolution kernel.
const CUBIC: f64 = -0.75;

/// Weight of a cell at a distance, for the cubic convolution kernel.
fn cubic_weight(distance: f64) -> f64 {
    let d = distance.abs();
    if d <= 1.0 {
        ((CUBIC + 2.0) * d - (CUBIC + 3.0)) * d * d + 1.0
    } else if d < 2.0 {
        ((d - 5.0) * d + 8.0) * d * CUBIC - 4.0 * CUBIC
    } else {
        0.0
    }
}

/// First cell and the weights of the cells from there on.
fn taps(filter: Filter, map: AxisMap, coordinate: f32) -> (isize, Vec<f64>) {
    let index = f64::from(map.scale) * f64::from(coordinate) + f64::from(map.offset);
    // Far outside every cell is zero; the bound only keeps the conversion in range.
    let index = index.clamp(-1e6, 1e6);
    let low = index.floor();
    let fraction = index - low;
    match filter {
        Filter::Bilinear => (low as isize, vec![1.0 - fraction, fraction]),
        Filter::Bicubic => {
            let weights = (-1..3)
                .map(|cell| cubic_weight(fraction - f64::from(cell)))
                .collect();
            (low as isize - 1, weights)
        }
    }
}

pub(super) fn sample(
    x: View<'_>,
    positions: View<'_>,
    filter: Filter,
    map_x: AxisMap,
    map_y: AxisMap,
) -> Vec<f32> {
    let mut y = Vec::with_capacity(positions.rows * x.channels);
    for row in 0..positions.rows {
        let (first_x, weights_x) = taps(filter, map_x, positions.row(row)[0]);
        let (first_y, weights_y) = taps(filter, map_y, positions.row(row)[1]);
        for channel in 0..x.channels {
            let mut sum = 0.0;
            for (dy, wy) in weights_y.iter().enumerate() {
                for (dx, wx) in weights_x.iter().enumerate() {
                    sum += wy * wx * x.pixel(first_y + dy as isize, first_x + dx as isize, channel);
                }
            }
            y.push(sum as f32);
        }
    }
    y
}
