//! The likelihood of a correspondence: inliers follow a bivariate Student-t, outliers are uniform.
//!
//! `sigma^2 = (px_factor sigma_px)^2 + (f sigma_world / depth)^2`; odds are those of inlier over outlier.

use crate::math::elementary::ln;

/// Degrees of freedom of the Student-t. Regressed coordinates have tails between those of 3 and 4, and with 4 the density
/// is the inverse cube of `1 + r^2 / (4 sigma^2)`: no transcendental function for each correspondence.
pub(super) const TAIL: f64 = 4.0;

/// Odds of being an inlier below which a correspondence has no say.
pub(super) const NEGLIGIBLE: f64 = 1e-7;

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

/// Odds at zero residual: prior odds over the densities of inlier and outlier.
#[inline]
pub(super) fn odds_at_zero(prior_odds: f64, variance: f64, null_density: f64) -> f64 {
    prior_odds / (core::f64::consts::TAU * variance * null_density)
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
