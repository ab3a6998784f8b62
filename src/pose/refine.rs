//! Nonlinear refinement on SE(3), and on the focal length where it is unknown.
//!
//! Two losses. The quick one serves the search: a few Gauss-Newton steps with Geman-McClure weights, no transcendental
//! function. The full one is the negative log likelihood ratio of a mixture: inliers follow a bivariate Student-t with
//! `sigma^2 = sigma_px^2 + (f sigma_world / depth)^2`, outliers are uniform. The noise of the world coordinates and the
//! inlier share of each kind are estimated together with the pose (profile likelihood, expectation maximisation).
//! Damping is relative to the diagonal (Marquardt), so the unit of length does not matter. No allocation after warm-up.

use super::problem::{Model, Problem};
use super::residuals::{self, Row};
use super::scoring::evidence;
use crate::geometry::vector_from_rotation;
use crate::math::elementary::{exp, ln};
use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3};

/// Degrees of freedom of the Student-t. Regressed coordinates have tails between those of 3 and 4, and with 4 the density
/// is the inverse cube of `1 + r^2 / (4 sigma^2)`: no transcendental function for each correspondence.
const TAIL: f64 = 4.0;

/// Odds of being an inlier below which a correspondence has no say.
const NEGLIGIBLE: f64 = 1e-7;

pub(super) type Matrix7 = SMatrix<f64, 7, 7>;
pub(super) type Vector7 = SVector<f64, 7>;

/// The noise model of the full loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Of a detected pixel.
    pub(super) sigma_px: f64,
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

/// What is known besides the correspondences.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Soft {
    /// (unit gravity in the camera, unit gravity in the world, sigma in radians)
    pub(super) gravity: Option<(Vector3<f64>, Vector3<f64>, f64)>,
    /// Prior model and the information matrix of its (rotation, normalised translation).
    pub(super) prior: Option<(Model, Matrix6<f64>)>,
    /// Standard deviation of ln focal; the focal length is fixed when `None`.
    pub(super) sigma_ln_focal: Option<f64>,
}

/// Variance of one correspondence and its odds of being an inlier at zero residual; variance 0 marks one that takes no part.
#[derive(Debug, Clone, Copy)]
struct Frozen {
    variance: f64,
    odds: f64,
}

/// ln of a product of many factors of at least one, with few logarithms.
#[derive(Debug, Clone, Copy)]
struct LnProduct {
    product: f64,
    sum: f64,
}

impl LnProduct {
    fn new() -> Self {
        Self {
            product: 1.0,
            sum: 0.0,
        }
    }

    #[inline]
    fn multiply(&mut self, factor: f64) {
        self.product *= factor;
        if self.product > 1e150 {
            self.sum += ln(self.product);
            self.product = 1.0;
        }
    }

    fn ln(self) -> f64 {
        self.sum + ln(self.product)
    }
}

/// Normal equations `h step = -g` and the loss.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normal {
    pub(super) h: Matrix7,
    pub(super) g: Vector7,
    pub(super) cost: f64,
}

impl Normal {
    fn new() -> Self {
        Self {
            h: Matrix7::zeros(),
            g: Vector7::zeros(),
            cost: 0.0,
        }
    }

