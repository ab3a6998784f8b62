//! What the caller can choose.

use super::types::PoseError;
use crate::geometry::CamFromWorld;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// The direction of gravity as an inertial sensor reports it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gravity {
    /// Direction of gravity in camera space; need not be a unit vector.
    pub in_cam: Vector3<f64>,
    /// Direction of gravity in the world.
    pub in_world: Vector3<f64>,
    /// Standard deviation of the angle between the two; phones reach 0.3 to 2 degrees.
    pub sigma_rad: f64,
}

/// A pose that is probably near: from tracking, or from retrieval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorPose {
    /// The pose. It is scored and refined before any sampling.
    pub cam_from_world: CamFromWorld,
    /// Covariance of (rotation, translation) of the left perturbation. With it the final refinement is drawn towards the
    /// prior; without it the prior is a start value only.
    pub covariance: Option<Matrix6<f64>>,
}

/// What is known about the focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Focal {
    /// The camera's is exact.
    Known,
    /// The camera's is a guess with this relative standard deviation; it is refined with the pose.
    Refine {
        /// Standard deviation of ln f.
        sigma_ln: f64,
    },
    /// Nothing but the image size is known.
    Unknown,
}

/// What the final refinement assumes about the noise of the world coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorldNoise {
    /// What the correspondences are decides. A regressor gives each pixel one world point; where a good part of the pixels
    /// come with several, they were matched with landmarks. `Negligible` for those, else `Estimated`.
    Automatic,
    /// From the residuals, for points and lines each: how wide the errors are, how much of them grows as the world comes near,
    /// and whether some are exact and the others near misses. Right for regressed coordinates, whose errors are continuous and
    /// often wider than the thresholds, and for the nearest landmark of each pixel.
    Estimated,
    /// Nothing beside the noise of the pixels: right for matched landmarks, whose outliers are often near misses (the next
    /// stair, the next window) that an estimated noise would take for inliers.
    Negligible,
}

/// Options of [`super::estimate`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseOptions {
    /// A point is an inlier when its reprojection error is below this.
    pub max_point_error_px: f64,
    /// A line is an inlier when the two distances of its observed ends to the projected line add up to less than this.
    pub max_line_error_px: f64,
    /// Standard deviation of a detected pixel; the rest of the error comes from the world point.
    pub sigma_px: f64,
    /// Slope and offset of the calibration from the network's confidence to an inlier probability:
    /// `logit(probability) = slope * logit(confidence) + offset`.
    pub calibration: (f64, f64),
    /// Probability with which no better model is missed.
    pub confidence: f64,
    /// Limit on minimal samples.
    pub max_iterations: u32,
    /// Samples drawn before the stopping rule is asked.
    pub min_iterations: u32,
    /// Time budget of the whole call in milliseconds of the caller's clock; `None` for no limit. It bounds the number of
    /// correspondences that are used too ([`super::PoseStats::num_left_out`]).
    pub time_budget_ms: Option<f64>,
    /// Same seed, same input, no time budget: same bits.
    pub seed: u64,
    /// What is known about the focal length.
    pub focal: Focal,
    /// What is assumed about the noise of the world coordinates.
    pub world_noise: WorldNoise,
    /// Direction of gravity, if known.
    pub gravity: Option<Gravity>,
    /// Pose to start from, if one is known.
    pub prior: Option<PriorPose>,
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            max_point_error_px: 12.0,
            max_line_error_px: 10.0,
            sigma_px: 1.0,
            calibration: (1.0, 0.0),
            confidence: 0.999,
            max_iterations: 100_000,
            min_iterations: 48,
            time_budget_ms: None,
            seed: 0,
            focal: Focal::Known,
            world_noise: WorldNoise::Automatic,
            gravity: None,
            prior: None,
        }
    }
}

impl PoseOptions {
    /// Checks that every option has a meaning.
    ///
    /// # Errors
    /// Names the first option that has none.
    pub fn validate(&self) -> Result<(), PoseError> {
        let positive = |name, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(())
            } else {
                Err(PoseError::Option {
                    name,
                    value,
                    expected: "positive and finite",
                })
            }
        };
        positive("max_point_error_px", self.max_point_error_px)?;
        positive("max_line_error_px", self.max_line_error_px)?;
        positive("sigma_px", self.sigma_px)?;
        if !(self.calibration.0.is_finite() && self.calibration.1.is_finite()) {
            return Err(PoseError::Option {
                name: "calibration",
                value: self.calibration.0 + self.calibration.1,
                expected: "finite",
            });
        }
        if !(self.confidence > 0.0 && self.confidence < 1.0) {
            return Err(PoseError::Option {
                name: "confidence",
                value: self.confidence,
                expected: "between 0 and 1",
            });
        }
        if let Some(budget) = self.time_budget_ms
            && !(budget >= 0.0)
        {
            return Err(PoseError::Option {
                name: "time_budget_ms",
                value: budget,
                expected: "zero or positive",
            });
        }
        if let Focal::Refine { sigma_ln } = self.focal {
            positive("focal.sigma_ln", sigma_ln)?;
        }
        if let Some(gravity) = &self.gravity {
            positive("gravity.sigma_rad", gravity.sigma_rad)?;
            positive("gravity.in_cam (length)", gravity.in_cam.norm())?;
            positive("gravity.in_world (length)", gravity.in_world.norm())?;
        }
        if let Some(prior) = &self.prior {
            rigid("prior.cam_from_world", &prior.cam_from_world)?;
            if let Some(covariance) = &prior.covariance
                && covariance.cholesky().is_none()
            {
                return Err(PoseError::Option {
                    name: "prior.covariance (trace)",
                    value: covariance.trace(),
                    expected: "positive definite",
                });
            }
        }
        Ok(())
    }
}

/// Checks that a given pose is one.
pub(super) fn rigid(name: &'static str, given: &CamFromWorld) -> Result<(), PoseError> {
    let sum = given.rotation.sum() + given.translation.sum();
    let skew = (given.rotation.transpose() * given.rotation - Matrix3::identity())
        .abs()
        .max();
    if sum.is_finite() && skew < 1e-6 && given.rotation.determinant() > 0.0 {
        return Ok(());
    }
    Err(PoseError::Option {
        name,
        value: skew,
        expected: "a finite rigid transform (the value is how far its rotation is from an orthonormal one)",
    })
}
