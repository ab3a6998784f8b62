//! Cameras as files write them: COLMAP's model names, ids and parameter order.
//!
//! The core projects with six models. The others become one of them where that is exact; else the nearest of `OPENCV` and
//! `OPENCV_FISHEYE` is fitted to them, and a fit that is off by more than [`MAX_FIT_ERROR_PX`] is refused.

use crate::geometry::{Camera, CameraError, CameraModel, CameraRecord, ColmapModel};
use nalgebra::{DMatrix, DVector, Vector2};

/// Largest error of a fitted camera model inside the picture.
pub const MAX_FIT_ERROR_PX: f64 = 0.1;

/// COLMAP's models beyond those of the core. Ids by pycolmap 4.2.1, `CameraModelId`.
const OTHER_MODELS: [ColmapModel; 12] = [
    ColmapModel::new(6, "FULL_OPENCV", 12),
    ColmapModel::new(7, "FOV", 5),
    ColmapModel::new(8, "SIMPLE_RADIAL_FISHEYE", 4),
    ColmapModel::new(9, "RADIAL_FISHEYE", 5),
    ColmapModel::new(10, "THIN_PRISM_FISHEYE", 12),
    ColmapModel::new(11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ColmapModel::new(12, "SIMPLE_DIVISION", 4),
    ColmapModel::new(13, "DIVISION", 5),
    ColmapModel::new(14, "SIMPLE_FISHEYE", 3),
    ColmapModel::new(15, "FISHEYE", 4),
    ColmapModel::new(16, "EUCM", 6),
    ColmapModel::new(17, "EQUIRECTANGULAR", 2),
];

/// The model with COLMAP's id.
pub fn colmap_model(id: u32) -> Option<ColmapModel> {
    let core = CameraModel::ALL.iter().map(CameraModel::colmap);
    core.chain(OTHER_MODELS).find(|model| model.id == id)
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

/// The camera of a record whose model may be any of COLMAP's.
///
/// # Errors
/// Unknown model, wrong number of parameters, values no camera has, or a model that cannot be expressed.
pub fn expressed(record: &CameraRecord) -> Result<Camera, CameraRecordError> {
    let camera = Camera {
        width: record.width,
        height: record.height,
        model: Foreign(record).to_model()?,
    };
    camera.validate()?;
    Ok(camera)
}

/// A record on its way to a model of the core.
struct Foreign<'a>(&'a CameraRecord);

impl Foreign<'_> {
    fn to_model(&self) -> Result<CameraModel, CameraRecordError> {
        let no = |what: String| CameraRecordError::NotExpressible {
            model: self.0.model.clone(),
            what,
        };
        let known = |name: &str, params: &[f64]| CameraModel::from_colmap(name, params);
        let fisheye = |fx, fy, cx, cy, k: [f64; 4]| {
            known("OPENCV_FISHEYE", &[fx, fy, cx, cy, k[0], k[1], k[2], k[3]])
        };
        let p = self.0.params.as_slice();
        Ok(match (self.0.model.as_str(), p) {
            ("SIMPLE_FISHEYE", &[f, cx, cy]) => fisheye(f, f, cx, cy, [0.0; 4])?,
            ("FISHEYE", &[fx, fy, cx, cy]) => fisheye(fx, fy, cx, cy, [0.0; 4])?,
            ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => {
                fisheye(f, f, cx, cy, [k, 0.0, 0.0, 0.0])?
            }
            ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => fisheye(f, f, cx, cy, [k1, k2, 0.0, 0.0])?,
            ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, s1, s2]) => {
                if [p1, p2, s1, s2] == [0.0; 4] {
                    return Ok(fisheye(fx, fy, cx, cy, [k1, k2, k3, k4])?);
                }
                self.fitted([fx, fy, cx, cy], |angle, towards| {
                    let p = towards * angle;
                    let r2 = angle * angle;
                    let radial = r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
                    p * (1.0 + radial) + tangential(p, p1, p2) + Vector2::new(s1, s2) * r2
                })?
            }
            (
                "RAD_TAN_THIN_PRISM_FISHEYE",
                &[
                    fx,
                    fy,
                    cx,
                    cy,
                    k1,
                    k2,
                    k3,
                    k4,
                    k5,
                    k6,
                    p1,
                    p2,
                    s1,
                    s2,
                    s3,
                    s4,
                ],
            ) => {
                if [k5, k6, p1, p2, s1, s2, s3, s4] == [0.0; 8] {
                    return Ok(fisheye(fx, fy, cx, cy, [k1, k2, k3, k4])?);
                }
                self.fitted([fx, fy, cx, cy], |angle, towards| {
                    let r2 = angle * angle;
                    let radial =
                        r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * (k4 + r2 * (k5 + r2 * k6)))));
                    let p = towards * (angle * (1.0 + radial));
                    let q2 = p.norm_squared();
                    // Its first tangential number belongs to x.
                    p + tangential(p, p2, p1)
                        + Vector2::new(q2 * (s1 + q2 * s2), q2 * (s3 + q2 * s4))
                })?
            }
            ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
                if [k3, k4, k5, k6] == [0.0; 4] {
                    return Ok(known("OPENCV", &p[..8])?);
                }
                self.fitted([fx, fy, cx, cy], |angle, towards| {
                    let p = towards * angle.tan();
                    let r2 = p.norm_squared();
                    let scale = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
                        / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
                    p * scale + tangential(p, p1, p2)
                })?
            }
            ("FOV", &[fx, fy, cx, cy, omega]) => {
                self.fitted([fx, fy, cx, cy], |angle, towards| {
                    towards * ((angle.tan() * 2.0 * (0.5 * omega).tan()).atan() / omega)
                })?
            }
            ("SIMPLE_DIVISION", &[f, cx, cy, k]) => self
                .fitted([f, f, cx, cy], |angle, towards| {
                    towards * division(angle.tan(), k)
                })?,
            ("DIVISION", &[fx, fy, cx, cy, k]) => self
                .fitted([fx, fy, cx, cy], |angle, towards| {
                    towards * division(angle.tan(), k)
                })?,
            ("EUCM", &[fx, fy, cx, cy, alpha, beta]) => {
                self.fitted([fx, fy, cx, cy], |angle, towards| {
                    let (sin, cos) = angle.sin_cos();
                    let depth = alpha * (beta * sin * sin + cos * cos).sqrt() + (1.0 - alpha) * cos;
                    towards * (sin / depth)
                })?
            }
            ("EQUIRECTANGULAR", _) => {
                return Err(no("a panorama has no focal length".to_owned()));
            }
            (name, _) => match OTHER_MODELS.iter().find(|model| model.name == name) {
                // The right number of parameters was handled above.
                Some(model) => {
                    return Err(CameraError::NumParameters {
                        name: name.to_owned(),
                        expected: model.num_params,
                        actual: p.len(),
                    }
                    .into());
                }
                None => known(name, p)?,
            },
        })
    }

    /// Fits the core's models to another one, given as the place on the image plane of focal length 1 by angle from the
    /// axis and direction around it, over what the picture shows.
    fn fitted(
        &self,
        [fx, fy, cx, cy]: [f64; 4],
        place: impl Fn(f64, Vector2<f64>) -> Vector2<f64>,
    ) -> Result<CameraModel, CameraRecordError> {
        let no = |what: &str| CameraRecordError::NotExpressible {
            model: self.0.model.clone(),
            what: what.to_owned(),
        };
        let (w, h) = (f64::from(self.0.width), f64::from(self.0.height));
        let is_inside = |p: Vector2<f64>| {
            let (x, y) = (fx * p.x + cx, fy * p.y + cy);
            (-1.0..=w + 1.0).contains(&x) && (-1.0..=h + 1.0).contains(&y)
        };
        let mut samples: Vec<Sample> = Vec::new();
        for i in 0..NUM_DIRECTIONS {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / NUM_DIRECTIONS as f64).sin_cos();
            let towards = Vector2::new(cos, sin);
            let mut radius = 0.0;
            let mut has_left = false;
            for step in 1..=NUM_ANGLES {
                let angle = MAX_ANGLE_RAD * step as f64 / NUM_ANGLES as f64;
                let seen = place(angle, towards);
                // Beyond a fold the same pixel belongs to two directions.
                if !(seen.norm() > radius) {
                    break;
                }
                radius = seen.norm();
                if !is_inside(seen) {
                    has_left = true;
                    break;
                }
                samples.push(Sample {
                    angle,
                    towards,
                    seen,
                });
            }
            if !has_left {
                return Err(no(
                    "it folds over inside the picture, or shows more than 89 degrees from its axis",
                ));
            }
        }
        // Both polynomials start with slope 1; another slope goes into the focal length.
        const NEAR: f64 = 1e-4;
        let slope = place(NEAR, Vector2::x()).x / NEAR;
        if !(slope > 0.0) || samples.len() < 8 {
            return Err(no("it does not grow from the centre"));
        }
        for sample in &mut samples {
            sample.seen /= slope;
        }
        let (fx, fy) = (fx * slope, fy * slope);
        let fisheye = fit(&samples, |s| {
            let p = s.towards * s.angle;
            let r2 = s.angle * s.angle;
            (p, [p * r2, p * (r2 * r2), p * r2.powi(3), p * r2.powi(4)])
        })
        .map(|([k1, k2, k3, k4], error)| {
            (error, "OPENCV_FISHEYE", [fx, fy, cx, cy, k1, k2, k3, k4])
        });
        let is_narrow = samples.iter().all(|s| s.angle < 1.3);
        let perspective = fit(&samples, |s| {
            let p = s.towards * s.angle.tan();
            let r2 = p.norm_squared();
            let tangents = [tangential(p, 1.0, 0.0), tangential(p, 0.0, 1.0)];
            (p, [p * r2, p * (r2 * r2), tangents[0], tangents[1]])
        })
        .filter(|_| is_narrow)
        .map(|([k1, k2, p1, p2], error)| (error, "OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2]));
        let best = fisheye
            .into_iter()
            .chain(perspective)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((error, name, params)) = best else {
            return Err(no("no polynomial fits it"));
        };
        let error_px = error * fx.max(fy);
        if !(error_px <= MAX_FIT_ERROR_PX) {
            return Err(no(&format!("the best fit is off by {error_px:.2} px")));
        }
        Ok(CameraModel::from_colmap(name, &params)?)
    }
}