    #[inline]
    fn add<const D: usize>(&mut self, rows: &[Row; 2], r: &[f64; 2], weight: f64) {
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

    fn add_residual(&mut self, row: &Row, r: f64) {
        self.add::<7>(&[*row, [0.0; 7]], &[r, 0.0], 1.0);
        self.cost += 0.5 * r * r;
    }

    fn mirror(&mut self) {
        for i in 0..7 {
            for j in 0..i {
                self.h[(i, j)] = self.h[(j, i)];
            }
        }
    }

    /// Damped step; unused columns (an empty diagonal) stay put.
    fn step(&self, lambda: f64) -> Option<Row> {
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

/// A correspondence near the model, for the estimation of the noise.
#[derive(Debug, Clone, Copy)]
struct Near {
    r_sq: f64,
    /// (f / depth)^2
    gain_sq: f64,
    /// Odds of being an inlier at zero residual and unit variance.
    odds: f64,
    sigma: f64,
}

/// Buffers of the refinement.
#[derive(Debug, Default)]
pub(super) struct Refiner {
    points: Vec<Frozen>,
    lines: Vec<Frozen>,
    quick_points: Vec<f64>,
    quick_lines: Vec<f64>,
    quick_variance: (f64, f64),
    near: Vec<Near>,
    values: Vec<f64>,
}

/// Where the noise of the full refinement comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    /// The residuals.
    Estimated,
    /// The thresholds.
    Ranking,
}

/// Which of the two lists a correspondence is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Point,
    Line,
}

/// What the full refinement ends with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refined {
    pub(super) model: Model,
    pub(super) noise: Noise,
    pub(super) normal: Normal,
    /// Log likelihood ratio against "all are outliers".
    pub(super) log_ratio: f64,
}

/// Posterior odds of being an inlier, and the weight in the normal equations.
#[inline]
fn student(odds: f64, r_sq: f64, variance: f64) -> (f64, f64) {
    let t = 1.0 + r_sq / (TAIL * variance);
    let odds = odds / (t * t * t);
    let posterior = odds / (1.0 + odds);
    (odds, posterior * (TAIL + 2.0) / (TAIL * t * variance))
}

/// Odds at zero residual: prior odds over the densities of inlier and outlier.
#[inline]
fn odds_at_zero(prior_odds: f64, variance: f64, null_density: f64) -> f64 {
    prior_odds / (core::f64::consts::TAU * variance * null_density)
}

impl Refiner {
    /// Weights of the quick loss, which do not change during a search.
    pub(super) fn load(&mut self, problem: &Problem, point_sigma: f64, line_sigma: f64) {
        let (pv, lv) = (point_sigma * point_sigma, line_sigma * line_sigma);
        self.quick_variance = (pv, lv);
        self.quick_points.clear();
        self.quick_points.extend(
            problem
                .points
                .iter()
                .map(|p| evidence(p.logit, pv, problem.ln_null_point).max(0.0)),
        );
        self.quick_lines.clear();
        self.quick_lines.extend(
            problem
                .lines
                .iter()
                .map(|l| evidence(l.logit, lv, problem.ln_null_line).max(0.0)),
        );
    }

    /// Gauss-Newton steps with Geman-McClure weights, scale twice the ranking sigma first.
    pub(super) fn quick(&self, problem: &Problem, start: &Model, soft: &Soft) -> Option<Model> {
        let mut model = *start;
        for inflation in [2.0, 1.4, 1.0, 1.0] {
            let n = self.quick_normal(problem, &model, inflation, soft);
            let step = n.step(1e-6)?;
            let size: f64 = step.iter().map(|s| s * s).sum();
            if !(size < 1.0) {
                return None;
            }
            model = residuals::perturbed(&model, &step);
            if size < 1e-14 {
                break;
            }
        }
        model.is_finite().then_some(model)
    }

