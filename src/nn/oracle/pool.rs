//! Average and maximum of windows.

use super::View;
use crate::nn::shape::Grid;

pub(super) fn avg_pool(x: View<'_>, size: usize, out_grid: Grid) -> Vec<f32> {
    let mut y = Vec::with_capacity(out_grid.pixels() * x.channels);
    for out_y in 0..out_grid.height {
        for out_x in 0..out_grid.width {
            for channel in 0..x.channels {
                let mut sum = 0.0;
                for dy in 0..size {
                    for dx in 0..size {
                        sum += f64::from(
                            x.row((out_y * size + dy) * x.grid.width + out_x * size + dx)[channel],
                        );
                    }
                }
                y.push((sum / (size * size) as f64) as f32);
            }
        }
    }
    y
}

pub(super) fn max_pool(
    x: View<'_>,
    size: usize,
    stride: usize,
    pad: usize,
    out_grid: Grid,
) -> Vec<f32> {
    // The part of a window that lies in the picture.
    let window = |out_index: usize, in_size: usize| {
        let start = out_index * stride;
        start.saturating_sub(pad)..(start + size).saturating_sub(pad).min(in_size)
    };
    let mut y = Vec::with_capacity(out_grid.pixels() * x.channels);
    for out_y in 0..out_grid.height {
        for out_x in 0..out_grid.width {
            for channel in 0..x.channels {
                let mut best = f32::NEG_INFINITY;
                for in_y in window(out_y, x.grid.height) {
                    for in_x in window(out_x, x.grid.width) {
                        best = best.max(x.row(in_y * x.grid.width + in_x)[channel]);
                    }
                }
                y.push(best);
            }
        }
    }
    y
}
