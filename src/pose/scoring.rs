//! The ranking score of a pose: evidence of all correspondences in nats, truncated at zero for each.
//!
//! Gaussian residual against a uniform outlier: `gain = max(0, w - r^2 / (2 sigma^2))` with
//! `w = logit(prior) - ln(2 pi sigma^2) - ln(null density)` is the rectified log likelihood ratio, so prior, weight and
//! threshold of a correspondence come from one formula. Correspondences are sorted by w, which makes the sum of what is left
//! a bound that lets hopeless candidates go early.

use super::kernels::{self, LANES, LineBlock, PointBlock, Projection};
use super::problem::{MIN_DEPTH, Model, Problem};
use crate::math::elementary::ln;

/// An error of `max_point_error_px` is this many standard deviations of the ranking score: the gain of a correspondence with
/// even odds reaches zero there for a 640x480 image.
pub(super) const ERRORS_PER_SIGMA: f64 = 4.15;

/// Blocks of the head start: if these say nothing, the rest is not looked at.
const HEAD_POINT_BLOCKS: usize = 16;
const HEAD_LINE_BLOCKS: usize = 8;

/// A candidate whose head gain falls below this share of the best model's is not looked at further.
const HEAD_SHARE: f32 = 0.3;

/// Blocks between two looks at the bound.
const CHUNK: usize = 8;

/// What the ranking of one candidate gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ranking {
    /// Gain over the head blocks.
    pub(super) head: f32,
    /// Gain over everything.
    pub(super) total: f32,
}

/// Blocks of correspondences and their bounds.
#[derive(Debug, Default)]
pub(super) struct Ranker {
    points: Vec<PointBlock>,
    lines: Vec<LineBlock>,
    /// `point_rest[i]`: largest gain of the point blocks from i on; likewise lines.
    point_rest: Vec<f32>,
    line_rest: Vec<f32>,
    point_h: f32,
    line_h: f32,
    /// Standard deviations of the ranking score in pixels.
    pub(super) point_sigma_px: f64,
    pub(super) line_sigma_px: f64,
    pub(super) items_evaluated: u64,
}

/// Weight at zero residual.
pub(super) fn evidence(logit: f64, variance: f64, ln_null: f64) -> f64 {
    logit - ln(core::f64::consts::TAU * variance) - ln_null
}

impl Ranker {
    pub(super) fn load(&mut self, problem: &Problem, max_point_px: f64, max_line_px: f64) {
        self.items_evaluated = 0;
        self.point_sigma_px = max_point_px / ERRORS_PER_SIGMA;
        self.line_sigma_px = max_line_px / ERRORS_PER_SIGMA;
        let point_var = self.point_sigma_px * self.point_sigma_px;
        let line_var = self.line_sigma_px * self.line_sigma_px;
        self.point_h = (0.5 / point_var) as f32;
        self.line_h = (0.5 / line_var) as f32;
        self.points.clear();
        for chunk in problem.points.chunks(LANES) {
            let mut block = [[0.0f32; LANES]; 6];
            for (lane, p) in chunk.iter().enumerate() {
                let w = evidence(p.belief.logit, point_var, problem.ln_null_point).max(0.0);
                let fields = [p.x.x, p.x.y, p.x.z, p.uv.x, p.uv.y, w];
                for (k, value) in fields.into_iter().enumerate() {
                    block[k][lane] = value as f32;
                }
            }
            self.points.push(block);
        }
        self.lines.clear();
        for chunk in problem.lines.chunks(LANES) {
            let mut block = [[0.0f32; LANES]; 11];
            for (lane, l) in chunk.iter().enumerate() {
                let w = evidence(l.belief.logit, line_var, problem.ln_null_line).max(0.0);
                let fields = [
                    l.x1.x, l.x1.y, l.x1.z, l.x2.x, l.x2.y, l.x2.z, l.a.x, l.a.y, l.b.x, l.b.y, w,
                ];
                for (k, value) in fields.into_iter().enumerate() {
                    block[k][lane] = value as f32;
                }
            }
            self.lines.push(block);
        }
        let suffix = |out: &mut Vec<f32>, sums: &mut dyn Iterator<Item = f32>| {
            out.clear();
            out.push(0.0);
            let mut total = 0.0;
            for w in sums {
                total += w;
                out.push(total);
            }
            out.reverse();
        };
        suffix(
            &mut self.point_rest,
            &mut self.points.iter().rev().map(|b| b[5].iter().sum()),
        );
        suffix(
            &mut self.line_rest,
            &mut self.lines.iter().rev().map(|b| b[10].iter().sum()),
        );
    }

    fn projection(problem: &Problem, model: &Model) -> Projection {
        let f = [problem.fx * model.focal, problem.fy * model.focal, 1.0];
        core::array::from_fn(|r| {
            core::array::from_fn(|c| {
                let v = if c < 3 {
                    model.rotation[(r, c)]
                } else {
                    model.translation[r]
                };
                (f[r] * v) as f32
            })
        })
    }

    fn points(&mut self, from: usize, to: usize, p: &Projection) -> f32 {
        self.items_evaluated += ((to - from) * LANES) as u64;
        kernels::score_points(&self.points[from..to], p, self.point_h, MIN_DEPTH as f32)
    }

    fn lines(&mut self, from: usize, to: usize, p: &Projection) -> f32 {
        self.items_evaluated += ((to - from) * LANES) as u64;
        kernels::score_lines(&self.lines[from..to], p, self.line_h, MIN_DEPTH as f32)
    }

