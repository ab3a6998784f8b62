//! What the noise is, from the residuals themselves.
//!
//! The same solver serves networks whose predictions are centimetres off, landmarks that are tenths of a pixel off, and matches
//! of which half are near misses: the landmark beside the right one. So the inliers of each kind follow a mixture of two
//! bivariate Student-t distributions, exact ones and near misses, whose scales, shares and dependence on depth maximise the
//! likelihood (expectation maximisation, in the spirit of MAGSAC++ and sigma-consensus: Barath et al., CVPR 2020). Exact ones
//! then decide the pose where there are any, and near misses count where there is nothing better.
//! Input: residuals near a model. Output: [`KindNoise`]. No allocation after warm-up.

use super::likelihood::{LnProduct, TAIL, odds_at_zero, share_step};
use crate::math::elementary::{exp, ln};
use crate::math::stats::median_in_place;

/// How much of the noise lies in the world where no correspondence says so: standard deviation at the median depth, relative
/// to that of the pixels.
const WORLD_SHARES: [f64; 3] = [0.0, 1.0, 4.0];

/// Exact correspondences are that exact, as factors on their standard deviation.
const EXACT_RANGE: (f64, f64) = (0.3, 40.0);

/// Near misses are that much wider than exact ones.
const NEAR_RANGE: (f64, f64) = (2.5, 16.0);

/// Correspondences with a factor of one that are taken to have been seen before: few cannot tell the scale.
const PRIOR_COUNT: f64 = 2.0;

/// Points and lines of a network are off by about as much: each counts so many of the other's.
const TIE_COUNT: f64 = 2.0;

/// Exact ones and near misses that are taken to have been seen before.
const SEEN_EXACT: f64 = 6.0;
const SEEN_NEAR: f64 = 14.0;

/// Log likelihood by which noise in the world is preferred to noise of the pixels alone: it is there nearly always, and few
/// correspondences cannot tell.
const WORLD_PREFERENCE: f64 = 3.0;

/// Median of a chi-square with two degrees of freedom.
const MEDIAN_CHI_SQ: f64 = 1.386;

/// Near misses are assumed where the log likelihood says so that clearly. On problems without any it gains 0 to 10.
const MIXTURE_GAIN: f64 = 10.0;

/// Steps of expectation maximisation when the noise is first looked at, and later.
const FIRST_STEPS: usize = 8;
const LATER_STEPS: usize = 4;

/// Noise of one kind of correspondence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct KindNoise {
    /// Factor on the standard deviations of exact correspondences.
    pub(super) factor: f64,
    /// Near misses are so many times wider, and this is the share of exact ones among the inliers.
    pub(super) near: f64,
    pub(super) exact_share: f64,
    /// Of world coordinates without an own standard deviation, before the factor; normalised units.
    pub(super) world_sigma: f64,
    /// Added to the prior logits: the network's overall optimism.
    pub(super) offset: f64,
}

/// The noise model of the full loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    pub(super) points: KindNoise,
    pub(super) lines: KindNoise,
    /// Squared number of standard deviations of a near miss beyond which a correspondence takes no part.
    pub(super) gate_sq: f64,
    /// Factor on all standard deviations, for annealing.
    pub(super) inflation: f64,
}

impl Default for KindNoise {
    fn default() -> Self {
        Self::exact(1.0)
    }
}

impl KindNoise {
    /// Exact ones only, with the given factor.
    pub(super) fn exact(factor: f64) -> Self {
        Self {
            factor,
            near: NEAR_RANGE.0,
            exact_share: 1.0,
            world_sigma: 0.0,
            offset: 0.0,
        }
    }

    /// Where the estimation begins.
    pub(super) fn start(factor: f64) -> Self {
        Self {
            near: 4.0,
            exact_share: 0.5,
            ..Self::exact(factor)
        }
    }

    /// Variance of an exact correspondence in square pixels.
    #[inline]
    pub(super) fn variance(&self, sigma_px: f64, sigma_world: f64, gain_sq: f64) -> f64 {
        self.factor * self.factor * unit(self.world_sigma, sigma_px, sigma_world, gain_sq)
    }

