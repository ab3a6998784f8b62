//! The search: draw, solve, test on the sample, rank, optimise locally, stop when a better model would have been seen.
//!
//! Compositions (how many points and lines a sample has) are drawn by value per time: the chance that all items are inliers
//! under the present distribution, times the usefulness of the solver, over its cost. The stopping rule adds up, over
//! distributions and compositions, the log probability that none of the samples drawn so far was all inliers of the best
//! model; it is exact for any mix of samplers (for uniform draws it becomes the usual rule).

use super::options::{Focal, Gravity, PoseOptions};
use super::problem::{LineItem, MIN_DEPTH, Model, Problem};
use super::refine::{Refiner, Soft};
use super::residuals;
use super::sampler::{NUM_DISTRIBUTIONS, REST, Sampler};
use super::scoring::{Ranker, Ranking};
use super::solvers::{
    FocalSolutions, ImageLineCentered, SampleLine, Solutions, SolverKind, p1p2ll, p2p1ll, p3ll,
    p3p, pnplf, up1p1ll, up2p,
};
use super::types::{PoseStats, StopReason};
use crate::geometry::CamFromWorld;
use crate::math::Rng;
use crate::math::elementary::{exp, ln};
use nalgebra::{Matrix3, Vector3};

/// How many distinct models are kept for the end.
pub(super) const NUM_KEPT: usize = 4;

/// A candidate that reaches this share of the best score and is clearly different is optimised too.
const RIVAL_SHARE: f32 = 0.6;

/// Local optimisations of rivals at most.
const MAX_RIVAL_OPTIMIZATIONS: u32 = 64;

/// A rival structure that explains at least this share of what the best model explains is looked for on purpose, with at
/// most so many samples.
const RIVAL_INLIER_SHARE: f64 = 0.75;
const MAX_RIVAL_SAMPLES: u32 = 1000;

/// Iterations between two looks at the clock and the stopping rule.
const ROUND: u32 = 32;

/// Points of a sample must be this far apart in the image.
const MIN_POINT_DISTANCE_PX: f64 = 8.0;

/// Lines of a sample must be this long in the image.
const MIN_LINE_LENGTH_PX: f64 = 12.0;

/// (points, lines, usefulness of an all-inlier sample, cost of drawing and solving in microseconds, mean candidates left)
struct Composition {
    kind: SolverKind,
    points: i32,
    lines: i32,
    usefulness: f64,
    cost_us: f64,
    candidates: f64,
}

const fn composition(
    kind: SolverKind,
    points: i32,
    lines: i32,
    usefulness: f64,
    cost_us: f64,
    candidates: f64,
) -> Composition {
    Composition {
        kind,
        points,
        lines,
        usefulness,
        cost_us,
        candidates,
    }
}

/// Measured on one core of a server CPU; only their ratios matter. The usefulness is that of noisy inliers.
const CALIBRATED: [Composition; 4] = [
    composition(SolverKind::P3p, 3, 0, 0.4, 0.7, 1.5),
    composition(SolverKind::P2p1ll, 2, 1, 0.35, 0.6, 0.5),
    composition(SolverKind::P1p2ll, 1, 2, 0.25, 1.0, 0.4),
    composition(SolverKind::P3ll, 0, 3, 0.15, 3.0, 0.5),
];
const UPRIGHT: [Composition; 2] = [
    composition(SolverKind::Up2p, 2, 0, 0.3, 0.3, 1.2),
    composition(SolverKind::Up1p1ll, 1, 1, 0.2, 0.3, 0.6),
];
const FOCAL: [Composition; 2] = [
    composition(SolverKind::Pnplf, 4, 0, 0.3, 8.0, 1.5),
    composition(SolverKind::Pnplf, 2, 2, 0.2, 8.0, 1.5),
];
const MAX_COMPOSITIONS: usize = 8;

/// With the focal length unknown, the probability that the drawn one is near enough for a useful sample.
const FOCAL_HIT: f64 = 0.25;

