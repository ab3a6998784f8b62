//! The whole estimate: search, final refinement of the best distinct models, and the judgement of what came out.

use super::covariance::{self, Uncertainty};
use super::mirror::Mirror;
use super::options::{Focal, PoseOptions, WorldNoise, rigid};
use super::problem::{Model, Problem};
use super::ransac::{NUM_KEPT, Search};
use super::refine::{Kind, Refined, Scale};
use super::residuals;
use super::soft::Soft;
use super::types::{
    Degeneracy, LineCorrespondence, PointCorrespondence, PoseError, PoseEstimate, PoseOutcome,
    PoseStats, PoseStatus, RunnerUp, StopReason,
};
use super::watch::Watch;
use crate::geometry::{CamFromWorld, Camera};
use crate::math::elementary::ln;
use crate::math::order::sort_by_in;

/// Kept models whose ranking falls below this share of the best are not worth a final refinement.
const FINALIST_SHARE: f32 = 0.5;

/// A refinement with estimated noise that keeps less than this share of the ranking score has left the consensus.
const CONSENSUS_SHARE: f32 = 0.25;

/// Correspondences of which more than this share have alternatives were matched with landmarks.
const LANDMARK_SHARE: f64 = 0.2;

/// A finalist with less than this share of the consensus of the best one does not win by its likelihood, and one with less than
/// this share of the largest likelihood does not set that consensus.
const CONTENDER_SHARE: f32 = 0.65;
const CREDIBLE_SHARE: f64 = 0.4;

/// A runner-up with more than this share of the best model's log likelihood ratio makes the answer ambiguous.
const AMBIGUOUS_RATIO: f64 = 0.8;

/// Log evidence that a pose must have: odds of 1000 to 1 against chance.
const MIN_LOG_EVIDENCE: f64 = 6.9;

/// Of what the likelihood takes for inliers, at least this share must lie within the thresholds: the noise may be estimated at
/// twice the thresholds, but what is wider than that explains anything.
const MIN_SHARE_WITHIN: f64 = 0.1;

/// Spread of ln f around 1.2 times the larger image side for a camera of which nothing is known.
const UNKNOWN_FOCAL_SIGMA_LN: f64 = 1.0;

/// Correspondences within the thresholds at the returned pose, as indices of the caller's lists in ascending order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inliers {
    /// Of the points.
    pub points: Vec<u32>,
    /// Of the lines.
    pub lines: Vec<u32>,
}

/// A refined model and its ranking score.
#[derive(Debug, Clone, Copy)]
struct Finalist {
    refined: Refined,
    ranking: f32,
}

/// Buffers of the estimator, and what the last call says about each correspondence.
#[derive(Debug, Default)]
pub struct PoseScratch {
    problem: Problem,
    search: Search,
    mirror: Mirror,
    finalists: Vec<Finalist>,
    order: Vec<u32>,
    inliers: Inliers,
    point_posteriors: Vec<f32>,
    line_posteriors: Vec<f32>,
    point_errors_px: Vec<f32>,
    line_errors_px: Vec<[f32; 2]>,
}

impl PoseScratch {
    /// Empty buffers; they grow with the first problem.
    pub fn new() -> Self {
        Self::default()
    }

    /// Inliers of the last estimate; empty when there was none.
    pub fn inliers(&self) -> &Inliers {
        &self.inliers
    }

    /// Posterior inlier probabilities of the points, in the caller's order; 0 for dropped ones.
    pub fn point_posteriors(&self) -> &[f32] {
        &self.point_posteriors
    }

    /// Posterior inlier probabilities of the lines, in the caller's order; 0 for dropped ones.
    pub fn line_posteriors(&self) -> &[f32] {
        &self.line_posteriors
    }

    /// Reprojection errors of the points in pixels; infinite for those behind the camera and dropped ones.
    pub fn point_errors_px(&self) -> &[f32] {
        &self.point_errors_px
    }

    /// Distances in pixels of the observed ends to the projected lines; infinite for those behind the camera and dropped ones.
    pub fn line_errors_px(&self) -> &[[f32; 2]] {
        &self.line_errors_px
    }