    /// The exact ranking score.
    pub(super) fn score(&mut self, problem: &Problem, model: &Model) -> Ranking {
        self.score_above(problem, model, f32::NEG_INFINITY, 0.0)
            .unwrap_or(Ranking {
                head: 0.0,
                total: 0.0,
            })
    }

    /// The ranking score, or `None` as soon as it cannot exceed `floor`, or when the head gain is small beside `best_head`.
    pub(super) fn score_above(
        &mut self,
        problem: &Problem,
        model: &Model,
        floor: f32,
        best_head: f32,
    ) -> Option<Ranking> {
        let p = Self::projection(problem, model);
        let (num_points, num_lines) = (self.points.len(), self.lines.len());
        let (head_points, head_lines) = (
            num_points.min(HEAD_POINT_BLOCKS),
            num_lines.min(HEAD_LINE_BLOCKS),
        );
        let head = self.points(0, head_points, &p) + self.lines(0, head_lines, &p);
        if head < HEAD_SHARE * best_head {
            return None;
        }
        let mut total = head;
        let (mut i, mut j) = (head_points, head_lines);
        while j < num_lines {
            if total + self.line_rest[j] + self.point_rest[i] <= floor {
                return None;
            }
            let to = (j + CHUNK).min(num_lines);
            total += self.lines(j, to, &p);
            j = to;
        }
        while i < num_points {
            if total + self.point_rest[i] <= floor {
                return None;
            }
            let to = (i + CHUNK).min(num_points);
            total += self.points(i, to, &p);
            i = to;
        }
        Some(Ranking { head, total })
    }
}

#[cfg(test)]
mod tests {
    use super::super::options::PoseOptions;
    use super::super::residuals;
    use super::super::types::{LineCorrespondence, PointCorrespondence};
    use super::*;
    use crate::geometry::{CamFromWorld, Camera, Pixel, rotation_from_vector};
    use crate::math::Rng;
    use nalgebra::Vector3;

    /// Points and lines seen from the origin, a third of them somewhere else.
    fn problem(rng: &mut Rng) -> Problem {
        let camera = Camera::centered(640, 480, 500.0);
        let mut observe = || {
            let x = Vector3::new(
                rng.range(-1.5, 1.5),
                rng.range(-1.0, 1.0),
                rng.range(2.0, 5.0),
            );
            let p = camera.pixel_from_cam(&x).unwrap_or_default();
            let is_right = rng.below(3) > 0;
            let noise = if is_right { 2.0 } else { 200.0 };
            let pixel = Pixel::new(p.x + noise * rng.normal(), p.y + noise * rng.normal());
            (pixel, x, rng.range(0.05, 0.95) as f32)
        };
        let points: Vec<_> = (0..150)
            .map(|_| {
                let (pixel, point_in_world, confidence) = observe();
                PointCorrespondence {
                    pixel,
                    point_in_world,
                    confidence,
                    sigma_m: 0.0,
                    sigma_px: 0.0,
                }
            })
            .collect();
        let lines: Vec<_> = (0..70)
            .map(|_| {
                let ((start, start_in_world, confidence), (end, end_in_world, _)) =
                    (observe(), observe());
                LineCorrespondence {
                    start,
                    end,
                    start_in_world,
                    end_in_world,
                    confidence,
                    sigma_m: 0.0,
                    sigma_px: 0.0,
                }
            })
            .collect();
        let mut problem = Problem::default();
        problem.load(&points, &lines, &camera, &PoseOptions::default());
        problem
    }

    #[test]
    fn the_score_is_the_sum_of_the_rectified_evidence_and_its_bound_is_safe() {
        let mut rng = Rng::from_seed(17);
        let (max_point, max_line) = (12.0, 10.0);
        for _ in 0..20 {
            let problem = problem(&mut rng);
            let mut ranker = Ranker::default();
            ranker.load(&problem, max_point, max_line);
            let (ps, ls) = (ranker.point_sigma_px, ranker.line_sigma_px);
            let mut floor = 0.0;
            for k in 0..20 {
                let size = 0.002 * f64::from(k);
                let turn = rotation_from_vector(&Vector3::from_fn(|_, _| size * rng.normal()));
                let shift = Vector3::from_fn(|_, _| size * rng.normal());
                let model = problem.model_from_pose(&CamFromWorld::new(turn, shift), 1.0);
                let (fx, fy) = (problem.fx, problem.fy);
                let gain = |logit: f64, sigma: f64, ln_null: f64, r_sq: f64| {
                    (evidence(logit, sigma * sigma, ln_null).max(0.0)
                        - 0.5 * r_sq / (sigma * sigma))
                        .max(0.0)
                };
                let of_points: f64 = problem
                    .points
                    .iter()
                    .filter_map(|p| {
                        let (r, ..) = residuals::point(fx, fy, &model, p)?;
                        Some(gain(p.belief.logit, ps, problem.ln_null_point, r.squared()))
                    })
                    .sum();
                let of_lines: f64 = problem
                    .lines
                    .iter()
                    .filter_map(|l| {
                        let (r, state) = residuals::line(fx, fy, &model, l)?;
                        residuals::overlaps(fx, fy, l, &state, 1.0)
                            .then(|| gain(l.belief.logit, ls, problem.ln_null_line, r.squared()))
                    })
                    .sum();
                let exact = of_points + of_lines;
                let score = ranker.score(&problem, &model).total;
                assert!(
                    (f64::from(score) - exact).abs() < 1e-3 * (1.0 + exact),
                    "{score} {exact}"
                );
                // Leaving early never loses a better candidate.
                let above = ranker.score_above(&problem, &model, floor, 0.0);
                assert_eq!(above.is_some_and(|r| r.total > floor), score > floor);
                floor = score.max(floor);
            }
        }
    }
}