/// Time a point or line costs to rank, in microseconds.
const ITEM_US: f64 = 0.0015;

/// Focal lengths considered, relative to the larger image side.
const FOCAL_RANGE: (f64, f64) = (0.3, 4.0);
const NUM_FOCAL_BINS: usize = 24;

/// A locally optimised model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kept {
    pub(super) model: Model,
    pub(super) ranking: Ranking,
}

/// Everything that the search owns from call to call.
#[derive(Debug, Default)]
pub(super) struct Search {
    pub(super) ranker: Ranker,
    pub(super) refiner: Refiner,
    sampler: Sampler,
    pub(super) kept: Vec<Kept>,
    is_point_inlier: Vec<bool>,
    is_line_inlier: Vec<bool>,
    solutions: Solutions,
    focal_solutions: FocalSolutions,
}

/// State of one run.
struct Run<'a> {
    problem: &'a Problem,
    options: &'a PoseOptions,
    soft: Soft,
    rng: Rng,
    stats: PoseStats,
    compositions: [Option<&'static Composition>; MAX_COMPOSITIONS],
    choice: [f64; MAX_COMPOSITIONS],
    draws: [[u32; MAX_COMPOSITIONS]; NUM_DISTRIBUTIONS],
    gravity: Option<GravityFrames>,
    focal_weights: Option<[f64; NUM_FOCAL_BINS]>,
    rival_optimizations: u32,
    best_changed: bool,
    pending: [SolverKind; 1],
}

/// Rotations that bring gravity onto the y axis.
struct GravityFrames {
    upright_from_cam: Matrix3<f64>,
    upright_from_world: Matrix3<f64>,
}

impl GravityFrames {
    fn new(gravity: &Gravity) -> Self {
        Self {
            upright_from_cam: rotation_onto_y(&gravity.in_cam),
            upright_from_world: rotation_onto_y(&gravity.in_world),
        }
    }
}

fn rotation_onto_y(v: &Vector3<f64>) -> Matrix3<f64> {
    let y = v.normalize();
    let axis = if y.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::z()
    };
    let z = axis.cross(&y).normalize();
    let x = y.cross(&z);
    Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()])
}

/// Log-normal belief in the focal length over bins of ln f; 1.2 times the larger side is typical for photographs.
fn focal_belief() -> [f64; NUM_FOCAL_BINS] {
    core::array::from_fn(|i| {
        let z = (focal_bin_ln(i as f64 + 0.5) - ln(1.2)) / 0.6;
        exp(-0.5 * z * z) + 0.05
    })
}

fn focal_bin_ln(position: f64) -> f64 {
    let (low, high) = (ln(FOCAL_RANGE.0), ln(FOCAL_RANGE.1));
    low + (high - low) * position / NUM_FOCAL_BINS as f64
}