    fn clear_reports(&mut self, num_points: usize, num_lines: usize) {
        self.inliers.points.clear();
        self.inliers.lines.clear();
        self.point_posteriors.clear();
        self.point_posteriors.resize(num_points, 0.0);
        self.line_posteriors.clear();
        self.line_posteriors.resize(num_lines, 0.0);
        self.point_errors_px.clear();
        self.point_errors_px.resize(num_points, f32::INFINITY);
        self.line_errors_px.clear();
        self.line_errors_px.resize(num_lines, [f32::INFINITY; 2]);
    }
}

/// Estimates the pose of a camera.
///
/// `clock` returns milliseconds from any origin; it is called only when the options set a time budget.
/// That no pose was found is a [`PoseStatus`] in the outcome, not an error.
///
/// # Errors
/// When the camera cannot project or an option has no meaning.
pub fn estimate(
    points: &[PointCorrespondence],
    lines: &[LineCorrespondence],
    camera: &Camera,
    options: &PoseOptions,
    scratch: &mut PoseScratch,
    clock: &mut dyn FnMut() -> f64,
) -> Result<PoseOutcome, PoseError> {
    let camera = match options.focal {
        // The search counts focal lengths in units of the larger side; the ratio of fx to fy stays the given one.
        Focal::Unknown => {
            camera.validate()?;
            let (fx, fy) = camera.focal_px();
            let max_side = f64::from(camera.width.max(camera.height));
            camera.with_focal_scaled(max_side / (fx * fy).sqrt())
        }
        _ => *camera,
    };
    let mut watch = Watch::start(clock, options.time_budget_ms);
    let mut outcome = begin(points, lines, &camera, options, scratch)?;
    let sample_size = match (options.focal, options.gravity.is_some()) {
        (Focal::Unknown, _) => 4,
        (_, false) => 3,
        (_, true) => 2,
    };
    if scratch.problem.len() < sample_size {
        return Ok(outcome);
    }
    if watch.is_over() {
        outcome.status = PoseStatus::OutOfTime;
        outcome.stats.stop = StopReason::TimeBudget;
        return Ok(outcome);
    }
    let soft = soft_terms(&scratch.problem, options);
    let stats = scratch
        .search
        .run(&scratch.problem, options, &soft, &mut watch);
    outcome.stats = PoseStats {
        num_invalid: outcome.stats.num_invalid,
        num_outside_view: outcome.stats.num_outside_view,
        num_left_out: outcome.stats.num_left_out,
        ..stats
    };
    refine_finalists(scratch, options, &soft, &mut watch);
    let Some(best) = scratch.finalists.first().copied() else {
        refuse(&scratch.problem, &mut outcome);
        return Ok(outcome);
    };
    judge(scratch, options, &camera, &best, &mut outcome);
    let num_inliers = scratch.inliers.points.len() + scratch.inliers.lines.len();
    let so_far = (num_inliers, best.ranking);
    if matches!(outcome.status, PoseStatus::Ok | PoseStatus::Ambiguous)
        && scratch
            .mirror
            .explains_more(&scratch.problem, options, &soft, so_far, &mut watch)
    {
        outcome.status = PoseStatus::LowInliers;
        outcome.degeneracy = Some(Degeneracy::Mirrored);
    }
    Ok(outcome)
}

