//! Bundle adjustment: cameras, shared intrinsics and points that together explain the observations best.
//!
//! Levenberg and Marquardt with gain ratio on the normal equations; points are eliminated (Schur complement), the reduced system
//! of the cameras with a border of shared focal length and radial term is solved densely. Robust losses by re-weighting.
//! A camera is moved by a rotation on its left and a shift of its *centre*, so that priors of positions are linear.
//! Triggs et al., Bundle adjustment: a modern synthesis (2000); Nielsen's damping (1999).
//!
//! Units: pixels of error, world units as given. Nothing is random; the order of all sums is fixed.

mod gauge;
mod model;
mod priors;
mod system;
#[cfg(test)]
mod tests;

use crate::geometry::CamFromWorld;
use crate::math::elementary::ln_1p;
use nalgebra::{Vector2, Vector3};
use system::System;

/// A picture's pose in the adjustment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleCamera {
    /// Moves unless fixed.
    pub cam_from_world: CamFromWorld,
    /// Index into [`BundleProblem::intrinsics`].
    pub intrinsics: usize,
    /// Stays where it is.
    pub is_fixed: bool,
}

/// Focal length and radial term that pictures share: `place = f (1 + k r^2) (x / z, y / z)` with r on the plane z = 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// In pixels.
    pub focal_px: f64,
    /// COLMAP's k of SIMPLE_RADIAL.
    pub k: f64,
    /// Known beforehand: ln f and k with standard deviations.
    pub prior: Option<IntrinsicsPrior>,
}

/// What is known about intrinsics beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IntrinsicsPrior {
    /// Focal length in pixels.
    pub focal_px: f64,
    /// Standard deviation of ln f.
    pub sigma_ln: f64,
    /// Standard deviation of k about 0.
    pub sigma_k: f64,
}

/// A keypoint that sees a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleObservation {
    /// Index into [`BundleProblem::cameras`].
    pub camera: u32,
    /// Index into [`BundleProblem::points`].
    pub point: u32,
    /// Relative to the principal point, in pixels.
    pub place_px: Vector2<f64>,
}

/// A pose that a camera had before, as a headset or a scanner reports it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePrior {
    /// Index into [`BundleProblem::cameras`].
    pub camera: u32,
    /// The reported pose.
    pub cam_from_world: CamFromWorld,
    /// Standard deviation of the rotation about each axis.
    pub sigma_rad: f64,
    /// Standard deviation of the position along each axis.
    pub sigma_position: f64,
}

/// How two cameras lay to each other before: short stretches of a drifting track are right where the whole is not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativePrior {
    /// Indices into [`BundleProblem::cameras`].
    pub cameras: (u32, u32),
    /// The reported poses of both.
    pub cam_from_world: (CamFromWorld, CamFromWorld),
    /// Standard deviation of the relative rotation about each axis.
    pub sigma_rad: f64,
    /// Standard deviation of the relative position along each axis.
    pub sigma_position: f64,
}

/// Everything that is adjusted, and what it is adjusted to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BundleProblem {
    /// Poses.
    pub cameras: Vec<BundleCamera>,
    /// Shared intrinsics.
    pub intrinsics: Vec<Intrinsics>,
    /// Points in the world.
    pub points: Vec<Vector3<f64>>,
    /// In the order of their points.
    pub observations: Vec<BundleObservation>,
    /// Absolute priors.
    pub pose_priors: Vec<PosePrior>,
    /// Relative priors.
    pub relative_priors: Vec<RelativePrior>,
}

/// What an error costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Its square.
    Squares,
    /// Its square up to this many pixels, linear beyond.
    Huber(f64),
    /// Logarithmic beyond this many pixels.
    Cauchy(f64),
}

impl Loss {
    /// Cost and weight (its derivative) of a squared error.
    pub(super) fn at(self, squared: f64) -> (f64, f64) {
        match self {
            Self::Squares => (squared, 1.0),
            Self::Huber(c) => {
                if squared <= c * c {
                    (squared, 1.0)
                } else {
                    let error = squared.sqrt();
                    (2.0 * c * error - c * c, c / error)
                }
            }
            Self::Cauchy(c) => {
                let ratio = squared / (c * c);
                (c * c * ln_1p(ratio), 1.0 / (1.0 + ratio))
            }
        }
    }
}