    /// Whether some are exact and others near misses.
    pub(super) fn has_near_misses(&self) -> bool {
        self.exact_share < 1.0
    }

    /// Odds of an inlier and its weight in the normal equations, from the odds at zero residual of an exact one.
    #[inline]
    pub(super) fn student(&self, odds: f64, r_sq: f64, variance: f64) -> (f64, f64) {
        let (exact, near) = self.parts(r_sq, variance);
        let any = odds * (exact.0 + near.0);
        (
            any,
            odds * (exact.0 * exact.1 + near.0 * near.1) / any.max(f64::MIN_POSITIVE),
        )
    }

    /// Density relative to an exact one at zero residual, and weight, of exact ones and of near misses.
    #[inline]
    fn parts(&self, r_sq: f64, variance: f64) -> ((f64, f64), (f64, f64)) {
        let of = |share: f64, variance: f64| {
            let t = 1.0 + r_sq / (TAIL * variance);
            (share / (t * t * t), (TAIL + 2.0) / (TAIL * t * variance))
        };
        let near_sq = self.near * self.near;
        (
            of(self.exact_share, variance),
            of((1.0 - self.exact_share) / near_sq, variance * near_sq),
        )
    }
}

/// Variance before the factor.
#[inline]
fn unit(world: f64, sigma_px: f64, sigma_world: f64, gain_sq: f64) -> f64 {
    let s = if sigma_world > 0.0 {
        sigma_world
    } else {
        world
    };
    sigma_px * sigma_px + gain_sq * s * s
}

/// A correspondence near the model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    pub(super) r_sq: f64,
    /// (f / depth)^2
    pub(super) gain_sq: f64,
    /// Prior odds of being an inlier.
    pub(super) odds: f64,
    pub(super) sigma: f64,
    pub(super) sigma_px: f64,
}

/// Residuals of one kind near a model.
#[derive(Debug, Default)]
pub(super) struct Residuals {
    pub(super) near: Vec<Near>,
    /// Prior odds of those that are too far off to be inliers.
    pub(super) far: Vec<f64>,
    /// Density of the residual of an outlier.
    pub(super) null: f64,
}

/// Sums of one step of expectation maximisation, and the log likelihood ratio before it.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    exact: f64,
    near: f64,
    /// Squared residuals in units of the variance before the factors, weighted.
    exact_sq: f64,
    near_sq: f64,
    expected: f64,
    value: f64,
}

impl Residuals {
    /// Empty, with room for so many.
    pub(super) fn clear(&mut self, null: f64, count: usize) {
        self.near.clear();
        self.near.reserve(count);
        self.far.clear();
        self.far.reserve(count);
        self.null = null;
    }

    fn sums(&self, noise: &KindNoise) -> Sums {
        let prior_factor = exp(noise.offset);
        let (mut gain, mut loss) = (LnProduct::new(), LnProduct::new());
        let mut sums = Sums::default();
        for n in &self.near {
            let prior = prior_factor * n.odds;
            sums.expected += prior / (1.0 + prior);
            let v = noise.variance(n.sigma_px, n.sigma, n.gain_sq);
            let (a, b) = noise.parts(n.r_sq, v);
            let odds = odds_at_zero(prior, v, self.null);
            let any = odds * (a.0 + b.0);
            gain.multiply(1.0 + any);
            loss.multiply(1.0 + prior);
            let scale = odds / (1.0 + any);
            let (pa, pb) = (scale * a.0, scale * b.0);
            sums.exact += pa;
            sums.near += pb;
            sums.exact_sq += pa * a.1 * n.r_sq;
            sums.near_sq += pb * b.1 * n.r_sq;
        }
        for odds in &self.far {
            let prior = prior_factor * odds;
            sums.expected += prior / (1.0 + prior);
            loss.multiply(1.0 + prior);
        }
        let f_sq = noise.factor * noise.factor;
        sums.exact_sq *= f_sq;
        sums.near_sq *= f_sq * noise.near * noise.near;
        sums.value = gain.ln() - loss.ln();
        sums
    }