/// Refines a pose that is nearly right, without a search: for correspondences that were found with the help of that pose.
///
/// `start` must be so near that most right correspondences lie within the thresholds of the options, which are what the
/// refinement begins with; it ends with the noise that the correspondences give and the residuals confirm. Gravity and the
/// covariance of a prior pose draw the result as in [`estimate`]; [`Focal::Refine`] and [`Focal::Unknown`] refine the focal
/// length from the camera's. Inliers, posteriors and errors are left in the scratch as after [`estimate`]; there is neither a
/// runner-up nor a test for a mirrored world. No allocation once the scratch has seen a problem of the size.
///
/// # Errors
/// When the camera cannot project, the start is no rigid transform, or an option has no meaning.
pub fn refine(
    points: &[PointCorrespondence],
    lines: &[LineCorrespondence],
    camera: &Camera,
    start: &CamFromWorld,
    options: &PoseOptions,
    scratch: &mut PoseScratch,
    clock: &mut dyn FnMut() -> f64,
) -> Result<PoseOutcome, PoseError> {
    rigid("start", start)?;
    let mut watch = Watch::start(clock, options.time_budget_ms);
    let mut outcome = begin(points, lines, camera, options, scratch)?;
    let problem = &scratch.problem;
    let num_unknown = if options.focal == Focal::Known { 3 } else { 4 };
    if problem.len() < num_unknown {
        return Ok(outcome);
    }
    let soft = soft_terms(problem, options);
    scratch.search.load(problem, options);
    let start = problem.model_from_pose(start, 1.0);
    let model = scratch
        .search
        .refiner
        .quick(problem, &start, &soft)
        .unwrap_or(start);
    let refined = scratch.search.refiner.full(
        problem,
        &model,
        options.sigma_px,
        &soft,
        Scale::Pixels,
        &mut watch,
    );
    if !refined.model.is_finite() || !refined.log_ratio.is_finite() {
        refuse(problem, &mut outcome);
        return Ok(outcome);
    }
    let ranking = scratch.search.ranker.score(problem, &refined.model).total;
    scratch.finalists.clear();
    let finalist = Finalist { refined, ranking };
    judge(scratch, options, camera, &finalist, &mut outcome);
    Ok(outcome)
}

/// Checks the input and loads it.
fn begin(
    points: &[PointCorrespondence],
    lines: &[LineCorrespondence],
    camera: &Camera,
    options: &PoseOptions,
    scratch: &mut PoseScratch,
) -> Result<PoseOutcome, PoseError> {
    camera.validate()?;
    options.validate()?;
    let limit = u32::MAX as usize;
    let count = points.len().max(lines.len());
    if count > limit {
        return Err(PoseError::TooMany { count, limit });
    }
    scratch.clear_reports(points.len(), lines.len());
    scratch.problem.load(points, lines, camera, options);
    Ok(PoseOutcome {
        status: PoseStatus::TooFew,
        degeneracy: None,
        estimate: None,
        stats: PoseStats {
            num_invalid: scratch.problem.num_invalid,
            num_outside_view: scratch.problem.num_outside_view,
            num_left_out: scratch.problem.num_left_out,
            ..PoseStats::default()
        },
    })
}

fn soft_terms(problem: &Problem, options: &PoseOptions) -> Soft {
    Soft {
        gravity: options
            .gravity
            .map(|g| (g.in_cam.normalize(), g.in_world.normalize(), g.sigma_rad)),
        prior: options.prior.and_then(|p| {
            let mut information = p.covariance?.try_inverse()?;
            // Translation in units of the scene scale.
            for i in 0..6 {
                for j in 0..6 {
                    let unit = |k: usize| if k < 3 { 1.0 } else { problem.scale };
                    information[(i, j)] *= unit(i) * unit(j);
                }
            }
            Some((problem.model_from_pose(&p.cam_from_world, 1.0), information))
        }),
        sigma_ln_focal: match options.focal {
            Focal::Known => None,
            Focal::Refine { sigma_ln } => Some(sigma_ln),
            Focal::Unknown => Some(UNKNOWN_FOCAL_SIGMA_LN),
        },
    }
}

