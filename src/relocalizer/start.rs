//! Intrinsics before and after the pose.

use super::error::LocateError;
use super::options::{CameraSource, Query};
use crate::geometry::{Camera, WorkingFromSensor};
use crate::pose::{Focal, PoseEstimate};

/// Focal length divided by the longer side where nothing is known: the middle of phones' video cameras.
const ASSUMED_FOCAL: f64 = 0.85;

/// A camera in pixels of the frame, where it comes from, and how free its focal length is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) camera: Camera,
    pub(super) source: CameraSource,
    pub(super) focal: Focal,
}

impl Start {
    /// What the solver starts from in a frame of this size.
    pub(super) fn new((width, height): (u32, u32), query: &Query) -> Result<Self, LocateError> {
        if let Some(camera) = query.camera {
            camera.validate()?;
            if (camera.width, camera.height) != (width, height) {
                return Err(LocateError::CameraSize {
                    camera_width: camera.width,
                    camera_height: camera.height,
                    width,
                    height,
                });
            }
            return Ok(Self {
                camera,
                source: query.camera_source,
                focal: match query.camera_source.sigma_ln() {
                    None => Focal::Known,
                    Some(sigma_ln) => Focal::Refine { sigma_ln },
                },
            });
        }
        if let Some(belief) = query.focal {
            let focal_px = belief.focal_per_width * f64::from(width);
            return Ok(Self {
                camera: Camera::centered(width, height, focal_px),
                source: CameraSource::Remembered,
                focal: if belief.is_frozen() {
                    Focal::Known
                } else {
                    Focal::Refine {
                        sigma_ln: belief.sigma_ln,
                    }
                },
            });
        }
        let focal_px = ASSUMED_FOCAL * f64::from(width.max(height));
        Ok(Self {
            camera: Camera::centered(width, height, focal_px),
            source: CameraSource::Assumed,
            focal: Focal::Unknown,
        })
    }

    /// The camera as solved, and the relative standard deviation of its focal length, `None` where it was given. Intrinsics that
    /// contradict what was seen were replaced; they are estimated ones then.
    /// `in_working` is the camera that the solver was handed, in the picture that `working` leads to.
    pub(super) fn solved(
        &self,
        in_working: &Camera,
        working: &WorkingFromSensor,
        estimate: &PoseEstimate,
    ) -> (Camera, CameraSource, Option<f64>) {
        let (fx, fy) = estimate.camera.focal_px();
        let (given_fx, given_fy) = in_working.focal_px();
        let is_scaled = estimate.camera.principal_point() == in_working.principal_point()
            && (fy * given_fx - fx * given_fy).abs() < 1e-9 * fx * given_fy;
        let factor = fx / given_fx;
        if self.focal == Focal::Known && is_scaled && factor == 1.0 {
            return (self.camera, self.source, None);
        }
        let camera = if is_scaled {
            self.camera.with_focal_scaled(factor)
        } else {
            Camera {
                width: self.camera.width,
                height: self.camera.height,
                ..estimate.camera.resized(&working.inverse())
            }
        };
        let source = match (self.source, self.focal) {
            (CameraSource::Assumed, _) | (_, Focal::Known) => CameraSource::Estimated,
            _ if !is_scaled => CameraSource::Estimated,
            (other, _) => other,
        };
        (camera, source, Some(estimate.sigma_focal_px / fx))
    }
}