    /// One step of expectation maximisation. The log likelihood ratio before it.
    fn step(&self, noise: &mut KindNoise, (tie_count, tie_factor): (f64, f64)) -> f64 {
        let sums = self.sums(noise);
        let factor_sq = (sums.exact_sq + 2.0 * tie_count * tie_factor * tie_factor)
            / (2.0 * (sums.exact + tie_count));
        let mut ln_prior = 0.0;
        noise.factor = factor_sq.sqrt().clamp(EXACT_RANGE.0, EXACT_RANGE.1);
        if noise.has_near_misses() {
            let wide_sq = sums.near_sq / (2.0 * sums.near).max(1e-9);
            noise.near = (wide_sq.sqrt() / noise.factor).clamp(NEAR_RANGE.0, NEAR_RANGE.1);
            let old = noise.exact_share;
            let prior_exact = SEEN_EXACT / (SEEN_EXACT + SEEN_NEAR);
            noise.exact_share =
                (sums.exact + SEEN_EXACT) / (sums.exact + sums.near + SEEN_EXACT + SEEN_NEAR);
            ln_prior = SEEN_EXACT * ln(old / prior_exact)
                + SEEN_NEAR * ln((1.0 - old) / (1.0 - prior_exact));
        }
        let count = self.near.len() + self.far.len();
        noise.offset += share_step(sums.exact + sums.near, sums.expected, count);
        sums.value + ln_prior
    }
}

/// Both kinds.
#[derive(Debug, Default)]
pub(super) struct NoiseFit {
    pub(super) points: Residuals,
    pub(super) lines: Residuals,
    values: Vec<f64>,
}

impl NoiseFit {
    /// Median over both kinds.
    fn median(&mut self, value: impl Fn(&Near) -> Option<f64>) -> Option<f64> {
        self.values.clear();
        self.values
            .reserve(self.points.near.capacity() + self.lines.near.capacity());
        let all = self.points.near.iter().chain(&self.lines.near);
        self.values.extend(all.filter_map(value));
        median_in_place(&mut self.values)
    }

    /// Tries how much of the noise lies in the world and whether there are near misses, and improves what is best.
    pub(super) fn choose(&mut self, noise: &mut Noise, core_limit: f64) {
        let Some(gain_sq) = self.median(|n| Some(n.gain_sq)) else {
            return;
        };
        let px = self.median(|n| Some(n.sigma_px)).unwrap_or(1.0);
        let mut best: Option<(f64, [(f64, KindNoise); 2])> = None;
        let (mut two_points, mut two_lines) = (None::<(f64, KindNoise)>, None::<(f64, KindNoise)>);
        for share in WORLD_SHARES {
            let world_sigma = share * px / gain_sq.sqrt();
            let core = self.median(|n| {
                (n.r_sq < core_limit)
                    .then(|| n.r_sq / unit(world_sigma, n.sigma_px, n.sigma, n.gain_sq))
            });
            let factor = (core.unwrap_or(MEDIAN_CHI_SQ) / MEDIAN_CHI_SQ).sqrt();
            let with = |kind: KindNoise, offset: f64| KindNoise {
                world_sigma,
                offset,
                ..kind
            };
            let mut one = [
                with(KindNoise::exact(factor), noise.points.offset),
                with(KindNoise::exact(factor), noise.lines.offset),
            ];
            let mut values = [0.0; 2];
            for _ in 0..FIRST_STEPS {
                let ties = [one[1].factor, one[0].factor];
                values[0] = self.points.step(&mut one[0], (TIE_COUNT, ties[0]));
                values[1] = self.lines.step(&mut one[1], (TIE_COUNT, ties[1]));
            }
            let preference = if share > 0.0 { WORLD_PREFERENCE } else { 0.0 };
            let value = values[0] + values[1] + preference;
            if best.is_none_or(|(v, _)| value > v) {
                best = Some((value, [(values[0], one[0]), (values[1], one[1])]));
            }
            for (residuals, two, offset) in [
                (&self.points, &mut two_points, noise.points.offset),
                (&self.lines, &mut two_lines, noise.lines.offset),
            ] {
                let mut trial = with(KindNoise::start(1.0 / (1.0 + share * share).sqrt()), offset);
                let mut value = 0.0;
                for _ in 0..FIRST_STEPS {
                    value = residuals.step(&mut trial, (PRIOR_COUNT, 1.0));
                }
                if two.is_none_or(|(v, _)| value > v) {
                    *two = Some((value, trial));
                }
            }
        }
        let Some((_, [points, lines])) = best else {
            return;
        };
        for (kind, one, two) in [
            (&mut noise.points, points, two_points),
            (&mut noise.lines, lines, two_lines),
        ] {
            *kind = match two {
                Some((value, two)) if value > one.0 + MIXTURE_GAIN => two,
                _ => one.1,
            };
        }
    }