/// Full refinement of the kept models that can still win; best first afterwards.
///
/// Where the wrong correspondences are not scattered but near misses (stairs, facades), an estimated noise grows until it
/// explains them too, and the pose becomes a compromise. That shows as a loss of consensus within the thresholds; the noise of
/// the thresholds is used then.
fn refine_finalists(
    scratch: &mut PoseScratch,
    options: &PoseOptions,
    soft: &Soft,
    watch: &mut Watch<'_>,
) {
    let problem = &scratch.problem;
    scratch.finalists.clear();
    scratch.finalists.reserve(NUM_KEPT);
    let search = &mut scratch.search;
    let Some(best) = search.kept.first().map(|k| k.ranking.total) else {
        return;
    };
    let are_landmarks = match options.world_noise {
        WorldNoise::Automatic => problem.alternative_share > LANDMARK_SHARE,
        WorldNoise::Estimated => false,
        WorldNoise::Negligible => true,
    };
    let mut scale = if are_landmarks {
        Scale::Pixels
    } else {
        Scale::Estimated
    };
    let mut i = 0;
    while let Some(k) = search.kept.get(i).copied() {
        let is_first = scratch.finalists.is_empty();
        if k.ranking.total < FINALIST_SHARE * best || (!is_first && watch.is_over()) {
            break;
        }
        let refined = search
            .refiner
            .full(problem, &k.model, options.sigma_px, soft, scale, watch);
        let ranking = search.ranker.score(problem, &refined.model).total;
        if is_first && scale == Scale::Estimated && !(ranking > CONSENSUS_SHARE * k.ranking.total) {
            scale = Scale::Thresholds;
            continue;
        }
        i += 1;
        if !refined.model.is_finite() || !refined.log_ratio.is_finite() {
            continue;
        }
        let finalist = Finalist { refined, ranking };
        // Two starts may end in the same optimum.
        let same = scratch
            .finalists
            .iter()
            .position(|f| !f.refined.model.is_distinct_from(&refined.model));
        match same {
            Some(i) if scratch.finalists[i].refined.log_ratio >= refined.log_ratio => {}
            Some(i) => scratch.finalists[i] = finalist,
            None => scratch.finalists.push(finalist),
        }
    }
    // A wide noise makes near misses inliers: what lost the consensus cannot win by its likelihood, as long as the
    // consensus has some likelihood itself.
    let most_likely = scratch
        .finalists
        .iter()
        .map(|f| f.refined.log_ratio)
        .fold(0.0, f64::max);
    let consensus = scratch
        .finalists
        .iter()
        .filter(|f| f.refined.log_ratio >= CREDIBLE_SHARE * most_likely)
        .map(|f| f.ranking)
        .fold(0.0, f32::max);
    // With an estimated noise that kept its consensus all may win. Each has chosen the noise that suits it, so the evidence at the
    // fixed noise of the thresholds counts beside its likelihood.
    let is_estimated = scale == Scale::Estimated;
    let is_contender = |f: &Finalist| is_estimated || f.ranking >= CONTENDER_SHARE * consensus;
    let evidence = |f: &Finalist| {
        let fixed = if is_estimated { f.ranking } else { 0.0 };
        f.refined.log_ratio + f64::from(fixed)
    };
    sort_by_in(&mut scratch.finalists, &mut scratch.order, |a, b| {
        is_contender(b)
            .cmp(&is_contender(a))
            .then(evidence(b).total_cmp(&evidence(a)))
    });
}

