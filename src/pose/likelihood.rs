//! The likelihood of a correspondence: inliers follow a bivariate Student-t, outliers are uniform.
//!
//! `sigma^2 = (px_factor sigma_px)^2 + (f sigma_world / depth)^2`; odds are those of inlier over outlier.

use crate::math::elementary::ln;

/// Degrees of freedom of the Student-t. Regressed coordinates have tails between those of 3 and 4, and with 4 the density
/// is the inverse cube of `1 + r^2 / (4 sigma^2)`: no transcendental function for each correspondence.
pub(super) const TAIL: f64 = 4.0;

/// Odds of being an inlier below which a correspondence has no say.
pub(super) const NEGLIGIBLE: f64 = 1e-7;

/// The noise model of the full loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Factor on the standard deviations of the pixels.
    pub(super) px_factor: f64,
    /// Of a world coordinate whose own sigma is unknown, normalised units.
    pub(super) world_sigma: f64,
    /// Added to the prior logits of points and lines: the network's overall optimism.
    pub(super) point_offset: f64,
    pub(super) line_offset: f64,
    /// Squared number of standard deviations beyond which a correspondence takes no part.
    pub(super) gate_sq: f64,
    /// Factor on all standard deviations, for annealing.
    pub(super) inflation: f64,
}

/// Variance of one correspondence and its odds of being an inlier at zero residual; variance 0 marks one that takes no part.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frozen {
    pub(super) variance: f64,
    pub(super) odds: f64,
}

/// ln of a product of many factors of at least one, with few logarithms.
#[derive(Debug, Clone, Copy)]
pub(super) struct LnProduct {
    product: f64,
    sum: f64,
}

impl LnProduct {
    pub(super) fn new() -> Self {
        Self {
            product: 1.0,
            sum: 0.0,
        }
    }

    #[inline]
    pub(super) fn multiply(&mut self, factor: f64) {
        self.product *= factor;
        if self.product > 1e150 {
            self.sum += ln(self.product);
            self.product = 1.0;
        }
    }

    pub(super) fn ln(self) -> f64 {
        self.sum + ln(self.product)
    }
}

/// Odds of being an inlier, and the weight in the normal equations for an inlier.
#[inline]
pub(super) fn student(odds: f64, r_sq: f64, variance: f64) -> (f64, f64) {
    let t = 1.0 + r_sq / (TAIL * variance);
    let odds = odds / (t * t * t);
    (odds, (TAIL + 2.0) / (TAIL * t * variance))
}

/// Odds at zero residual: prior odds over the densities of inlier and outlier.
#[inline]
pub(super) fn odds_at_zero(prior_odds: f64, variance: f64, null_density: f64) -> f64 {
    prior_odds / (core::f64::consts::TAU * variance * null_density)
}

pub(super) fn probability(odds: f64) -> f64 {
    odds / (1.0 + odds)
}

/// Change of the common logit that moves the expected number of inliers towards the found one; bounded for few items.
pub(super) fn share_step(found: f64, expected: f64, count: usize) -> f64 {
    if count == 0 {
        return 0.0;
    }
    let n = count as f64;
    // One pseudo-count on each side keeps an empty kind from running away.
    let odds = |x: f64| ln((x + 0.5) / (n - x + 0.5));
    (odds(found) - odds(expected)).clamp(-2.0, 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_weight_is_the_derivative_of_its_gain() {
        let gain = |r_sq: f64| (1.0 + student(150.0, r_sq, 2.0).0).ln();
        for r_sq in [0.5, 4.0, 30.0, 200.0] {
            let h = 1e-5;
            let (odds, weight) = student(150.0, r_sq, 2.0);
            let weight = weight * probability(odds);
            let numeric = (gain(r_sq + h) - gain(r_sq - h)) / (2.0 * h);
            assert!((numeric + 0.5 * weight).abs() < 1e-5 * (1.0 + weight));
        }
    }

    #[test]
    fn ln_product_is_the_sum_of_logarithms() {
        let mut product = LnProduct::new();
        let mut sum = 0.0;
        for i in 0..2_000 {
            let factor = 1.0 + f64::from(i * i);
            product.multiply(factor);
            sum += factor.ln();
        }
        assert!((product.ln() - sum).abs() < 1e-9 * sum);
    }
}
