//! Camera intrinsics. A camera never includes a pose.
//!
//! Models, parameter order and distortion polynomials are COLMAP's; pixels are corner-based.
//! Undistortion is Newton on the exact Jacobian and is refused where the model folds over.

use super::pixel::{Pixel, PixelMap};
use nalgebra::{Vector2, Vector3};

/// Projection model with COLMAP's parameter order; pixels corner-based.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(missing_docs, reason = "each variant lists its parameters")]
pub enum CameraModel {
    /// f, cx, cy
    SimplePinhole { f: f64, cx: f64, cy: f64 },
    /// fx, fy, cx, cy
    Pinhole { fx: f64, fy: f64, cx: f64, cy: f64 },
    /// f, cx, cy, k
    SimpleRadial { f: f64, cx: f64, cy: f64, k: f64 },
    /// f, cx, cy, k1, k2
    Radial {
        f: f64,
        cx: f64,
        cy: f64,
        k1: f64,
        k2: f64,
    },
    /// fx, fy, cx, cy, k1, k2, p1, p2
    OpenCv {
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        k1: f64,
        k2: f64,
        p1: f64,
        p2: f64,
    },
    /// fx, fy, cx, cy, k1, k2, k3, k4; equidistant with an odd polynomial in the angle
    OpenCvFisheye {
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        k1: f64,
        k2: f64,
        k3: f64,
        k4: f64,
    },
}

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

impl CameraModel {
    /// COLMAP's name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::SimplePinhole { .. } => "SIMPLE_PINHOLE",
            Self::Pinhole { .. } => "PINHOLE",
            Self::SimpleRadial { .. } => "SIMPLE_RADIAL",
            Self::Radial { .. } => "RADIAL",
            Self::OpenCv { .. } => "OPENCV",
            Self::OpenCvFisheye { .. } => "OPENCV_FISHEYE",
        }
    }

    /// From COLMAP's name and parameter list.
    ///
    /// # Errors
    /// When the name is unknown or the number of parameters does not fit it.
    pub fn from_colmap(name: &str, params: &[f64]) -> Result<Self, CameraError> {
        let expected = match name {
            "SIMPLE_PINHOLE" => 3,
            "PINHOLE" | "SIMPLE_RADIAL" => 4,
            "RADIAL" => 5,
            "OPENCV" | "OPENCV_FISHEYE" => 8,
            _ => {
                return Err(CameraError::UnknownModel {
                    name: name.to_owned(),
                });
            }
        };
        Ok(match (name, params) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => Self::SimplePinhole { f, cx, cy },
            ("PINHOLE", &[fx, fy, cx, cy]) => Self::Pinhole { fx, fy, cx, cy },
            ("SIMPLE_RADIAL", &[f, cx, cy, k]) => Self::SimpleRadial { f, cx, cy, k },
            ("RADIAL", &[f, cx, cy, k1, k2]) => Self::Radial { f, cx, cy, k1, k2 },
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => Self::OpenCv {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                p1,
                p2,
            },
            ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => Self::OpenCvFisheye {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                k3,
                k4,
            },
            _ => {
                return Err(CameraError::NumParameters {
                    name: name.to_owned(),
                    expected,
                    actual: params.len(),
                });
            }
        })
    }

    /// Parameters in COLMAP's order, and how many of the eight are used.
    pub fn params(&self) -> ([f64; 8], usize) {
        match *self {
            Self::SimplePinhole { f, cx, cy } => ([f, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0], 3),
            Self::Pinhole { fx, fy, cx, cy } => ([fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0], 4),
            Self::SimpleRadial { f, cx, cy, k } => ([f, cx, cy, k, 0.0, 0.0, 0.0, 0.0], 4),
            Self::Radial { f, cx, cy, k1, k2 } => ([f, cx, cy, k1, k2, 0.0, 0.0, 0.0], 5),
            Self::OpenCv {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                p1,
                p2,
            } => ([fx, fy, cx, cy, k1, k2, p1, p2], 8),
            Self::OpenCvFisheye {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                k3,
                k4,
            } => ([fx, fy, cx, cy, k1, k2, k3, k4], 8),
        }
    }

    /// Ideal image coordinates (z = 1 plane, or angle-scaled direction for the fisheye) to distorted ones, with the
    /// Jacobian in row-major order.
    fn distort(&self, p: Vector2<f64>) -> (Vector2<f64>, [f64; 4]) {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = |k1: f64, k2: f64| {
            let s = 1.0 + r2 * (k1 + r2 * k2);
            let ds = 2.0 * (k1 + 2.0 * r2 * k2);
            (s, ds)
        };
        match *self {
            Self::SimplePinhole { .. } | Self::Pinhole { .. } => (p, [1.0, 0.0, 0.0, 1.0]),
            Self::SimpleRadial { k, .. } => radial_jacobian(x, y, radial(k, 0.0)),
            Self::Radial { k1, k2, .. } => radial_jacobian(x, y, radial(k1, k2)),
            Self::OpenCv { k1, k2, p1, p2, .. } => {
                let (d, j) = radial_jacobian(x, y, radial(k1, k2));
                let tangential = Vector2::new(
                    2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                );
                (
                    d + tangential,
                    [
                        j[0] + 2.0 * p1 * y + 6.0 * p2 * x,
                        j[1] + 2.0 * p1 * x + 2.0 * p2 * y,
                        j[2] + 2.0 * p1 * x + 2.0 * p2 * y,
                        j[3] + 6.0 * p1 * y + 2.0 * p2 * x,
                    ],
                )
            }
            Self::OpenCvFisheye { k1, k2, k3, k4, .. } => {
                // p = theta * direction here, so the polynomial is radial in theta.
                let s = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
                let ds = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4)));
                radial_jacobian(x, y, (s, ds))
            }
        }
    }

    fn is_fisheye(&self) -> bool {
        matches!(self, Self::OpenCvFisheye { .. })
    }

    /// Inverse of [`Self::distort`]; `None` where it does not converge onto the branch that starts at the centre.
    fn undistort(&self, distorted: Vector2<f64>) -> Option<Vector2<f64>> {
        if matches!(self, Self::SimplePinhole { .. } | Self::Pinhole { .. }) {
            return Some(distorted);
        }
        let mut p = distorted;
        for _ in 0..50 {
            let (d, j) = self.distort(p);
            let e = d - distorted;
            let det = j[0] * j[3] - j[1] * j[2];
            if !(det > 0.0) {
                // Beyond the fold of the polynomial: move back towards the centre and try again.
                p *= 0.7;
                continue;
            }
            let step = Vector2::new(
                (j[3] * e.x - j[1] * e.y) / det,
                (j[0] * e.y - j[2] * e.x) / det,
            );
            p -= step;
            if step.norm_squared() < 1e-26 * (1.0 + p.norm_squared()) {
                let (back, j) = self.distort(p);
                let is_on_branch = j[0] * j[3] - j[1] * j[2] > 0.0;
                return (is_on_branch && (back - distorted).norm() < 1e-9).then_some(p);
            }
        }
        None
    }
}