    fn quick_normal(
        &self,
        problem: &Problem,
        model: &Model,
        inflation: f64,
        soft: &Soft,
    ) -> Normal {
        let mut n = Normal::new();
        let (fx, fy) = (problem.fx, problem.fy);
        let has_focal = soft.sigma_ln_focal.is_some();
        // Geman-McClure with this scale has the curvature of the ranking score at zero and lets go at about its threshold.
        let scale = |variance: f64| 4.0 * variance * inflation * inflation;
        let (ps, ls) = (scale(self.quick_variance.0), scale(self.quick_variance.1));
        let mut add = |rows: [Row; 2], r: [f64; 2], weight: f64| {
            if has_focal {
                n.add::<7>(&rows, &r, weight);
            } else {
                n.add::<6>(&rows, &r, weight);
            }
        };
        for (item, weight) in problem.points.iter().zip(&self.quick_points) {
            if let Some((res, z, u)) = residuals::point(fx, fy, model, item) {
                let q = res.squared() / ps;
                if q < 6.0 {
                    let rows = residuals::point_rows(fx, fy, model, &z, &u);
                    add(rows, res.r, weight / (ps * (1.0 + q) * (1.0 + q)));
                }
            }
        }
        for (item, weight) in problem.lines.iter().zip(&self.quick_lines) {
            if let Some((res, state)) = residuals::line(fx, fy, model, item) {
                let q = res.squared() / ls;
                if q < 6.0 && residuals::overlaps(fx, fy, item, &state, model.focal) {
                    let rows = residuals::line_rows(fx, fy, model, item, &res, &state);
                    add(rows, res.r, weight / (ls * (1.0 + q) * (1.0 + q)));
                }
            }
        }
        add_soft(&mut n, model, soft);
        n.mirror();
        n
    }

    /// Full refinement: anneals, re-estimates the noise between rounds, ends at a stationary point of the full loss.
    ///
    /// With `Scale::Ranking` the noise is not estimated: it is that of the ranking score, so the refinement stays with the
    /// consensus that the thresholds define.
    pub(super) fn full(
        &mut self,
        problem: &Problem,
        start: &Model,
        sigma_px: f64,
        soft: &Soft,
        scale: Scale,
        rounds: usize,
    ) -> Refined {
        let mut model = *start;
        let mut noise = Noise {
            sigma_px,
            world_sigma: 0.0,
            point_offset: 0.0,
            line_offset: 0.0,
            gate_sq: 2500.0,
            inflation: 1.6,
        };
        let is_estimated = scale == Scale::Estimated;
        if is_estimated {
            noise.world_sigma = self.initial_world_sigma(problem, &model, &noise);
        } else {
            noise.sigma_px = self.quick_variance.0.min(self.quick_variance.1).sqrt();
            noise.gate_sq = 12.0;
        }
        let mut normal = Normal::new();
        for round in 0..rounds {
            let is_last = round + 1 == rounds;
            if round > 0 {
                noise.inflation = 1.0;
                if is_estimated {
                    self.update_noise(problem, &model, &mut noise);
                }
            }
            self.freeze(problem, &model, &noise);
            let steps = if is_last { 20 } else { 5 };
            (model, normal) = self.minimize(problem, &model, soft, steps);
        }
        let log_ratio = -normal.cost - self.prior_mass(problem, &noise);
        orthonormalize(&mut model);
        Refined {
            model,
            noise,
            normal,
            log_ratio,
        }
    }

    /// Sum of ln(1 / (1 - prior)): what the hypothesis of no inliers would gain.
    fn prior_mass(&self, problem: &Problem, noise: &Noise) -> f64 {
        let (point_factor, line_factor) = (exp(noise.point_offset), exp(noise.line_offset));
        let mut mass = LnProduct::new();
        for p in &problem.points {
            mass.multiply(1.0 + point_factor * p.odds);
        }
        for l in &problem.lines {
            mass.multiply(1.0 + line_factor * l.odds);
        }
        mass.ln()
    }

    /// Median over the correspondences within the ranking threshold of what their residual says about the world noise.
    fn initial_world_sigma(&mut self, problem: &Problem, model: &Model, noise: &Noise) -> f64 {
        let sigma_px = noise.sigma_px;
        // Median of a chi-square with two degrees of freedom, over two.
        const MEDIAN: f64 = 1.386;
        self.collect_near(problem, model, 17.0, noise);
        self.values.clear();
        self.values.extend(
            self.near
                .iter()
                .map(|n| ((n.r_sq / MEDIAN - sigma_px * sigma_px).max(0.0) / n.gain_sq).sqrt()),
        );
        let sigma = crate::math::stats::median_in_place(&mut self.values).unwrap_or(0.0);
        sigma.max(self.smallest_world_sigma(problem, sigma_px))
    }