impl Search {
    /// Searches; afterwards `kept` holds the distinct models found, best first.
    pub(super) fn run(
        &mut self,
        problem: &Problem,
        options: &PoseOptions,
        soft: &Soft,
        out_of_time: &mut dyn FnMut() -> bool,
    ) -> PoseStats {
        self.ranker.load(
            problem,
            options.max_point_error_px,
            options.max_line_error_px,
        );
        self.refiner.load(
            problem,
            self.ranker.point_sigma_px,
            self.ranker.line_sigma_px,
        );
        self.sampler.load(problem);
        self.kept.clear();
        self.kept.reserve(NUM_KEPT + 1);
        let is_focal_unknown = options.focal == Focal::Unknown;
        let mut run = Run {
            problem,
            options,
            soft: *soft,
            rng: Rng::from_seed(options.seed),
            stats: PoseStats::default(),
            compositions: [None; MAX_COMPOSITIONS],
            choice: [0.0; MAX_COMPOSITIONS],
            draws: [[0; MAX_COMPOSITIONS]; NUM_DISTRIBUTIONS],
            gravity: options.gravity.as_ref().map(GravityFrames::new),
            focal_weights: is_focal_unknown.then(focal_belief),
            rival_optimizations: 0,
            best_changed: false,
            pending: [SolverKind::P3p],
        };
        let usable = |c: &&'static Composition| {
            problem.points.len() >= c.points as usize && problem.lines.len() >= c.lines as usize
        };
        let upright: &'static [Composition] = if run.gravity.is_some() { &UPRIGHT } else { &[] };
        let focal: &'static [Composition] = if is_focal_unknown { &FOCAL } else { &[] };
        let all = CALIBRATED.iter().chain(upright).chain(focal);
        for (slot, c) in run.compositions.iter_mut().zip(all.filter(usable)) {
            *slot = Some(c);
        }
        if let Some(prior) = &options.prior {
            let model = problem.model_from_pose(&prior.cam_from_world, 1.0);
            if model.is_finite() {
                self.optimize(&mut run, &model);
            }
        }
        self.plan(&mut run);
        if run.compositions[0].is_none() {
            return run.stats;
        }
        loop {
            if run.stats.iterations % ROUND == 0 {
                if out_of_time() {
                    run.stats.stop = StopReason::TimeBudget;
                    break;
                }
                if run.best_changed {
                    run.best_changed = false;
                    self.mark_inliers(&run);
                    self.plan(&mut run);
                }
                if run.stats.iterations >= options.min_iterations && self.is_confident(&run) {
                    run.stats.stop = StopReason::Confident;
                    break;
                }
            }
            if run.stats.iterations >= options.max_iterations {
                run.stats.stop = StopReason::IterationLimit;
                break;
            }
            run.stats.iterations += 1;
            self.iterate(&mut run);
        }
        self.look_for_rival(&mut run, out_of_time);
        run.stats.items_evaluated = self.ranker.items_evaluated;
        run.stats
    }

    /// Samples only what the best model leaves unexplained: in a place with repeated structure the second answer is there.
    fn look_for_rival(&mut self, run: &mut Run<'_>, out_of_time: &mut dyn FnMut() -> bool) {
        if self.kept.is_empty() {
            return;
        }
        self.mark_inliers(run);
        self.sampler
            .build_rest(run.problem, &self.is_point_inlier, &self.is_line_inlier);
        let count = |is: &[bool]| is.iter().filter(|is| **is).count() as f64;
        let (np, nl) = (count(&self.is_point_inlier), count(&self.is_line_inlier));
        // Share of inliers among the rest that the weakest rival of interest would have.
        let share = |inliers: f64, total: usize| {
            RIVAL_INLIER_SHARE * inliers / (total as f64 - inliers).max(1.0)
        };
        let (sp, sl) = (
            share(np, run.problem.points.len()),
            share(nl, run.problem.lines.len()),
        );
        if sp.max(sl) > 1.0 {
            return; // there is not enough left
        }
        let total: f64 = run.choice.iter().sum();
        let mut hit = 0.0;
        for (choice, c) in run.choice.iter().zip(&run.compositions) {
            if let Some(c) = c {
                hit += choice / total * c.usefulness * sp.powi(c.points) * sl.powi(c.lines);
            }
        }
        // 95 % of the rivals of that size are found.
        let wanted = 3.0 / hit.max(1e-9);
        let samples = (wanted.min(f64::from(MAX_RIVAL_SAMPLES)) as u32).min(run.stats.iterations);
        for i in 0..samples {
            if i % ROUND == 0 && out_of_time() {
                return;
            }
            self.sample(run, REST);
        }
    }

    /// Chances of the compositions from the present distribution and, once there is one, the best model.
    fn plan(&self, run: &mut Run<'_>) {
        let problem = run.problem;
        let has_best = !self.kept.is_empty();
        let (qp, ql) = self.sampler.probabilities(self.sampler.epoch());
        let share_points: f64 = if has_best {
            qp.iter()
                .zip(&self.is_point_inlier)
                .map(|(q, is)| if *is { *q } else { 0.0 })
                .sum()
        } else {
            qp.iter()
                .zip(&problem.points)
                .map(|(q, p)| q * p.prior)
                .sum()
        };
        let share_lines: f64 = if has_best {
            ql.iter()
                .zip(&self.is_line_inlier)
                .map(|(q, is)| if *is { *q } else { 0.0 })
                .sum()
        } else {
            ql.iter()
                .zip(&problem.lines)
                .map(|(q, l)| q * l.prior)
                .sum()
        };
        let rank_us = ITEM_US * problem.len() as f64;
        let mut total = 0.0;
        for (choice, c) in run.choice.iter_mut().zip(&run.compositions) {
            *choice = c.map_or(0.0, |c| {
                let chance =
                    share_points.max(1e-3).powi(c.points) * share_lines.max(1e-3).powi(c.lines);
                let focal = if run.focal_weights.is_some() && c.kind != SolverKind::Pnplf {
                    FOCAL_HIT
                } else {
                    1.0
                };
                let value = focal * c.usefulness * chance / (c.cost_us + c.candidates * rank_us);
                value * value
            });
            total += *choice;
        }
        // No composition is given up: one in twenty-five draws at least.
        let floor = 0.04 * total.max(f64::MIN_POSITIVE);
        for (choice, c) in run.choice.iter_mut().zip(&run.compositions) {
            if c.is_some() {
                *choice += floor;
            }
        }
    }

    fn mark_inliers(&mut self, run: &Run<'_>) {
        let Some(best) = self.kept.first() else {
            return;
        };
        let problem = run.problem;
        let (fx, fy) = (problem.fx, problem.fy);
        let (tp, tl) = (
            run.options.max_point_error_px,
            run.options.max_line_error_px,
        );
        let model = &best.model;
        self.is_point_inlier.clear();
        self.is_point_inlier.extend(problem.points.iter().map(|p| {
            residuals::point(fx, fy, model, p).is_some_and(|(r, ..)| r.squared() < tp * tp)
        }));
        self.is_line_inlier.clear();
        self.is_line_inlier.extend(problem.lines.iter().map(|l| {
            residuals::line(fx, fy, model, l).is_some_and(|(r, state)| {
                r.r[0].abs() + r.r[1].abs() < tl
                    && residuals::overlaps(fx, fy, l, &state, model.focal)
            })
        }));
    }

    /// Whether a sample of inliers of the best model has been drawn with the wanted probability.
    fn is_confident(&self, run: &Run<'_>) -> bool {
        if self.kept.is_empty() {
            return false;
        }
        let share = |q: &[f64], is: &[bool]| -> f64 {
            q.iter()
                .zip(is)
                .map(|(q, is)| if *is { *q } else { 0.0 })
                .sum()
        };
        let mut log_miss = 0.0;
        for (d, draws) in run.draws.iter().enumerate() {
            if draws.iter().all(|n| *n == 0) {
                continue;
            }
            let (qp, ql) = self.sampler.probabilities(d);
            let (sp, sl) = (
                share(qp, &self.is_point_inlier),
                share(ql, &self.is_line_inlier),
            );
            for (n, c) in draws.iter().zip(&run.compositions) {
                if let Some(c) = c {
                    let focal = if run.focal_weights.is_some() && c.kind != SolverKind::Pnplf {
                        FOCAL_HIT
                    } else {
                        1.0
                    };
                    let hit = focal * c.usefulness * sp.powi(c.points) * sl.powi(c.lines);
                    log_miss += f64::from(*n) * crate::math::elementary::ln_1p(-hit.min(0.999));
                }
            }
        }
        log_miss <= ln(1.0 - run.options.confidence)
    }

    fn iterate(&mut self, run: &mut Run<'_>) {
        let problem = run.problem;
        let before = self.sampler.epoch();
        let d = self.sampler.next_distribution(problem, &mut run.rng);
        if self.sampler.epoch() != before {
            self.plan(run);
        }
        self.sample(run, d);
    }

    /// One sample from a distribution.
    fn sample(&mut self, run: &mut Run<'_>, d: usize) {
        let problem = run.problem;
        let total: f64 = run.choice.iter().sum();
        let mut pick = run.rng.uniform() * total;
        let mut k = 0;
        for (i, weight) in run.choice.iter().enumerate() {
            if *weight > 0.0 {
                k = i;
                if pick < *weight {
                    break;
                }
                pick -= weight;
            }
        }
        let Some(c) = run.compositions[k] else {
            return;
        };
        run.draws[d][k] += 1;
        run.pending = [c.kind];
        run.stats.per_solver[c.kind.index()].num_samples += 1;
        let (mut pi, mut li) = ([0usize; 4], [0usize; 4]);
        let pi = &mut pi[..c.points as usize];
        let li = &mut li[..c.lines as usize];
        if !self.sampler.draw_points(d, &mut run.rng, pi)
            || !self.sampler.draw_lines(d, &mut run.rng, li)
            || !is_sample_sound(problem, pi, li)
        {
            return;
        }
        let mut focal = 1.0;
        if let Some(weights) = &run.focal_weights {
            let total: f64 = weights.iter().sum();
            let mut pick = run.rng.uniform() * total;
            let mut bin = NUM_FOCAL_BINS - 1;
            for (i, w) in weights.iter().enumerate() {
                if pick < *w {
                    bin = i;
                    break;
                }
                pick -= w;
            }
            // The given camera's focal length is the larger image side here, see `estimate`.
            focal = exp(focal_bin_ln(bin as f64 + run.rng.uniform()));
        }
        let mut solutions = core::mem::take(&mut self.solutions);
        let mut focal_solutions = core::mem::take(&mut self.focal_solutions);
        solve(
            problem,
            c.kind,
            pi,
            li,
            focal,
            run.gravity.as_ref(),
            &mut solutions,
            &mut focal_solutions,
        );
        let mut best: Option<(Model, Ranking)> = None;
        let mut consider = |this: &mut Self, run: &mut Run<'_>, pose: &CamFromWorld, focal: f64| {
            let model = Model {
                rotation: pose.rotation,
                translation: pose.translation,
                focal,
            };
            if !is_plausible_on_sample(problem, &model, pi, li) {
                return;
            }
            run.stats.models_scored += 1;
            run.stats.per_solver[c.kind.index()].num_candidates += 1;
            let (floor, head) = this.kept.first().map_or((0.0, 0.0), |k| {
                (RIVAL_SHARE * k.ranking.total, k.ranking.head)
            });
            if let Some(ranking) = this.ranker.score_above(problem, &model, floor, head)
                && ranking.total > best.map_or(floor, |b| b.1.total)
            {
                best = Some((model, ranking));
            }
        };
        if c.kind == SolverKind::Pnplf {
            for s in focal_solutions.iter() {
                let relative = s.focal_px / (problem.fx * problem.fy).sqrt();
                if relative > FOCAL_RANGE.0 && relative < FOCAL_RANGE.1 {
                    consider(self, run, &s.cam_from_world, relative);
                }
            }
        } else {
            for pose in solutions.iter() {
                consider(self, run, pose, focal);
            }
        }
        self.solutions = solutions;
        self.focal_solutions = focal_solutions;
        if let Some((model, ranking)) = best {
            let is_best = self
                .kept
                .first()
                .is_none_or(|k| ranking.total > k.ranking.total);
            if !is_best {
                let is_known = self.kept.iter().any(|k| !k.model.is_distinct_from(&model));
                if is_known || run.rival_optimizations >= MAX_RIVAL_OPTIMIZATIONS {
                    return;
                }
                run.rival_optimizations += 1;
            }
            self.optimize(run, &model);
        }
    }

    /// Local optimisation; the better of the two models enters the list.
    fn optimize(&mut self, run: &mut Run<'_>, start: &Model) {
        run.stats.local_optimizations += 1;
        let problem = run.problem;
        let mut kept = Kept {
            model: *start,
            ranking: self.ranker.score(problem, start),
        };
        // A better model has new neighbours: go on while that pays.
        for _ in 0..3 {
            let Some(model) = self.refiner.quick(problem, &kept.model, &run.soft) else {
                break;
            };
            let ranking = self.ranker.score(problem, &model);
            let gain = ranking.total - kept.ranking.total;
            if gain > 0.0 {
                kept = Kept { model, ranking };
            }
            if !(gain > 0.02 * ranking.total) {
                break;
            }
        }
        if let (Some(weights), true) = (&mut run.focal_weights, kept.ranking.total > 0.0) {
            // What was found is evidence about the focal length.
            let position = (ln(kept.model.focal) - ln(FOCAL_RANGE.0))
                / (ln(FOCAL_RANGE.1) - ln(FOCAL_RANGE.0))
                * NUM_FOCAL_BINS as f64;
            for (i, w) in weights.iter_mut().enumerate() {
                let z = i as f64 + 0.5 - position;
                *w += 0.5 * exp(-0.5 * z * z);
            }
        }
        if self
            .kept
            .first()
            .is_none_or(|best| kept.ranking.total > best.ranking.total)
        {
            run.best_changed = true;
            run.stats.per_solver[run.pending[0].index()].num_wins += 1;
        }
        self.keep(kept);
    }

    /// Keeps the best distinct models, best first.
    pub(super) fn keep(&mut self, new: Kept) {
        if !(new.ranking.total > 0.0) {
            return;
        }
        let is_same = |k: &Kept| !k.model.is_distinct_from(&new.model);
        if self
            .kept
            .iter()
            .any(|k| is_same(k) && k.ranking.total >= new.ranking.total)
        {
            return;
        }
        self.kept.retain(|k| !is_same(k));
        let at = self
            .kept
            .iter()
            .position(|k| new.ranking.total > k.ranking.total)
            .unwrap_or(self.kept.len());
        self.kept.insert(at, new);
        self.kept.truncate(NUM_KEPT);
    }
}

