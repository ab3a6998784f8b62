//! Cameras as files write them: COLMAP's model names, ids and parameter order.
//!
//! The core projects with six models. The others become one of them where that is exact, or are fitted to the fisheye
//! polynomial where distortion is radial; a fit that is off by more than [`MAX_FIT_ERROR_PX`] is refused.

use landline::geometry::{COLMAP_MODELS, Camera, CameraError, CameraModel};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Largest error of a fitted camera model inside the picture.
pub const MAX_FIT_ERROR_PX: f64 = 0.1;

/// COLMAP's models beyond those of the core: name and number of parameters; their ids follow.
const OTHER_MODELS: [(&str, usize); 12] = [
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// Name and number of parameters of the model with COLMAP's id.
pub(super) fn colmap_model(id: u32) -> Option<(&'static str, usize)> {
    let id = usize::try_from(id).ok()?;
    COLMAP_MODELS.iter().chain(&OTHER_MODELS).nth(id).copied()
}

/// Why a camera of a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CameraRecordError {
    /// The core refuses it.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// No model of the core comes close.
    #[error(
        "camera model {model} with these parameters cannot be expressed closely enough ({what}); undistort the \
         pictures first (COLMAP: image_undistorter)"
    )]
    NotExpressible {
        /// COLMAP's name.
        model: String,
        /// What stands against it.
        what: String,
    },
}

/// A camera in COLMAP's words, as JSON writes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraRecord {
    /// COLMAP's name of the model.
    pub model: String,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// In COLMAP's order.
    pub params: Vec<f64>,
}

impl CameraRecord {
    /// The camera in COLMAP's words.
    pub fn from_camera(camera: &Camera) -> Self {
        let (params, count) = camera.model.params();
        Self {
            model: camera.model.name().to_owned(),
            width: camera.width,
            height: camera.height,
            params: params.into_iter().take(count).collect(),
        }
    }

    /// The camera that the words describe.
    ///
    /// # Errors
    /// Unknown model, wrong number of parameters, values no camera has, or a model that cannot be expressed.
    pub fn to_camera(&self) -> Result<Camera, CameraRecordError> {
        let camera = Camera {
            width: self.width,
            height: self.height,
            model: self.to_model()?,
        };
        camera.validate()?;
        Ok(camera)
    }

    fn to_model(&self) -> Result<CameraModel, CameraRecordError> {
        let no = |what: String| CameraRecordError::NotExpressible {
            model: self.model.clone(),
            what,
        };
        let known = |name: &str, params: &[f64]| CameraModel::from_colmap(name, params);
        let fisheye = |fx, fy, cx, cy, k: [f64; 4]| {
            known("OPENCV_FISHEYE", &[fx, fy, cx, cy, k[0], k[1], k[2], k[3]])
        };
        let p = self.params.as_slice();
        Ok(match (self.model.as_str(), p) {
            ("SIMPLE_FISHEYE", &[f, cx, cy]) => fisheye(f, f, cx, cy, [0.0; 4])?,
            ("FISHEYE", &[fx, fy, cx, cy]) => fisheye(fx, fy, cx, cy, [0.0; 4])?,
            ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => {
                fisheye(f, f, cx, cy, [k, 0.0, 0.0, 0.0])?
            }
            ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => fisheye(f, f, cx, cy, [k1, k2, 0.0, 0.0])?,
            ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, s1, s2]) => {
                if [p1, p2, s1, s2] != [0.0; 4] {
                    return Err(no("it has tangential or prism distortion".to_owned()));
                }
                fisheye(fx, fy, cx, cy, [k1, k2, k3, k4])?
            }
            ("RAD_TAN_THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k0, k1, k2, k3, ref rest @ ..])
                if rest.len() == 8 =>
            {
                if rest.iter().any(|v| *v != 0.0) {
                    return Err(no(
                        "it has tangential or prism distortion or a sixth-order term".to_owned(),
                    ));
                }
                fisheye(fx, fy, cx, cy, [k0, k1, k2, k3])?
            }
            ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
                if [k3, k4, k5, k6] == [0.0; 4] {
                    return Ok(known("OPENCV", &p[..8])?);
                }
                if [p1, p2] != [0.0; 2] {
                    return Err(no(
                        "it has tangential distortion beside the rational term".to_owned()
                    ));
                }
                self.fitted([fx, fy, cx, cy], |angle| {
                    let r = angle.tan();
                    let r2 = r * r;
                    r * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
                        / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
                })?
            }
            ("FOV", &[fx, fy, cx, cy, omega]) => self.fitted([fx, fy, cx, cy], |angle| {
                (angle.tan() * 2.0 * (0.5 * omega).tan()).atan() / omega
            })?,
            ("SIMPLE_DIVISION", &[f, cx, cy, k]) => {
                self.fitted([f, f, cx, cy], |angle| division(angle.tan(), k))?
            }
            ("DIVISION", &[fx, fy, cx, cy, k]) => {
                self.fitted([fx, fy, cx, cy], |angle| division(angle.tan(), k))?
            }
            ("EUCM", &[fx, fy, cx, cy, alpha, beta]) => self.fitted([fx, fy, cx, cy], |angle| {
                let (sin, cos) = angle.sin_cos();
                sin / (alpha * (beta * sin * sin + cos * cos).sqrt() + (1.0 - alpha) * cos)
            })?,
            ("EQUIRECTANGULAR", _) => {
                return Err(no("a panorama has no focal length".to_owned()));
            }
            (name, _) => match OTHER_MODELS.iter().find(|(n, _)| *n == name) {
                // The right number of parameters was handled above.
                Some((_, expected)) => {
                    return Err(CameraError::NumParameters {
                        name: name.to_owned(),
                        expected: *expected,
                        actual: p.len(),
                    }
                    .into());
                }
                None => known(name, p)?,
            },
        })
    }

    /// Fits the fisheye polynomial to a radial model, given as image radius by angle from the axis, over the angles
    /// that the picture shows.
    fn fitted(
        &self,
        [fx, fy, cx, cy]: [f64; 4],
        radius: impl Fn(f64) -> f64,
    ) -> Result<CameraModel, CameraRecordError> {
        let no = |what: String| CameraRecordError::NotExpressible {
            model: self.model.clone(),
            what,
        };
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let corner = (cx.max(w - cx) / fx).hypot(cy.max(h - cy) / fy);
        // The angle of the farthest corner, by bisection on the rising part of the model.
        let (mut low, mut high) = (0.0, 1.5);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let r = radius(middle);
            if r.is_finite() && r > 0.0 && r < corner {
                low = middle;
            } else {
                high = middle;
            }
        }
        let widest = high;
        if !(radius(low) > 0.98 * corner) {
            return Err(no("it folds over inside the picture".to_owned()));
        }
        // The polynomial starts with slope 1; another slope goes into the focal length.
        let slope = radius(1e-4) / 1e-4;
        if !(slope > 0.0) {
            return Err(no("it does not grow from the centre".to_owned()));
        }
        let (fx, fy) = (fx * slope, fy * slope);
        const SAMPLES: usize = 100;
        let angle = |i: usize| widest * (i + 1) as f64 / SAMPLES as f64;
        let left = DMatrix::from_fn(SAMPLES, 4, |i, j| angle(i).powi(2 * j as i32 + 3));
        let right = DVector::from_fn(SAMPLES, |i, _| radius(angle(i)) / slope - angle(i));
        let k = left
            .clone()
            .svd(true, true)
            .solve(&right, 1e-14)
            .map_err(|e| no(e.to_owned()))?;
        let error = (left * &k - right).abs().max() * fx.max(fy);
        if !(error <= MAX_FIT_ERROR_PX) {
            return Err(no(format!("the best fit is off by {error:.2} px")));
        }
        let params = [fx, fy, cx, cy, k[0], k[1], k[2], k[3]];
        Ok(CameraModel::from_colmap("OPENCV_FISHEYE", &params)?)
    }
}

