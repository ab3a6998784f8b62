//! What goes into the solver and what comes out of it.

use super::solvers::SolverKind;
use crate::geometry::{CamFromWorld, Camera, CameraError, Pixel};
use nalgebra::{Matrix6, Vector3};

/// A pixel of the sensor image paired with a world point. Several with exactly the same pixel are alternatives, of which at most
/// one is right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointCorrespondence {
    /// Corner-based, distorted as the camera delivers it.
    pub pixel: Pixel,
    /// Metres when the scene is metric.
    pub point_in_world: Vector3<f64>,
    /// 0..1, what the network believes; it guides sampling and weighs the score.
    pub confidence: f32,
    /// Standard deviation of the world point per axis across the viewing ray; 0 when unknown (a common value is then
    /// estimated).
    pub sigma_m: f32,
    /// Standard deviation of the pixel per axis; 0 for [`super::PoseOptions::sigma_px`].
    pub sigma_px: f32,
}

/// A segment of the sensor image paired with a world segment. Only the infinite lines are compared, so the ends may
/// slide along them, but the two pieces must overlap. Several with exactly the same ends are alternatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineCorrespondence {
    /// Corner-based, distorted as the camera delivers it, in the same convention as the points.
    pub start: Pixel,
    /// Second end.
    pub end: Pixel,
    /// World point for `start`.
    pub start_in_world: Vector3<f64>,
    /// World point for `end`.
    pub end_in_world: Vector3<f64>,
    /// 0..1, what the network believes.
    pub confidence: f32,
    /// Standard deviation of the world ends per axis across the line; 0 when unknown.
    pub sigma_m: f32,
    /// Standard deviation of the ends across the segment in pixels; 0 for [`super::PoseOptions::sigma_px`].
    pub sigma_px: f32,
}

/// Whether there is a pose, and if not, why.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseStatus {
    /// The estimate can be trusted as far as its covariance says.
    Ok,
    /// Fewer usable correspondences than one minimal sample needs; no estimate.
    TooFew,
    /// No pose explains the correspondences better than chance would.
    LowInliers,
    /// The inliers leave a direction of the pose (or the focal length) undetermined.
    Degenerate,
    /// Two clearly different poses explain the correspondences almost equally well.
    Ambiguous,
    /// The time budget ended before any trustworthy pose was found.
    OutOfTime,
}

impl PoseStatus {
    /// What happened and what helps, for people.
    pub fn message(self) -> &'static str {
        match self {
            Self::Ok => "located",
            Self::TooFew => {
                "too few usable correspondences for one minimal sample (three points or lines; four with unknown focal length): show more of the scene"
            }
            Self::LowInliers => {
                "no pose explains the correspondences better than chance: this is probably not the mapped place"
            }
            Self::Degenerate => {
                "the correspondences leave the pose or the focal length undetermined: show more depth or more directions"
            }
            Self::Ambiguous => {
                "two different poses fit almost equally well: show what tells repeated structures apart, or give a prior pose"
            }
            Self::OutOfTime => {
                "the time budget ended before a trustworthy pose was found: raise it or give better correspondences"
            }
        }
    }
}

/// Why an estimate is [`PoseStatus::Degenerate`], or [`PoseStatus::LowInliers`] for [`Self::Mirrored`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Degeneracy {
    /// The inlier points lie on one world line and no line adds a second direction.
    Collinear,
    /// The planes through the camera and the inlier lines all meet in one ray, or all lines are parallel.
    LineDirections,
    /// The covariance of the pose is not finite or larger than the scene.
    PoseUndetermined,
    /// Focal length and depth cannot be told apart: flat or fronto-parallel structure, or too narrow a view.
    FocalUndetermined,
    /// Many more correspondences would agree if the world were mirrored: the map is left-handed, or a sign is wrong.
    Mirrored,
}

/// Why the search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StopReason {
    /// It never started.
    #[default]
    NotStarted,
    /// A better model would have been drawn by now with the wanted probability.
    Confident,
    /// The iteration limit.
    IterationLimit,
    /// The time budget.
    TimeBudget,
}