/// Cheap tests that save a solver call.
fn is_sample_sound(problem: &Problem, points: &[usize], lines: &[usize]) -> bool {
    for (k, i) in points.iter().enumerate() {
        for j in &points[..k] {
            let d = problem.points[*i].uv - problem.points[*j].uv;
            if d.norm_squared() < MIN_POINT_DISTANCE_PX * MIN_POINT_DISTANCE_PX {
                return false;
            }
        }
    }
    if let [i, j, k] = *points {
        let x = |i: usize| problem.points[i].x;
        let (a, b) = (x(j) - x(i), x(k) - x(i));
        let longest = a
            .norm_squared()
            .max(b.norm_squared())
            .max((a - b).norm_squared());
        if a.cross(&b).norm_squared() < 1e-6 * longest * longest {
            return false;
        }
    }
    lines
        .iter()
        .all(|i| problem.lines[*i].length_px > MIN_LINE_LENGTH_PX)
}

fn sample_line(problem: &Problem, item: &LineItem, focal: f64) -> SampleLine {
    SampleLine {
        normal_in_cam: problem.plane_normal(item, focal),
        point_in_world: item.x1,
        direction_in_world: item.direction,
    }
}

#[expect(
    clippy::too_many_arguments,
    reason = "two output lists beside the sample"
)]
fn solve(
    problem: &Problem,
    kind: SolverKind,
    pi: &[usize],
    li: &[usize],
    focal: f64,
    gravity: Option<&GravityFrames>,
    out: &mut Solutions,
    focal_out: &mut FocalSolutions,
) {
    let bearing = |k: usize| problem.bearing(&problem.points[pi[k]].uv, focal);
    let x = |k: usize| problem.points[pi[k]].x;
    let line = |k: usize| sample_line(problem, &problem.lines[li[k]], focal);
    match kind {
        SolverKind::P3p => p3p(
            &[bearing(0), bearing(1), bearing(2)],
            &[x(0), x(1), x(2)],
            out,
        ),
        SolverKind::P2p1ll => p2p1ll(&[bearing(0), bearing(1)], &[x(0), x(1)], &line(0), out),
        SolverKind::P1p2ll => p1p2ll(&bearing(0), &x(0), &[line(0), line(1)], out),
        SolverKind::P3ll => p3ll(&[line(0), line(1), line(2)], out),
        SolverKind::Up2p | SolverKind::Up1p1ll => {
            let Some(frames) = gravity else {
                out.clear();
                return;
            };
            let (c, w) = (&frames.upright_from_cam, &frames.upright_from_world);
            if kind == SolverKind::Up2p {
                up2p(
                    &[c * bearing(0), c * bearing(1)],
                    &[w * x(0), w * x(1)],
                    out,
                );
            } else {
                let l = line(0);
                let turned = SampleLine {
                    normal_in_cam: c * l.normal_in_cam,
                    point_in_world: w * l.point_in_world,
                    direction_in_world: w * l.direction_in_world,
                };
                up1p1ll(&(c * bearing(0)), &(w * x(0)), &turned, out);
            }
            out.map(|pose| {
                CamFromWorld::new(
                    c.transpose() * pose.rotation * w,
                    c.transpose() * pose.translation,
                )
            });
        }
        SolverKind::Pnplf => {
            // The solver wants square pixels: measure y in the unit of x.
            let aspect = problem.fx / problem.fy;
            let unit = (problem.fx * problem.fy).sqrt() / problem.fx;
            let px = |k: usize| {
                let uv = problem.points[pi[k.min(pi.len() - 1)]].uv;
                nalgebra::Vector2::new(uv.x, uv.y * aspect) * unit
            };
            let pixels: [_; 4] = core::array::from_fn(|k| {
                if pi.is_empty() {
                    nalgebra::Vector2::zeros()
                } else {
                    px(k)
                }
            });
            let points: [_; 4] =
                core::array::from_fn(|k| if k < pi.len() { x(k) } else { Vector3::zeros() });
            let mut lines = [ImageLineCentered {
                line: Vector3::zeros(),
                point_in_world: Vector3::zeros(),
                direction_in_world: Vector3::x(),
            }; 4];
            for (slot, i) in lines.iter_mut().zip(li) {
                let l = &problem.lines[*i];
                let end = |uv: &nalgebra::Vector2<f64>| {
                    Vector3::new(uv.x * unit, uv.y * aspect * unit, 1.0)
                };
                *slot = ImageLineCentered {
                    line: end(&l.a).cross(&end(&l.b)),
                    point_in_world: l.x1,
                    direction_in_world: l.direction,
                };
            }
            pnplf(
                &pixels[..pi.len()],
                &points[..pi.len()],
                &lines[..li.len()],
                focal_out,
            );
        }
    }
}

/// Sampled points and both world ends of sampled lines lie in front, and the segments overlap: removes most candidates.
fn is_plausible_on_sample(problem: &Problem, model: &Model, pi: &[usize], li: &[usize]) -> bool {
    let (fx, fy) = (problem.fx, problem.fy);
    pi.iter().all(|i| {
        let z = model.rotation.row(2) * problem.points[*i].x;
        z[0] + model.translation.z > MIN_DEPTH
    }) && li.iter().all(|i| {
        let item = &problem.lines[*i];
        residuals::line(fx, fy, model, item)
            .is_some_and(|(_, state)| residuals::overlaps(fx, fy, item, &state, model.focal))
    })
}