    /// Below this the noise of the world coordinates disappears in that of the pixels.
    fn smallest_world_sigma(&self, problem: &Problem, sigma_px: f64) -> f64 {
        0.1 * sigma_px / problem.fx.max(problem.fy)
    }

    /// Correspondences whose squared residual is below `limit` ranking variances.
    fn collect_near(&mut self, problem: &Problem, model: &Model, limit: f64, noise: &Noise) {
        let (point_factor, line_factor) = (
            odds_at_zero(exp(noise.point_offset), 1.0, problem.null_point),
            odds_at_zero(exp(noise.line_offset), 1.0, problem.null_line),
        );
        let (fx, fy) = (problem.fx, problem.fy);
        let f_sq = fx * fy * model.focal * model.focal;
        self.near.clear();
        for item in &problem.points {
            if let Some((res, ..)) = residuals::point(fx, fy, model, item) {
                let r_sq = res.squared();
                if r_sq < limit * self.quick_variance.0 {
                    self.near.push(Near {
                        r_sq,
                        gain_sq: f_sq * res.inverse_depth_sq(),
                        odds: item.odds * point_factor,
                        sigma: item.sigma,
                    });
                }
            }
        }
        for item in &problem.lines {
            if let Some((res, state)) = residuals::line(fx, fy, model, item) {
                let r_sq = res.squared();
                if r_sq < limit * self.quick_variance.1
                    && residuals::overlaps(fx, fy, item, &state, model.focal)
                {
                    self.near.push(Near {
                        r_sq,
                        gain_sq: f_sq * res.inverse_depth_sq(),
                        odds: item.odds * line_factor,
                        sigma: item.sigma,
                    });
                }
            }
        }
    }

    /// One step of profile likelihood in ln world_sigma and one of expectation maximisation in the inlier shares.
    fn update_noise(&mut self, problem: &Problem, model: &Model, noise: &mut Noise) {
        // The shares first: posteriors at the current frozen noise against the priors.
        let (fx, fy) = (problem.fx, problem.fy);
        self.freeze(problem, model, noise);
        let factor = exp(noise.point_offset);
        let (mut found, mut expected) = (0.0, 0.0);
        for (item, frozen) in problem.points.iter().zip(&self.points) {
            expected += probability(factor * item.odds);
            if frozen.variance > 0.0
                && let Some((res, ..)) = residuals::point(fx, fy, model, item)
            {
                found += posterior(frozen, res.squared());
            }
        }
        noise.point_offset += share_step(found, expected, problem.points.len());
        let factor = exp(noise.line_offset);
        (found, expected) = (0.0, 0.0);
        for (item, frozen) in problem.lines.iter().zip(&self.lines) {
            expected += probability(factor * item.odds);
            if frozen.variance > 0.0
                && let Some((res, _)) = residuals::line(fx, fy, model, item)
            {
                found += posterior(frozen, res.squared());
            }
        }
        noise.line_offset += share_step(found, expected, problem.lines.len());
        self.collect_near(problem, model, 400.0, noise);
        let px = noise.sigma_px * noise.sigma_px;
        let value = |near: &[Near], world: f64| -> f64 {
            let mut gain = LnProduct::new();
            for n in near {
                let s = if n.sigma > 0.0 { n.sigma } else { world };
                let variance = px + n.gain_sq * s * s;
                let t = 1.0 + n.r_sq / (TAIL * variance);
                gain.multiply(1.0 + n.odds / (variance * t * t * t));
            }
            gain.ln()
        };
        let smallest = self.smallest_world_sigma(problem, noise.sigma_px);
        let mut best = noise.world_sigma;
        let mut best_value = value(&self.near, best);
        let mut factor = 1.5;
        for _ in 0..3 {
            for candidate in [best * factor, best / factor] {
                let v = value(&self.near, candidate);
                if v > best_value && candidate >= smallest {
                    (best, best_value) = (candidate, v);
                    break;
                }
            }
            factor = factor.sqrt();
        }
        noise.world_sigma = best;
    }