/// How one minimal solver was used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SolverStats {
    /// Samples drawn for it.
    pub num_samples: u32,
    /// Candidate poses that passed the tests on their own sample.
    pub num_candidates: u32,
    /// Times one of them became the best model.
    pub num_wins: u32,
}

/// Where the time went.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseStats {
    /// Minimal samples drawn.
    pub iterations: u32,
    /// Candidate poses scored.
    pub models_scored: u32,
    /// Correspondences evaluated while scoring.
    pub items_evaluated: u64,
    /// Local optimisations run.
    pub local_optimizations: u32,
    /// Why the search ended.
    pub stop: StopReason,
    /// Use of each solver, indexed by [`SolverKind::index`].
    pub per_solver: [SolverStats; SolverKind::COUNT],
    /// Correspondences dropped because a number was not finite, a confidence lay outside 0..1 or a segment had no length.
    pub num_invalid: u32,
    /// Correspondences dropped because their pixel has no bearing within 80 degrees of the optical axis.
    pub num_outside_view: u32,
    /// Correspondences that the time budget had no room for: those with the least confidence of more than 400 points (or lines)
    /// a millisecond, but of more than 2000. 0 without a budget.
    pub num_left_out: u32,
}

/// A pose and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseEstimate {
    /// The pose.
    pub cam_from_world: CamFromWorld,
    /// The camera, with the estimated focal length when it was unknown.
    pub camera: Camera,
    /// Covariance of (rotation vector in radians, translation) of the left perturbation
    /// `cam_from_world <- exp(xi) cam_from_world`.
    pub covariance: Matrix6<f64>,
    /// Largest standard deviation of the rotation over all axes.
    pub sigma_rad: f64,
    /// Largest standard deviation of the camera position over all directions.
    pub sigma_m: f64,
    /// Standard deviation of the focal length in pixels; 0 when it was given.
    pub sigma_focal_px: f64,
    /// Common standard deviation of the world points that the residuals imply.
    pub world_sigma_m: f64,
    /// Point correspondences within the point threshold at this pose.
    pub num_point_inliers: u32,
    /// Line correspondences within the line threshold at this pose.
    pub num_line_inliers: u32,
    /// Score at this pose: sum of the evidence of all correspondences in nats; larger is better.
    pub score: f64,
    /// Log evidence against "everything is an outlier", after paying for the search; positive means better than chance.
    pub log_evidence: f64,
    /// The best clearly different pose, when one was found.
    pub runner_up: Option<RunnerUp>,
}

/// A second pose that also explains many correspondences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunnerUp {
    /// The pose.
    pub cam_from_world: CamFromWorld,
    /// Evidence within the thresholds, divided by that of the returned pose.
    pub score_ratio: f64,
}

/// What [`super::estimate`] found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseOutcome {
    /// Whether the estimate may be used.
    pub status: PoseStatus,
    /// What is undetermined, when the status is `Degenerate`.
    pub degeneracy: Option<Degeneracy>,
    /// Best pose found. Present with other states than `Ok` too, for callers that know better; always finite.
    pub estimate: Option<PoseEstimate>,
    /// Where the time went.
    pub stats: PoseStats,
}

impl PoseOutcome {
    /// The estimate, only when it can be trusted.
    pub fn located(&self) -> Option<&PoseEstimate> {
        match self.status {
            PoseStatus::Ok => self.estimate.as_ref(),
            _ => None,
        }
    }
}

/// A caller's mistake. That no pose was found is not an error but a [`PoseStatus`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// The camera cannot project.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// An option that has no meaning.
    #[error("pose option {name} is {value}; it must be {expected}")]
    Option {
        /// Field of the options.
        name: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// More correspondences than indices of 32 bits can name.
    #[error("{count} correspondences are more than the limit of {limit}")]
    TooMany {
        /// How many were given.
        count: usize,
        /// How many are allowed.
        limit: usize,
    },
}
