//! Camera intrinsics. A camera never includes a pose.
//!
//! Models, parameter order and distortion polynomials are COLMAP's; pixels are corner-based.
//! Undistortion is Newton on the exact Jacobian and is refused where the model folds over.

mod distortion;
mod model;
mod record;
#[cfg(test)]
mod tests;

pub use model::{CameraModel, ColmapModel};
pub use record::CameraRecord;

use super::pixel::{Pixel, PixelMap};
use nalgebra::{Matrix3, Vector2, Vector3};
use std::ops::RangeInclusive;

/// What is wrong with a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the message of each variant names its fields")]
pub enum CameraError {
    /// The image has no pixels.
    #[error("camera image size is {width}x{height}; both sides must be at least 1 pixel")]
    EmptyImage { width: u32, height: u32 },
    /// A focal length that cannot project.
    #[error("camera focal length is ({fx}, {fy}) px; both must be positive and finite")]
    Focal { fx: f64, fy: f64 },
    /// A parameter is NaN or infinite.
    #[error("camera parameter {index} of {model} is {value}; it must be finite")]
    NotFinite {
        model: &'static str,
        index: usize,
        value: f64,
    },
    /// Numbers that no camera has, however its pictures were scaled or cut.
    #[error(
        "focal lengths of {fx:?} and {fy:?} px with the principal point at ({cx:?}, {cy:?}) are of no camera with pictures of {width}x{height}"
    )]
    Implausible {
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        width: u32,
        height: u32,
    },
    /// A model name that is not one of the supported ones.
    #[error(
        "camera model {name:?} is not supported; use SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV or OPENCV_FISHEYE"
    )]
    UnknownModel { name: String },
    /// The parameter list does not fit the model.
    #[error("camera model {name} takes {expected} parameters, got {actual}")]
    NumParameters {
        name: String,
        expected: usize,
        actual: usize,
    },
}

/// Intrinsics and image size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Projection model and its parameters.
    pub model: CameraModel,
}

/// Focal lengths of cameras, by the larger side of their pictures: beyond, a number is not one, and scaling can make zero of it.
const FOCALS: RangeInclusive<f64> = 1e-3..=1e4;
/// A principal point lies at most so many larger sides from the corner: pictures that are cut out may have it outside.
const MAX_PRINCIPAL: f64 = 1e4;

impl Camera {
    /// Pinhole with one focal length and the principal point in the middle of the image.
    pub fn centered(width: u32, height: u32, f: f64) -> Self {
        Self {
            width,
            height,
            model: CameraModel::SimplePinhole {
                f,
                cx: 0.5 * f64::from(width),
                cy: 0.5 * f64::from(height),
            },
        }
    }

    /// Checks that the camera can project.
    ///
    /// # Errors
    /// When the image is empty, a focal length is not positive, or a parameter is not finite.
    pub fn validate(&self) -> Result<(), CameraError> {
        if self.width == 0 || self.height == 0 {
            return Err(CameraError::EmptyImage {
                width: self.width,
                height: self.height,
            });
        }
        let (fx, fy) = self.focal_px();
        if !(fx > 0.0 && fy > 0.0 && fx.is_finite() && fy.is_finite()) {
            return Err(CameraError::Focal { fx, fy });
        }
        let (params, n) = self.model.params();
        match params[..n].iter().position(|v| !v.is_finite()) {
            Some(index) => Err(CameraError::NotFinite {
                model: self.model.name(),
                index,
                value: params[index],
            }),
            None => Ok(()),
        }
    }

    /// Refuses cameras from outside whose numbers are positive and finite and still of no camera.
    ///
    /// # Errors
    /// [`CameraError::Implausible`].
    pub fn check_plausible(&self) -> Result<(), CameraError> {
        let (fx, fy) = self.focal_px();
        let Pixel { x: cx, y: cy } = self.principal_point();
        let (width, height) = (self.width, self.height);
        let side = f64::from(width.max(height));
        let is_focal = |f: f64| FOCALS.contains(&(f / side));
        let is_near = |c: f64| c.abs() <= MAX_PRINCIPAL * side;
        if is_focal(fx) && is_focal(fy) && is_near(cx) && is_near(cy) {
            return Ok(());
        }
        Err(CameraError::Implausible {
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        })
    }

    /// Focal lengths along x and y in pixels.
    pub fn focal_px(&self) -> (f64, f64) {
        let (params, _) = self.model.params();
        (params[0], params[self.model.num_focals() - 1])
    }

    /// Principal point.
    pub fn principal_point(&self) -> Pixel {
        let (params, _) = self.model.params();
        let n = self.model.num_focals();
        Pixel::new(params[n], params[n + 1])
    }

    /// The same camera with both focal lengths multiplied.
    pub fn with_focal_scaled(&self, factor: f64) -> Self {
        self.with_focals_scaled([factor; 2])
    }

    /// The same with its two focal lengths scaled each by its own factor; the principal point stays. A model with one focal length
    /// becomes the one with two when the factors differ.
    pub fn with_focals_scaled(&self, factors: [f64; 2]) -> Self {
        let model = if factors[0] == factors[1] {
            self.model
        } else {
            self.model.with_two_focals()
        };
        let (mut params, _) = model.params();
        for (f, factor) in params[..model.num_focals()].iter_mut().zip(factors) {
            *f *= factor;
        }
        Self {
            model: model.with_params(params),
            ..*self
        }
    }