/// Reports at the returned pose, then the status.
fn judge(
    scratch: &mut PoseScratch,
    options: &PoseOptions,
    camera: &Camera,
    finalist: &Finalist,
    outcome: &mut PoseOutcome,
) {
    let has_focal = options.focal != Focal::Known;
    let problem = &scratch.problem;
    let best = &finalist.refined;
    let limits = (options.max_point_error_px, options.max_line_error_px);
    report_errors(
        problem,
        &best.model,
        limits,
        &mut scratch.inliers,
        &mut scratch.point_errors_px,
        &mut scratch.line_errors_px,
    );
    scratch.search.refiner.freeze_at(problem, best);
    let (mut found, mut weight_sum) = (0.0, 0.0);
    let (point_posteriors, line_posteriors) =
        (&mut scratch.point_posteriors, &mut scratch.line_posteriors);
    scratch
        .search
        .refiner
        .posteriors(problem, &best.model, |kind, i, p, odds| {
            match kind {
                Kind::Point => point_posteriors[i as usize] = p as f32,
                Kind::Line => line_posteriors[i as usize] = p as f32,
            }
            if p > 0.01 {
                found += p;
                weight_sum += p * ln(odds);
            }
        });
    let known: Uncertainty = covariance::uncertainty(problem, best, has_focal, limits);
    // The sample that made the model fits itself: its evidence is not evidence.
    let sample_size = if has_focal { 3.5 } else { 3.0 };
    let mean_weight = if found > 0.0 { weight_sum / found } else { 0.0 };
    let tried = f64::from(outcome.stats.models_scored.max(1));
    let log_evidence = best.log_ratio - sample_size * mean_weight.max(0.0) - ln(tried);
    let runner_up = scratch
        .finalists
        .iter()
        .skip(1)
        .max_by(|a, b| a.ranking.total_cmp(&b.ranking))
        .map(|second| RunnerUp {
            cam_from_world: problem.pose_from_model(&second.refined.model),
            score_ratio: f64::from(second.ranking / finalist.ranking.max(f32::MIN_POSITIVE)),
        });
    let focal_camera = if has_focal {
        camera.with_focal_scaled(best.model.focal)
    } else {
        *camera
    };
    let (fx, fy) = focal_camera.focal_px();
    outcome.estimate = Some(PoseEstimate {
        cam_from_world: problem.pose_from_model(&best.model),
        camera: focal_camera,
        covariance: known.covariance,
        sigma_rad: known.sigma_rad,
        sigma_m: known.sigma_m,
        sigma_focal_px: known.sigma_ln_focal * (fx * fy).sqrt(),
        world_sigma_m: best.noise.points.factor * best.noise.points.world_sigma * problem.scale,
        num_point_inliers: scratch.inliers.points.len() as u32,
        num_line_inliers: scratch.inliers.lines.len() as u32,
        score: best.log_ratio,
        log_evidence,
        runner_up,
    });
    let within = (scratch.inliers.points.len() + scratch.inliers.lines.len()) as f64;
    let is_supported = log_evidence > MIN_LOG_EVIDENCE && within >= MIN_SHARE_WITHIN * found;
    if !is_supported {
        refuse(problem, outcome);
        return;
    }
    outcome.degeneracy = known.degeneracy;
    outcome.status = if outcome.degeneracy.is_some() {
        PoseStatus::Degenerate
    } else if runner_up.is_some_and(|r| r.score_ratio > AMBIGUOUS_RATIO) {
        PoseStatus::Ambiguous
    } else {
        PoseStatus::Ok
    };
}

/// Why no pose has support.
fn refuse(problem: &Problem, outcome: &mut PoseOutcome) {
    outcome.degeneracy = covariance::of_input(problem);
    outcome.status = match (outcome.degeneracy, outcome.stats.stop) {
        (Some(_), _) => PoseStatus::Degenerate,
        (None, StopReason::TimeBudget) => PoseStatus::OutOfTime,
        (None, _) => PoseStatus::LowInliers,
    };
}

fn report_errors(
    problem: &Problem,
    model: &Model,
    (max_point, max_line): (f64, f64),
    inliers: &mut Inliers,
    point_errors: &mut [f32],
    line_errors: &mut [[f32; 2]],
) {
    let (fx, fy) = (problem.fx, problem.fy);
    for item in &problem.points {
        if let Some((r, ..)) = residuals::point(fx, fy, model, item) {
            let error = r.squared().sqrt();
            point_errors[item.source as usize] = error as f32;
            if error < max_point {
                inliers.points.push(item.source);
            }
        }
    }
    for item in &problem.lines {
        if let Some((r, state)) = residuals::line(fx, fy, model, item) {
            line_errors[item.source as usize] = r.r.map(|d| d.abs() as f32);
            if r.r[0].abs() + r.r[1].abs() < max_line
                && residuals::overlaps(fx, fy, item, &state, model.focal)
            {
                inliers.lines.push(item.source);
            }
        }
    }
    inliers.points.sort_unstable();
    inliers.lines.sort_unstable();
}
