//! What is believed about an unknown focal length while the search goes on.

use crate::math::Rng;
use crate::math::elementary::{exp, ln};

/// Focal lengths considered, relative to the larger image side.
const RANGE: (f64, f64) = (0.3, 4.0);
const NUM_BINS: usize = 24;

/// Weights of bins of ln f.
#[derive(Debug, Clone, Copy)]
pub(super) struct FocalBelief {
    weights: [f64; NUM_BINS],
}

/// Whether a focal length, relative to the larger image side, is considered.
pub(super) fn is_considered(focal: f64) -> bool {
    focal > RANGE.0 && focal < RANGE.1
}

fn ln_at(position: f64) -> f64 {
    let (low, high) = (ln(RANGE.0), ln(RANGE.1));
    low + (high - low) * position / NUM_BINS as f64
}

impl FocalBelief {
    /// Log-normal; 1.2 times the larger side is typical for photographs.
    pub(super) fn of_photographs() -> Self {
        Self {
            weights: core::array::from_fn(|i| {
                let z = (ln_at(i as f64 + 0.5) - ln(1.2)) / 0.6;
                exp(-0.5 * z * z) + 0.05
            }),
        }
    }

    /// A focal length relative to the larger image side.
    pub(super) fn draw(&self, rng: &mut Rng) -> f64 {
        let total: f64 = self.weights.iter().sum();
        let mut pick = rng.uniform() * total;
        let mut bin = NUM_BINS - 1;
        for (i, w) in self.weights.iter().enumerate() {
            if pick < *w {
                bin = i;
                break;
            }
            pick -= w;
        }
        exp(ln_at(bin as f64 + rng.uniform()))
    }

    /// A model was found with this focal length.
    pub(super) fn found(&mut self, focal: f64) {
        let position = (ln(focal) - ln(RANGE.0)) / (ln(RANGE.1) - ln(RANGE.0)) * NUM_BINS as f64;
        for (i, w) in self.weights.iter_mut().enumerate() {
            let z = i as f64 + 0.5 - position;
            *w += 0.5 * exp(-0.5 * z * z);
        }
    }
}