    /// Fixes variance and evidence of every correspondence at a model.
    fn freeze(&mut self, problem: &Problem, model: &Model, noise: &Noise) {
        let (fx, fy) = (problem.fx, problem.fy);
        let f_sq = fx * fy * model.focal * model.focal;
        let inflation = noise.inflation * noise.inflation;
        let variance = |sigma: f64, inverse_depth_sq: f64| {
            let s = if sigma > 0.0 {
                sigma
            } else {
                noise.world_sigma
            };
            inflation * (noise.sigma_px * noise.sigma_px + f_sq * s * s * inverse_depth_sq)
        };
        let none = Frozen {
            variance: 0.0,
            odds: 0.0,
        };
        let (point_factor, line_factor) = (exp(noise.point_offset), exp(noise.line_offset));
        self.points.clear();
        self.points.extend(problem.points.iter().map(|item| {
            residuals::point(fx, fy, model, item).map_or(none, |(res, ..)| {
                let v = variance(item.sigma, res.inverse_depth_sq());
                if res.squared() > noise.gate_sq * v {
                    return none;
                }
                Frozen {
                    variance: v,
                    odds: odds_at_zero(point_factor * item.odds, v, problem.null_point),
                }
            })
        }));
        self.lines.clear();
        self.lines.extend(problem.lines.iter().map(|item| {
            residuals::line(fx, fy, model, item).map_or(none, |(res, state)| {
                let v = variance(item.sigma, res.inverse_depth_sq());
                if res.squared() > noise.gate_sq * v
                    || !residuals::overlaps(fx, fy, item, &state, model.focal)
                {
                    return none;
                }
                Frozen {
                    variance: v,
                    odds: odds_at_zero(line_factor * item.odds, v, problem.null_line),
                }
            })
        }));
    }

    /// Normal equations of the full loss with frozen variances. A correspondence behind the camera gains nothing.
    fn normal(&self, problem: &Problem, model: &Model, soft: &Soft) -> Normal {
        let mut n = Normal::new();
        let (fx, fy) = (problem.fx, problem.fy);
        let has_focal = soft.sigma_ln_focal.is_some();
        let mut gain = LnProduct::new();
        let mut add = |rows: [Row; 2], r: [f64; 2], weight: f64| {
            if has_focal {
                n.add::<7>(&rows, &r, weight);
            } else {
                n.add::<6>(&rows, &r, weight);
            }
        };
        for (item, frozen) in problem.points.iter().zip(&self.points) {
            if frozen.variance > 0.0
                && let Some((res, z, u)) = residuals::point(fx, fy, model, item)
            {
                let (odds, weight) = student(frozen.odds, res.squared(), frozen.variance);
                if odds > NEGLIGIBLE {
                    gain.multiply(1.0 + odds);
                    let rows = residuals::point_rows(fx, fy, model, &z, &u);
                    add(rows, res.r, weight);
                }
            }
        }
        for (item, frozen) in problem.lines.iter().zip(&self.lines) {
            if frozen.variance > 0.0
                && let Some((res, state)) = residuals::line(fx, fy, model, item)
            {
                let (odds, weight) = student(frozen.odds, res.squared(), frozen.variance);
                if odds > NEGLIGIBLE {
                    gain.multiply(1.0 + odds);
                    let rows = residuals::line_rows(fx, fy, model, item, &res, &state);
                    add(rows, res.r, weight);
                }
            }
        }
        n.cost = -gain.ln();
        add_soft(&mut n, model, soft);
        n.mirror();
        n
    }