/// What may move, and when to stop.
#[derive(Debug, Clone, PartialEq)]
pub struct BundleOptions {
    /// Of reprojection errors.
    pub loss: Loss,
    /// Whether focal lengths move.
    pub refines_focal: bool,
    /// Whether radial terms move.
    pub refines_radial: bool,
    /// Steps at most.
    pub max_iterations: usize,
    /// Relative decrease of the cost below which it has converged.
    pub tolerance: f64,
}

impl Default for BundleOptions {
    fn default() -> Self {
        Self {
            loss: Loss::Cauchy(1.5),
            refines_focal: false,
            refines_radial: false,
            max_iterations: 30,
            tolerance: 1e-5,
        }
    }
}

/// How it went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleSummary {
    /// Half the sum of all losses, before.
    pub initial_cost: f64,
    /// And after.
    pub final_cost: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Whether the cost had stopped falling.
    pub is_converged: bool,
}

/// An index that points nowhere.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "bundle adjustment: observation {observation} names camera {camera} and point {point}; there are {num_cameras} and {num_points}, and observations go in the order of their points"
)]
pub struct BundleError {
    /// Position in the list.
    pub observation: usize,
    /// What it names.
    pub camera: u32,
    /// What it names.
    pub point: u32,
    /// How many there are.
    pub num_cameras: usize,
    /// How many there are.
    pub num_points: usize,
}

fn validate(problem: &BundleProblem) -> Result<(), BundleError> {
    let (num_cameras, num_points) = (problem.cameras.len(), problem.points.len());
    let mut last = 0;
    for (i, o) in problem.observations.iter().enumerate() {
        if o.camera as usize >= num_cameras || o.point as usize >= num_points || o.point < last {
            return Err(BundleError {
                observation: i,
                camera: o.camera,
                point: o.point,
                num_cameras,
                num_points,
            });
        }
        last = o.point;
    }
    Ok(())
}

/// Moves everything that may move to the least cost. Without fixed cameras and priors the first camera is held, and the scale
/// by one coordinate of the camera farthest from it.
///
/// # Errors
/// When an observation names what is not there, or they are out of order.
pub fn adjust(
    problem: &mut BundleProblem,
    options: &BundleOptions,
) -> Result<BundleSummary, BundleError> {
    validate(problem)?;
    let mut system = System::new(problem, options);
    let initial_cost = system.cost(problem, &problem.observations);
    let mut cost = initial_cost;
    let (mut lambda, mut growth) = (1e-4, 2.0);
    let mut iterations = 0;
    let mut is_converged = false;
    // Not the loop of `math::least_squares`: equations of thousands of unknowns cost much more than their cost alone, so they are
    // made for steps that are taken only, and the damping follows the gain that the step predicts.
    system.linearise(problem);
    while iterations < options.max_iterations && !is_converged {
        iterations += 1;
        let Some(step) = system.solve(lambda) else {
            lambda *= growth;
            growth *= 2.0;
            if lambda > 1e12 {
                break;
            }
            continue;
        };
        let moved = system.moved(problem, &step);
        let moved_cost = system.cost(&moved, &problem.observations);
        let gain = (cost - moved_cost) / step.predicted.max(f64::MIN_POSITIVE);
        if moved_cost < cost {
            is_converged = cost - moved_cost < options.tolerance * cost;
            (problem.cameras, problem.intrinsics, problem.points) =
                (moved.cameras, moved.intrinsics, moved.points);
            cost = moved_cost;
            let shape = 2.0 * gain - 1.0;
            lambda = (lambda * (1.0 - shape * shape * shape).max(1.0 / 5.0)).max(1e-10);
            growth = 2.0;
            if !is_converged && iterations < options.max_iterations {
                system.linearise(problem);
            }
        } else {
            is_converged = step.predicted < 1e-3 * options.tolerance * cost;
            lambda *= growth;
            growth *= 2.0;
            if lambda > 1e12 {
                break;
            }
        }
    }
    Ok(BundleSummary {
        initial_cost,
        final_cost: cost,
        iterations,
        is_converged,
    })
}

/// Standard deviation of ln f for each of the intrinsics, from the curvature at the solution and the observations' own
/// scatter; `None` when focal lengths do not move or are undetermined.
pub fn focal_sigmas(problem: &BundleProblem, options: &BundleOptions) -> Option<Vec<f64>> {
    validate(problem).ok()?;
    let mut system = System::new(problem, options);
    system.linearise(problem);
    system.focal_sigmas(problem)
}
