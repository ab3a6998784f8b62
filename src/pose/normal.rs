//! Normal equations of a pose and a focal length: seven unknowns, of which the last may be fixed.

use super::residuals::Row;
use nalgebra::{SMatrix, SVector};

pub(super) type Matrix7 = SMatrix<f64, 7, 7>;
pub(super) type Vector7 = SVector<f64, 7>;

/// Normal equations `h step = -g` and the loss.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normal {
    pub(super) h: Matrix7,
    pub(super) g: Vector7,
    pub(super) cost: f64,
}

impl Normal {
    pub(super) fn new() -> Self {
        Self {
            h: Matrix7::zeros(),
            g: Vector7::zeros(),
            cost: 0.0,
        }
    }

    #[inline]
    #[expect(
        clippy::needless_range_loop,
        reason = "two indices over three arrays read as the formula"
    )]
    pub(super) fn add<const D: usize>(&mut self, rows: &[Row; 2], r: &[f64; 2], weight: f64) {
        for (row, r) in rows.iter().zip(r) {
            for i in 0..D {
                let wi = weight * row[i];
                self.g[i] += wi * r;
                for j in i..D {
                    // Column-major upper triangle.
                    self.h[(i, j)] += wi * row[j];
                }
            }
        }
    }

    pub(super) fn add_residual(&mut self, row: &Row, r: f64) {
        self.add::<7>(&[*row, [0.0; 7]], &[r, 0.0], 1.0);
        self.cost += 0.5 * r * r;
    }

    pub(super) fn mirror(&mut self) {
        for i in 0..7 {
            for j in 0..i {
                self.h[(i, j)] = self.h[(j, i)];
            }
        }
    }

    /// Damped step; unused columns (an empty diagonal) stay put.
    pub(super) fn step(&self, lambda: f64) -> Option<Row> {
        let mut h = self.h;
        let floor = 1e-12 * h.trace();
        for i in 0..7 {
            let d = h[(i, i)];
            h[(i, i)] = if d > 0.0 {
                d + lambda * d.max(floor)
            } else {
                1.0
            };
        }
        let step = -h.cholesky()?.solve(&self.g);
        step.iter()
            .all(|s| s.is_finite())
            .then(|| core::array::from_fn(|i| step[i]))
    }
}
