//! Camera pose from 2D-3D points and lines.

mod options;
pub mod solvers;
mod types;

pub use options::{Focal, Gravity, PoseOptions, PriorPose};
pub use types::{
    Degeneracy, LineCorrespondence, PointCorrespondence, PoseError, PoseEstimate, PoseOutcome,
    PoseStats, PoseStatus, RunnerUp, SolverStats, StopReason,
};