    /// Improves what was chosen.
    pub(super) fn improve(&mut self, noise: &mut Noise) {
        for _ in 0..LATER_STEPS {
            let are_alike = !noise.points.has_near_misses() && !noise.lines.has_near_misses();
            let tie = |own: &KindNoise, other: &KindNoise| {
                if own.has_near_misses() {
                    (PRIOR_COUNT, 1.0)
                } else if are_alike {
                    (TIE_COUNT, other.factor)
                } else {
                    (PRIOR_COUNT, own.factor)
                }
            };
            let ties = (
                tie(&noise.points, &noise.lines),
                tie(&noise.lines, &noise.points),
            );
            self.points.step(&mut noise.points, ties.0);
            self.lines.step(&mut noise.lines, ties.1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn the_weight_is_the_derivative_of_the_gain() {
        for exact_share in [0.3, 1.0] {
            let noise = KindNoise {
                exact_share,
                ..KindNoise::start(1.0)
            };
            let gain = |r_sq: f64| (1.0 + noise.student(150.0, r_sq, 2.0).0).ln();
            for r_sq in [0.5, 4.0, 30.0, 200.0] {
                let h = 1e-5;
                let (odds, weight) = noise.student(150.0, r_sq, 2.0);
                let weight = weight * odds / (1.0 + odds);
                let numeric = (gain(r_sq + h) - gain(r_sq - h)) / (2.0 * h);
                assert!((numeric + 0.5 * weight).abs() < 1e-5 * (1.0 + weight));
            }
        }
    }

    /// Residuals of exact ones, near misses and outliers; the expected factor of exact ones within a fifth.
    #[test]
    fn scales_come_from_the_residuals() {
        let mut rng = Rng::from_seed(5);
        let null = 1.0 / (640.0 * 480.0);
        for (exact_px, near_px) in [(0.6, 5.0), (1.5, 6.0), (6.0, 0.0)] {
            let mut fit = NoiseFit::default();
            fit.points.clear(null, 500);
            let mut add = |count: usize, sigma: f64| {
                for _ in 0..count {
                    let (x, y) = (sigma * rng.normal(), sigma * rng.normal());
                    fit.points.near.push(Near {
                        r_sq: x * x + y * y,
                        gain_sq: 1.0,
                        odds: 0.5,
                        sigma: 0.0,
                        sigma_px: 1.0,
                    });
                }
            };
            add(100, exact_px);
            if near_px > 0.0 {
                add(200, near_px);
            }
            fit.points.far = vec![0.5; 200];
            let mut noise = Noise {
                points: KindNoise::start(2.0),
                lines: KindNoise::start(2.0),
                gate_sq: 1.0,
                inflation: 1.0,
            };
            fit.choose(&mut noise, 144.0);
            for _ in 0..3 {
                fit.improve(&mut noise);
            }
            let noise = noise.points;
            let sigma = noise.variance(1.0, 0.0, 1.0).sqrt();
            // A Student-t with four degrees of freedom is 1.2 times narrower than the normal distribution it is fitted to.
            let ratio = sigma * 1.2 / exact_px;
            assert!(
                (0.8..1.25).contains(&ratio),
                "{exact_px} {near_px}: {noise:?}"
            );
        }
    }
}