    /// Levenberg-Marquardt with Nielsen's damping; the cost never rises.
    fn minimize(
        &self,
        problem: &Problem,
        start: &Model,
        soft: &Soft,
        max_steps: usize,
    ) -> (Model, Normal) {
        let mut model = *start;
        let mut normal = self.normal(problem, &model, soft);
        let (mut lambda, mut growth) = (1e-5, 2.0);
        for _ in 0..max_steps {
            let Some(step) = normal.step(lambda) else {
                lambda *= growth;
                growth *= 2.0;
                continue;
            };
            let size: f64 = step.iter().map(|s| s * s).sum();
            let candidate = residuals::perturbed(&model, &step);
            let next = self.normal(problem, &candidate, soft);
            let drop = normal.cost - next.cost;
            if drop >= 0.0 && candidate.is_finite() {
                model = candidate;
                let relative = drop / (1.0 + next.cost.abs());
                normal = next;
                lambda = (lambda * 0.2).max(1e-9);
                growth = 2.0;
                if relative < 1e-10 || size < 1e-18 {
                    break;
                }
            } else {
                lambda = (lambda * growth).max(1e-6);
                growth *= 2.0;
                if size < 1e-18 || lambda > 1e8 {
                    break;
                }
            }
        }
        (model, normal)
    }

    /// Fixes the noise for [`Self::posteriors`].
    pub(super) fn freeze_at(&mut self, problem: &Problem, refined: &Refined) {
        self.freeze(problem, &refined.model, &refined.noise);
    }

    /// Source index, posterior inlier probability and odds at zero residual of every correspondence.
    pub(super) fn posteriors(
        &self,
        problem: &Problem,
        model: &Model,
        mut report: impl FnMut(Kind, u32, f64, f64),
    ) {
        let (fx, fy) = (problem.fx, problem.fy);
        for (item, frozen) in problem.points.iter().zip(&self.points) {
            let p = match residuals::point(fx, fy, model, item) {
                Some((res, ..)) if frozen.variance > 0.0 => posterior(frozen, res.squared()),
                _ => 0.0,
            };
            report(Kind::Point, item.source, p, frozen.odds);
        }
        for (item, frozen) in problem.lines.iter().zip(&self.lines) {
            let p = match residuals::line(fx, fy, model, item) {
                Some((res, _)) if frozen.variance > 0.0 => posterior(frozen, res.squared()),
                _ => 0.0,
            };
            report(Kind::Line, item.source, p, frozen.odds);
        }
    }
}

fn probability(odds: f64) -> f64 {
    odds / (1.0 + odds)
}

fn posterior(frozen: &Frozen, r_sq: f64) -> f64 {
    probability(student(frozen.odds, r_sq, frozen.variance).0)
}

/// Change of the common logit that moves the expected number of inliers towards the found one; bounded for few items.
fn share_step(found: f64, expected: f64, count: usize) -> f64 {
    if count == 0 {
        return 0.0;
    }
    let n = count as f64;
    // One pseudo-count on each side keeps an empty kind from running away.
    let odds = |x: f64| ln((x + 0.5) / (n - x + 0.5));
    (odds(found) - odds(expected)).clamp(-2.0, 2.0)
}

fn orthonormalize(model: &mut Model) {
    let x: Vector3<f64> = model.rotation.row(0).transpose().normalize();
    let y: Vector3<f64> = model.rotation.row(1).transpose();
    let z = x.cross(&y).normalize();
    let y = z.cross(&x);
    model.rotation = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
}

/// Residuals of gravity, prior pose and focal length.
fn add_soft(n: &mut Normal, model: &Model, soft: &Soft) {
    if let Some((in_cam, in_world, sigma)) = &soft.gravity {
        for (r, row) in gravity_residuals(model, in_cam, in_world, *sigma) {
            n.add_residual(&row, r);
        }
    }
    if let Some((prior, information)) = &soft.prior {
        let (xi, jacobian) = prior_residual(model, prior);
        let h = jacobian.transpose() * information * jacobian;
        let g = jacobian.transpose() * information * xi;
        for i in 0..6 {
            n.g[i] += g[i];
            for j in i..6 {
                n.h[(i, j)] += h[(i, j)];
            }
        }
        n.cost += 0.5 * xi.dot(&(information * xi));
    }
    if let Some(sigma) = soft.sigma_ln_focal {
        let mut row = [0.0; 7];
        row[6] = 1.0 / sigma;
        n.add_residual(&row, ln(model.focal) / sigma);
    }
}