fn radial_jacobian(x: f64, y: f64, (s, ds): (f64, f64)) -> (Vector2<f64>, [f64; 4]) {
    (
        Vector2::new(s * x, s * y),
        [s + ds * x * x, ds * x * y, ds * x * y, s + ds * y * y],
    )
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

    /// Focal lengths along x and y in pixels.
    pub fn focal_px(&self) -> (f64, f64) {
        match self.model {
            CameraModel::SimplePinhole { f, .. }
            | CameraModel::SimpleRadial { f, .. }
            | CameraModel::Radial { f, .. } => (f, f),
            CameraModel::Pinhole { fx, fy, .. }
            | CameraModel::OpenCv { fx, fy, .. }
            | CameraModel::OpenCvFisheye { fx, fy, .. } => (fx, fy),
        }
    }

    /// The same camera with both focal lengths multiplied.
    pub fn with_focal_scaled(&self, factor: f64) -> Self {
        let mut camera = *self;
        match &mut camera.model {
            CameraModel::SimplePinhole { f, .. }
            | CameraModel::SimpleRadial { f, .. }
            | CameraModel::Radial { f, .. } => *f *= factor,
            CameraModel::Pinhole { fx, fy, .. }
            | CameraModel::OpenCv { fx, fy, .. }
            | CameraModel::OpenCvFisheye { fx, fy, .. } => {
                *fx *= factor;
                *fy *= factor;
            }
        }
        camera
    }

    /// The camera of the same picture after a resize or crop. Distortion acts before the focal length, so its parameters
    /// stay; a model with one focal length becomes the one with two when the factors differ.
    pub fn resized<To, From>(&self, map: &PixelMap<To, From>) -> Self {
        let (sx, sy) = (map.scale_x, map.scale_y);
        let end = map.apply(Pixel::new(f64::from(self.width), f64::from(self.height)));
        let at = |cx: f64, cy: f64| {
            let c = map.apply(Pixel::new(cx, cy));
            (c.x, c.y)
        };
        let two = |fx: f64, fy: f64, cx: f64, cy: f64, k1: f64, k2: f64, p1: f64, p2: f64| {
            let ((cx, cy), fx, fy) = (at(cx, cy), sx * fx, sy * fy);
            CameraModel::OpenCv {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                p1,
                p2,
            }
        };
        let model = match self.model {
            CameraModel::SimplePinhole { f, cx, cy } if sx == sy => {
                let (cx, cy) = at(cx, cy);
                CameraModel::SimplePinhole { f: sx * f, cx, cy }
            }
            CameraModel::SimplePinhole { f, cx, cy } => {
                let (cx, cy) = at(cx, cy);
                CameraModel::Pinhole {
                    fx: sx * f,
                    fy: sy * f,
                    cx,
                    cy,
                }
            }
            CameraModel::Pinhole { fx, fy, cx, cy } => {
                let (cx, cy) = at(cx, cy);
                CameraModel::Pinhole {
                    fx: sx * fx,
                    fy: sy * fy,
                    cx,
                    cy,
                }
            }
            CameraModel::SimpleRadial { f, cx, cy, k } => two(f, f, cx, cy, k, 0.0, 0.0, 0.0),
            CameraModel::Radial { f, cx, cy, k1, k2 } => two(f, f, cx, cy, k1, k2, 0.0, 0.0),
            CameraModel::OpenCv {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                p1,
                p2,
            } => two(fx, fy, cx, cy, k1, k2, p1, p2),
            CameraModel::OpenCvFisheye {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                k3,
                k4,
            } => {
                let (cx, cy) = at(cx, cy);
                CameraModel::OpenCvFisheye {
                    fx: sx * fx,
                    fy: sy * fy,
                    cx,
                    cy,
                    k1,
                    k2,
                    k3,
                    k4,
                }
            }
        };
        // Maps between pictures are made from whole pixels; rounding takes away the last digits.
        Self {
            width: libm::round(end.x) as u32,
            height: libm::round(end.y) as u32,
            model,
        }
    }

    /// Principal point.
    pub fn principal_point(&self) -> Pixel {
        match self.model {
            CameraModel::SimplePinhole { cx, cy, .. }
            | CameraModel::Pinhole { cx, cy, .. }
            | CameraModel::SimpleRadial { cx, cy, .. }
            | CameraModel::Radial { cx, cy, .. }
            | CameraModel::OpenCv { cx, cy, .. }
            | CameraModel::OpenCvFisheye { cx, cy, .. } => Pixel::new(cx, cy),
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resized_camera_projects_to_the_resized_pixel() {
        let map: PixelMap<super::super::Working, super::super::Sensor> =
            PixelMap::from_scale(640.0 / 1279.0, 361.0 / 721.0);
        let p = Vector3::new(0.4, -0.2, 1.3);
        let (f, cx, cy, k): (f64, f64, f64, f64) = (900.0, 630.0, 365.0, 0.05);
        for model in [
            CameraModel::SimplePinhole { f, cx, cy },
            CameraModel::Pinhole {
                fx: f,
                fy: 880.0,
                cx,
                cy,
            },
            CameraModel::SimpleRadial { f, cx, cy, k },
            CameraModel::Radial {
                f,
                cx,
                cy,
                k1: k,
                k2: -0.01,
            },
            CameraModel::OpenCv {
                fx: f,
                fy: 880.0,
                cx,
                cy,
                k1: k,
                k2: 0.0,
                p1: 0.001,
                p2: 0.002,
            },
            CameraModel::OpenCvFisheye {
                fx: f,
                fy: f,
                cx,
                cy,
                k1: k,
                k2: 0.0,
                k3: 0.0,
                k4: 0.0,
            },
        ] {
            let camera = Camera {
                width: 1279,
                height: 721,
                model,
            };
            let resized = camera.resized(&map);
            assert_eq!((resized.width, resized.height), (640, 361));
            let expected = map.apply(camera.pixel_from_cam(&p).expect("in front"));
            let found = resized.pixel_from_cam(&p).expect("in front");
            assert!(found.distance(expected) < 1e-9, "{model:?}");
        }
    }

    fn models() -> Vec<Camera> {
        [
            ("SIMPLE_PINHOLE", vec![525.0, 320.0, 240.0]),
            ("PINHOLE", vec![525.0, 530.0, 321.0, 239.0]),
            ("SIMPLE_RADIAL", vec![525.0, 320.0, 240.0, -0.12]),
            ("RADIAL", vec![525.0, 320.0, 240.0, 0.11, -0.03]),
            (
                "OPENCV",
                vec![525.0, 515.0, 318.0, 243.0, -0.2, 0.06, 0.001, -0.002],
            ),
            (
                "OPENCV_FISHEYE",
                vec![280.0, 285.0, 320.0, 240.0, 0.03, -0.01, 0.004, -0.001],
            ),
        ]
        .into_iter()
        .map(|(name, params)| Camera {
            width: 640,
            height: 480,
            model: CameraModel::from_colmap(name, &params).expect("valid"),
        })
        .collect()
    }

    #[test]
    fn projection_undoes_unprojection_on_a_grid() {
        for camera in models() {
            assert_eq!(camera.validate(), Ok(()));
            let c = camera.principal_point();
            for i in 0..=60 {
                for j in 0..=60 {
                    let mut p = Pixel::new(640.0 * f64::from(i) / 60.0, 8.0 * f64::from(j));
                    if i == 30 && j == 30 {
                        p = Pixel::new(c.x + 1e-6, c.y - 1e-6);
                    }
                    let bearing = camera.bearing_from_pixel(p).expect("inside the image");
                    assert!((bearing.norm() - 1.0).abs() < 1e-14);
                    let back = camera.pixel_from_cam(&(bearing * 3.7)).expect("in front");
                    assert!(back.distance(p) < 1e-8, "{} {p:?}", camera.model.name());
                }
            }
        }
    }

    #[test]
    fn distortion_jacobian_agrees_with_central_differences() {
        for camera in models() {
            for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.4)] {
                let (_, j) = camera.model.distort(Vector2::new(x, y));
                let h = 1e-6;
                let at = |x: f64, y: f64| camera.model.distort(Vector2::new(x, y)).0;
                let dx = (at(x + h, y) - at(x - h, y)) / (2.0 * h);
                let dy = (at(x, y + h) - at(x, y - h)) / (2.0 * h);
                let numeric = [dx.x, dy.x, dx.y, dy.y];
                for k in 0..4 {
                    assert!((j[k] - numeric[k]).abs() < 1e-8, "{}", camera.model.name());
                }
            }
        }
    }

    #[test]
    fn refuses_pixels_beyond_the_fold() {
        // x (1 - 0.5 x^2) has its maximum 0.544 at x = 0.816: nothing projects further out.
        let camera = Camera {
            width: 640,
            height: 480,
            model: CameraModel::SimpleRadial {
                f: 500.0,
                cx: 320.0,
                cy: 240.0,
                k: -0.5,
            },
        };
        assert!(
            camera
                .bearing_from_pixel(Pixel::new(320.0 + 250.0, 240.0))
                .is_some()
        );
        assert!(
            camera
                .bearing_from_pixel(Pixel::new(320.0 + 300.0, 240.0))
                .is_none()
        );
        assert!(
            camera
                .pixel_from_cam(&Vector3::new(0.9, 0.0, 1.0))
                .is_none()
        );
        assert!(
            camera
                .bearing_from_pixel(Pixel::new(f64::NAN, 0.0))
                .is_none()
        );
    }

    #[test]
    fn fisheye_sees_behind_the_image_plane() {
        let camera = models()[5];
        let bearing = Vector3::new(0.98, 0.1, -0.1).normalize();
        let pixel = camera
            .pixel_from_cam(&bearing)
            .expect("95 degrees off axis");
        let back = camera.bearing_from_pixel(pixel).expect("inverts");
        assert!((back - bearing).norm() < 1e-10);
    }

    #[test]
    fn rejects_broken_cameras() {
        assert!(matches!(
            CameraModel::from_colmap("OPENCV", &[1.0]),
            Err(CameraError::NumParameters {
                expected: 8,
                actual: 1,
                ..
            })
        ));
        assert!(matches!(
            CameraModel::from_colmap("FOV", &[1.0]),
            Err(CameraError::UnknownModel { .. })
        ));
        assert!(matches!(
            Camera::centered(640, 480, f64::NAN).validate(),
            Err(CameraError::Focal { .. })
        ));
        assert!(matches!(
            Camera::centered(0, 480, 500.0).validate(),
            Err(CameraError::EmptyImage { .. })
        ));
    }
}