/// Rays along which another model is compared, and angles on each.
const NUM_DIRECTIONS: usize = 24;
const NUM_ANGLES: usize = 200;
/// No picture shows more than this from the axis.
const MAX_ANGLE_RAD: f64 = 1.55;

/// Where a model puts a direction.
struct Sample {
    angle: f64,
    towards: Vector2<f64>,
    seen: Vector2<f64>,
}

/// Least squares of a model that is linear in four coefficients: returns them and the largest error. `model` gives the
/// place without distortion, and what each coefficient adds.
fn fit(
    samples: &[Sample],
    model: impl Fn(&Sample) -> (Vector2<f64>, [Vector2<f64>; 4]),
) -> Option<([f64; 4], f64)> {
    let mut left = DMatrix::zeros(2 * samples.len(), 4);
    let mut right = DVector::zeros(2 * samples.len());
    for (i, sample) in samples.iter().enumerate() {
        let (start, terms) = model(sample);
        let rest = sample.seen - start;
        for axis in 0..2 {
            right[2 * i + axis] = rest[axis];
            for (j, term) in terms.iter().enumerate() {
                left[(2 * i + axis, j)] = term[axis];
            }
        }
    }
    let k = left.clone().svd(true, true).solve(&right, 1e-14).ok()?;
    let off = left * &k - right;
    let largest = off
        .as_slice()
        .chunks_exact(2)
        .map(|e| e[0].hypot(e[1]))
        .fold(0.0, f64::max);
    (largest.is_finite()).then_some(([k[0], k[1], k[2], k[3]], largest))
}