    /// The same with another principal point.
    pub fn with_principal_point(&self, at: Pixel) -> Self {
        let (mut params, _) = self.model.params();
        let n = self.model.num_focals();
        [params[n], params[n + 1]] = [at.x, at.y];
        Self {
            model: self.model.with_params(params),
            ..*self
        }
    }

    /// The camera for pictures of another size, taken to be the same pictures resized; `None` where the shape differs by more
    /// than a size rounded to whole pixels does.
    pub fn for_size(&self, width: u32, height: u32) -> Option<Self> {
        let scale_x = f64::from(width) / f64::from(self.width);
        let off_px = (f64::from(self.height) * scale_x - f64::from(height)).abs();
        let is_same_shape = width > 0 && height > 0 && off_px.min(off_px / scale_x) <= 1.0;
        is_same_shape.then(|| self.stretched_to(width, height))
    }

    /// The camera of the whole picture resized to this size, each side by its own factor.
    pub fn stretched_to(&self, width: u32, height: u32) -> Self {
        let map = PixelMap::<(), ()>::from_scale(
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
        );
        Self {
            width,
            height,
            ..self.resized(&map)
        }
    }

    /// The camera of the same picture after a resize or crop. Distortion acts before the focal length, so its parameters
    /// stay; a model with one focal length becomes the one with two when the factors differ.
    pub fn resized<To, From>(&self, map: &PixelMap<To, From>) -> Self {
        let (sx, sy) = (map.scale_x, map.scale_y);
        let end = map.apply(Pixel::new(f64::from(self.width), f64::from(self.height)));
        let center = map.apply(self.principal_point());
        let model = if sx == sy {
            self.model
        } else {
            self.model.with_two_focals()
        };
        let (mut params, _) = model.params();
        let n = model.num_focals();
        params[0] *= sx;
        if n == 2 {
            params[1] *= sy;
        }
        (params[n], params[n + 1]) = (center.x, center.y);
        // Maps between pictures are made from whole pixels; rounding takes away the last digits.
        Self {
            width: libm::round(end.x) as u32,
            height: libm::round(end.y) as u32,
            model: model.with_params(params),
        }
    }

    /// The camera of the same picture after a clockwise turn by 90 degrees, and that turn in camera space.
    pub fn turned_clockwise(&self) -> (Self, Matrix3<f64>) {
        let (mut params, _) = self.model.params();
        let n = self.model.num_focals();
        params[..n].reverse();
        (params[n], params[n + 1]) = (f64::from(self.height) - params[n + 1], params[n]);
        if matches!(self.model, CameraModel::OpenCv { .. }) {
            (params[6], params[7]) = (params[7], -params[6]);
        }
        let camera = Self {
            width: self.height,
            height: self.width,
            model: self.model.with_params(params),
        };
        let turn = Matrix3::from_columns(&[Vector3::y(), -Vector3::x(), Vector3::z()]);
        (camera, turn)
    }

    /// Projects a point of camera space; `None` when it is not in front of the camera, or not on the part of the
    /// distortion model that can be inverted.
    pub fn pixel_from_cam(&self, point_in_cam: &Vector3<f64>) -> Option<Pixel> {
        let p = point_in_cam;
        let ideal = if self.model.is_fisheye() {
            let rho = crate::math::elementary::hypot(p.x, p.y);
            let theta = crate::math::elementary::atan2(rho, p.z);
            if !(rho > 0.0 || p.z > 0.0) {
                return None;
            }
            let scale = if rho > 0.0 { theta / rho } else { 0.0 };
            Vector2::new(p.x * scale, p.y * scale)
        } else {
            if !(p.z > 0.0) {
                return None;
            }
            Vector2::new(p.x / p.z, p.y / p.z)
        };
        let (d, j) = self.model.distort(ideal);
        if !(j[0] * j[3] - j[1] * j[2] > 0.0) {
            return None;
        }
        let (fx, fy) = self.focal_px();
        let c = self.principal_point();
        Some(Pixel::new(fx * d.x + c.x, fy * d.y + c.y))
    }

    /// Unit vector in camera space through a pixel; `None` where the distortion model cannot be inverted.
    pub fn bearing_from_pixel(&self, pixel: Pixel) -> Option<Vector3<f64>> {
        let (fx, fy) = self.focal_px();
        let c = self.principal_point();
        let d = Vector2::new((pixel.x - c.x) / fx, (pixel.y - c.y) / fy);
        let p = self.model.undistort(d)?;
        if self.model.is_fisheye() {
            let theta = p.norm();
            if theta > core::f64::consts::PI {
                return None;
            }
            let (s, z) = if theta > 0.0 {
                let sin = crate::math::elementary::sin(theta);
                (sin / theta, crate::math::elementary::cos(theta))
            } else {
                (1.0, 1.0)
            };
            return Some(Vector3::new(s * p.x, s * p.y, z));
        }
        Some(Vector3::new(p.x, p.y, 1.0).normalize())
    }
}
