//! Bilinear resize with half-pixel centres.

use super::View;
use crate::nn::shape::Grid;

/// The two neighbours of an output position and the weight of the second one.
pub(super) fn neighbours(out_index: usize, out_size: usize, in_size: usize) -> (usize, usize, f64) {
    let position = (out_index as f64 + 0.5) * in_size as f64 / out_size as f64 - 0.5;
    let position = position.clamp(0.0, (in_size - 1) as f64);
    let low = position.floor() as usize;
    (low, (low + 1).min(in_size - 1), position - low as f64)
}

pub(super) fn resize(x: View<'_>, addend: Option<View<'_>>, out_grid: Grid) -> Vec<f32> {
    let mut y = Vec::with_capacity(out_grid.pixels() * x.channels);
    for out_y in 0..out_grid.height {
        let (y0, y1, fy) = neighbours(out_y, out_grid.height, x.grid.height);
        for out_x in 0..out_grid.width {
            let (x0, x1, fx) = neighbours(out_x, out_grid.width, x.grid.width);
            for channel in 0..x.channels {
                let at = |y: usize, x_: usize| f64::from(x.row(y * x.grid.width + x_)[channel]);
                let top = at(y0, x0) * (1.0 - fx) + at(y0, x1) * fx;
                let bottom = at(y1, x0) * (1.0 - fx) + at(y1, x1) * fx;
                let sum = addend.map_or(0.0, |addend| {
                    f64::from(addend.row(out_y * out_grid.width + out_x)[channel])
                });
                y.push((top * (1.0 - fy) + bottom * fy + sum) as f32);
            }
        }
    }
    y
}