/// OpenCV's tangential distortion.
fn tangential(p: Vector2<f64>, p1: f64, p2: f64) -> Vector2<f64> {
    let r2 = p.norm_squared();
    Vector2::new(
        2.0 * p1 * p.x * p.y + p2 * (r2 + 2.0 * p.x * p.x),
        p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * p2 * p.x * p.y,
    )
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
        let camera = expressed(&CameraRecord {
            model: model.to_owned(),
            width: 640,
            height: 480,
            params: params.to_vec(),
        })
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
    fn no_id_stands_for_two_models() {
        let names: Vec<_> = (0..19).map(|id| colmap_model(id).map(|m| m.name)).collect();
        assert_eq!(
            names[4..7],
            [Some("OPENCV"), Some("OPENCV_FISHEYE"), Some("FULL_OPENCV")]
        );
        assert_eq!(names[16..], [Some("EUCM"), Some("EQUIRECTANGULAR"), None]);
    }

    #[test]
    fn refuses_what_it_cannot_express() {
        let record = |model: &str, params: &[f64]| {
            expressed(&CameraRecord {
                model: model.to_owned(),
                width: 640,
                height: 480,
                params: params.to_vec(),
            })
            .expect_err("not expressible")
            .to_string()
        };
        assert!(record("EQUIRECTANGULAR", &[640.0, 480.0]).contains("panorama"));
        assert!(record("FOV", &[500.0]).contains("takes 5 parameters, got 1"));
        assert!(record("PINHOLE", &[0.0, 500.0, 320.0, 240.0]).contains("focal"));
        let prism = [
            500.0, 500.0, 320.0, 240.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0,
        ];
        let refused = record("THIN_PRISM_FISHEYE", &prism);
        assert!(
            refused.contains("THIN_PRISM_FISHEYE") && refused.contains("undistort"),
            "{refused}"
        );
    }
}
