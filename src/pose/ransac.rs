//! The search: draw, solve, test on the sample, rank, optimise locally, stop when a better model would have been seen.
//!
//! Compositions (how many points and lines a sample has) are drawn by value per time: the chance that all items are inliers
//! under the present distribution, times the usefulness of the solver, over its cost. The stopping rule adds up, over
//! distributions and compositions, the log probability that none of the samples drawn so far was all inliers of the best
//! model; it is exact for any mix of samplers (for uniform draws it becomes the usual rule).

use super::composition::{Composition, MAX_COMPOSITIONS};
use super::focal_belief::{self, FocalBelief};
use super::options::{Focal, PoseOptions};
use super::problem::{Model, Problem};
use super::refine::Refiner;
use super::residuals;
use super::sample::{GravityFrames, Sample};
use super::sampler::{NUM_DISTRIBUTIONS, REST, Sampler};
use super::scoring::{Ranker, Ranking};
use super::soft::Soft;
use super::solvers::{FocalSolutions, Solutions, SolverKind};
use super::types::{PoseStats, StopReason};
use super::watch::Watch;
use crate::geometry::CamFromWorld;
use crate::math::Rng;
use crate::math::elementary::{ln, ln_1p};

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
    focal_belief: Option<FocalBelief>,
    rival_optimizations: u32,
    best_changed: bool,
    pending: [SolverKind; 1],
}

impl Search {
    /// Prepares ranking and refinement; nothing is kept yet.
    pub(super) fn load(&mut self, problem: &Problem, options: &PoseOptions) {
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
        self.kept.clear();
        self.kept.reserve(NUM_KEPT + 1);
    }

    /// Searches; afterwards `kept` holds the distinct models found, best first.
    pub(super) fn run(
        &mut self,
        problem: &Problem,
        options: &PoseOptions,
        soft: &Soft,
        watch: &mut Watch<'_>,
    ) -> PoseStats {
        self.load(problem, options);
        self.sampler.load(problem);
        let is_focal_unknown = options.focal == Focal::Unknown;
        let mut run = Run {
            problem,
            options,
            soft: *soft,
            rng: Rng::from_seed(options.seed),
            stats: PoseStats::default(),
            compositions: Composition::usable(
                problem.points.len(),
                problem.lines.len(),
                options.gravity.is_some(),
                is_focal_unknown,
            ),
            choice: [0.0; MAX_COMPOSITIONS],
            draws: [[0; MAX_COMPOSITIONS]; NUM_DISTRIBUTIONS],
            gravity: options.gravity.as_ref().map(GravityFrames::new),
            focal_belief: is_focal_unknown.then(FocalBelief::of_photographs),
            rival_optimizations: 0,
            best_changed: false,
            pending: [SolverKind::P3p],
        };
        if let Some(prior) = &options.prior {
            let model = problem.model_from_pose(&prior.cam_from_world, 1.0);
            if model.is_finite() {
                self.optimize(&mut run, &model);
                self.mark_inliers(&run);
            }
        }
        self.plan(&mut run);
        if run.compositions[0].is_none() {
            return run.stats;
        }
        loop {
            if run.stats.iterations.is_multiple_of(ROUND) {
                if watch.is_search_over() {
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
        self.look_for_rival(&mut run, watch);
        run.stats.items_evaluated = self.ranker.items_evaluated;
        run.stats
    }

    /// Samples only what the best model leaves unexplained: in a place with repeated structure the second answer is there.
    fn look_for_rival(&mut self, run: &mut Run<'_>, watch: &mut Watch<'_>) {
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
                hit += choice / total * c.hit(sp, sl, false);
            }
        }
        // 95 % of the rivals of that size are found.
        let wanted = 3.0 / hit.max(1e-9);
        let samples = (wanted.min(f64::from(MAX_RIVAL_SAMPLES)) as u32).min(run.stats.iterations);
        for i in 0..samples {
            if i.is_multiple_of(ROUND) && watch.is_search_over() {
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
                .map(|(q, p)| q * p.belief.prior)
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
                .map(|(q, l)| q * l.belief.prior)
                .sum()
        };
        let is_focal_drawn = run.focal_belief.is_some();
        let mut total = 0.0;
        for (choice, c) in run.choice.iter_mut().zip(&run.compositions) {
            *choice = c.map_or(0.0, |c| {
                let hit = c.hit(
                    share_points.max(1e-3),
                    share_lines.max(1e-3),
                    is_focal_drawn,
                );
                let value = hit / c.time_us(problem.len());
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
                    let hit = c.hit(sp, sl, run.focal_belief.is_some());
                    log_miss += f64::from(*n) * ln_1p(-hit.min(0.999));
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
        {
            return;
        }
        let mut sample = Sample {
            kind: c.kind,
            points: pi,
            lines: li,
            focal: 1.0,
        };
        if !sample.is_sound(problem) {
            return;
        }
        if let Some(belief) = &run.focal_belief {
            // The given camera's focal length is the larger image side here, see `estimate`.
            sample.focal = belief.draw(&mut run.rng);
        }
        let mut solutions = core::mem::take(&mut self.solutions);
        let mut focal_solutions = core::mem::take(&mut self.focal_solutions);
        sample.solve(
            problem,
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
            if !sample.is_explained_by(problem, &model) {
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
                if focal_belief::is_considered(relative) {
                    consider(self, run, &s.cam_from_world, relative);
                }
            }
        } else {
            for pose in solutions.iter() {
                consider(self, run, pose, sample.focal);
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
        if let (Some(belief), true) = (&mut run.focal_belief, kept.ranking.total > 0.0) {
            // What was found is evidence about the focal length.
            belief.found(kept.model.focal);
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