/// Components of the world's gravity, seen by the camera, that are normal to the measured one.
fn gravity_residuals(
    model: &Model,
    in_cam: &Vector3<f64>,
    in_world: &Vector3<f64>,
    sigma: f64,
) -> [(f64, Row); 2] {
    let seen = model.rotation * in_world;
    let axis = if in_cam.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let b1 = in_cam.cross(&axis).normalize();
    let b2 = in_cam.cross(&b1);
    [b1, b2].map(|b| {
        let j = seen.cross(&b) / sigma;
        (b.dot(&seen) / sigma, [j.x, j.y, j.z, 0.0, 0.0, 0.0, 0.0])
    })
}

/// Logarithm of model * prior^-1 (rotation vector, translation) and its derivative.
fn prior_residual(model: &Model, prior: &Model) -> (SVector<f64, 6>, Matrix6<f64>) {
    let turn = model.rotation * prior.rotation.transpose();
    let w = vector_from_rotation(&turn);
    let v = model.translation - turn * prior.translation;
    let angle = w.norm();
    let k = w.cross_matrix();
    let second = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        let (s, c) = (
            crate::math::elementary::sin(angle),
            crate::math::elementary::cos(angle),
        );
        1.0 / (angle * angle) - (1.0 + c) / (2.0 * angle * s)
    };
    let left_inverse = Matrix3::identity() - k * 0.5 + k * k * second;
    let mut jacobian = Matrix6::identity();
    jacobian
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&left_inverse);
    jacobian
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(-v.cross_matrix()));
    let xi = SVector::<f64, 6>::from_iterator(w.iter().chain(v.iter()).copied());
    (xi, jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_vector;
    use crate::math::Rng;

    fn model(rng: &mut Rng) -> Model {
        let mut v = || Vector3::from_fn(|_, _| rng.normal());
        Model {
            rotation: rotation_from_vector(&v()),
            translation: v(),
            focal: 1.2,
        }
    }

    #[test]
    fn soft_jacobians_agree_with_central_differences() {
        let mut rng = Rng::from_seed(31);
        for _ in 0..100 {
            let m = model(&mut rng);
            let prior = residuals::perturbed(&m, &[0.1, -0.2, 0.15, 0.3, 0.2, -0.1, 0.0]);
            let g_cam = Vector3::new(0.1, 0.9, -0.2).normalize();
            let g_world = m.rotation.transpose() * Vector3::new(0.2, 0.85, -0.1).normalize();
            let rows = gravity_residuals(&m, &g_cam, &g_world, 0.02);
            let (_, jacobian) = prior_residual(&m, &prior);
            let h = 1e-6;
            for c in 0..6 {
                let mut step = [0.0; 7];
                step[c] = h;
                let up = residuals::perturbed(&m, &step);
                step[c] = -h;
                let down = residuals::perturbed(&m, &step);
                for k in 0..2 {
                    let at = |m: &Model| gravity_residuals(m, &g_cam, &g_world, 0.02)[k].0;
                    let numeric = (at(&up) - at(&down)) / (2.0 * h);
                    assert!((numeric - rows[k].1[c]).abs() < 1e-6 * (1.0 + numeric.abs()));
                }
                let numeric =
                    (prior_residual(&up, &prior).0 - prior_residual(&down, &prior).0) / (2.0 * h);
                assert!((numeric - jacobian.column(c)).amax() < 1e-6);
            }
        }
    }

    #[test]
    fn student_weight_is_the_derivative_of_its_gain() {
        let gain = |r_sq: f64| (1.0 + student(150.0, r_sq, 2.0).0).ln();
        for r_sq in [0.5, 4.0, 30.0, 200.0] {
            let h = 1e-5;
            let (_, weight) = student(150.0, r_sq, 2.0);
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
