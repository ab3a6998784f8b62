//! Camera pose from 2D-3D points and lines, most of which may be wrong.
//!
//! In: [`PointCorrespondence`]s and [`LineCorrespondence`]s with the network's confidence, a [`Camera`]. Out: a
//! [`PoseOutcome`]: the pose `cam_from_world` with covariance, or the reason why there is none.
//! Spaces and units: pixels of the sensor image, corner-based, the same for points, line ends and principal point; world units
//! as given (nothing depends on their size).
//! Algorithm: `docs/benchmarks/pose.md` says how well it does; [`solvers`] the minimal problems, `sampler` the
//! confidence-weighted sampling, `composition` what each kind of sample is worth, `scoring` the truncated likelihood, `ransac`
//! the search with local optimisation and stopping rule, `likelihood` and `refine` the heavy-tailed refinement, `soft` what is
//! known besides, `covariance` what is known in the end,
//! `mirror` whether the map is left-handed, `watch` the time budget, `budget_cap` how many correspondences it has room for.
//! Invariants: deterministic by seed (the same bits on every target when no time budget is set); never a pose that is not
//! finite; bad correspondences are dropped and counted.
//! Cost: linear in correspondences times iterations; no allocation once the scratch has seen a problem of the size.

mod budget_cap;
mod composition;
mod covariance;
mod focal_belief;
mod kernels;
mod likelihood;
mod mirror;
mod noise;
mod normal;
mod options;
mod problem;
mod ransac;
mod refine;
mod residuals;
mod sample;
mod sampler;
mod scoring;
mod soft;
pub mod solvers;
mod types;
mod verdict;
mod watch;

pub use options::{Focal, Gravity, PoseOptions, PriorPose, WorldNoise};
pub use types::{
    Degeneracy, LineCorrespondence, PointCorrespondence, PoseError, PoseEstimate, PoseOutcome,
    PoseStats, PoseStatus, RunnerUp, SolverStats, StopReason,
};
pub use verdict::{Inliers, PoseScratch, estimate, refine};
