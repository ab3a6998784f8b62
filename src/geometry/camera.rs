//! Camera intrinsics. A camera never includes a pose.

use super::pixel::Pixel;
use nalgebra::Vector3;

/// Projection model with COLMAP's parameter order; pixels corner-based.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CameraModel {
    /// f, cx, cy
    SimplePinhole { f: f64, cx: f64, cy: f64 },
    /// fx, fy, cx, cy
    Pinhole { fx: f64, fy: f64, cx: f64, cy: f64 },
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

    /// Focal lengths along x and y in pixels.
    pub fn focal_px(&self) -> (f64, f64) {
        match self.model {
            CameraModel::SimplePinhole { f, .. } => (f, f),
            CameraModel::Pinhole { fx, fy, .. } => (fx, fy),
        }
    }

    /// Principal point.
    pub fn principal_point(&self) -> Pixel {
        match self.model {
            CameraModel::SimplePinhole { cx, cy, .. } | CameraModel::Pinhole { cx, cy, .. } => {
                Pixel::new(cx, cy)
            }
        }
    }

    /// Projects a point of camera space; `None` when it is not in front of the camera.
    pub fn pixel_from_cam(&self, point_in_cam: &Vector3<f64>) -> Option<Pixel> {
        if !(point_in_cam.z > 0.0) {
            return None;
        }
        let (fx, fy) = self.focal_px();
        let c = self.principal_point();
        Some(Pixel::new(
            fx * point_in_cam.x / point_in_cam.z + c.x,
            fy * point_in_cam.y / point_in_cam.z + c.y,
        ))
    }

    /// Unit vector in camera space through a pixel.
    pub fn bearing_from_pixel(&self, pixel: Pixel) -> Vector3<f64> {
        let (fx, fy) = self.focal_px();
        let c = self.principal_point();
        Vector3::new((pixel.x - c.x) / fx, (pixel.y - c.y) / fy, 1.0).normalize()
    }
}