/// Distorted radius of the division model, whose undistorted radius is r / (1 + k r^2).
fn division(undistorted: f64, k: f64) -> f64 {
    let product = undistorted * k;
    let root = (1.0 - 4.0 * product * undistorted).sqrt();
    // Written so that small k does not cancel.
    2.0 * undistorted / (1.0 + root)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn project(model: &str, params: &[f64], x: f64, y: f64) -> (f64, f64) {
        let camera = CameraRecord {
            model: model.to_owned(),
            width: 640,
            height: 480,
            params: params.to_vec(),
        }
        .to_camera()
        .expect("expressible");
        let pixel = camera
            .pixel_from_cam(&Vector3::new(x, y, 1.0))
            .expect("in front");
        (pixel.x, pixel.y)
    }

    #[test]
    fn models_outside_the_core_project_as_colmap_does() {
        // Pixels by pycolmap 4.2.0, Camera.img_from_cam.
        for (model, params, x, expected) in [
            (
                "SIMPLE_DIVISION",
                vec![500.0, 320.0, 240.0, -0.2],
                0.2,
                419.212_549_6,
            ),
            (
                "EUCM",
                vec![500.0, 500.0, 320.0, 240.0, 0.6, 1.1],
                0.4,
                510.356_319_99,
            ),
            (
                "FOV",
                vec![500.0, 500.0, 320.0, 240.0, 0.9],
                0.4,
                524.869_928_797,
            ),
        ] {
            let (u, v) = project(model, &params, x, 0.0);
            assert!(
                (u - expected).abs() < MAX_FIT_ERROR_PX,
                "{model}: {u} {expected}"
            );
            assert!((v - 240.0).abs() < 1e-9);
        }
        assert_eq!(
            project(
                "SIMPLE_RADIAL_FISHEYE",
                &[300.0, 320.0, 240.0, 0.02],
                0.3,
                0.1
            ),
            project(
                "OPENCV_FISHEYE",
                &[300.0, 300.0, 320.0, 240.0, 0.02, 0.0, 0.0, 0.0],
                0.3,
                0.1
            )
        );
    }

    #[test]
    fn refuses_what_it_cannot_express() {
        let record = |model: &str, params: &[f64]| {
            CameraRecord {
                model: model.to_owned(),
                width: 640,
                height: 480,
                params: params.to_vec(),
            }
            .to_camera()
            .expect_err("not expressible")
            .to_string()
        };
        assert!(record("EQUIRECTANGULAR", &[640.0, 480.0]).contains("panorama"));
        assert!(record("FOV", &[500.0]).contains("takes 5 parameters, got 1"));
        assert!(record("PINHOLE", &[0.0, 500.0, 320.0, 240.0]).contains("focal"));
        let prism = [
            500.0, 500.0, 320.0, 240.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0,
        ];
        assert!(record("THIN_PRISM_FISHEYE", &prism).contains("tangential"));
    }
}
