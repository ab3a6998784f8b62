//! Projection models and their parameters.

use super::CameraError;

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

/// Names and numbers of parameters, at the position of COLMAP's id.
pub const COLMAP_MODELS: [(&str, usize); 6] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
];

impl CameraModel {
    /// COLMAP's id.
    pub fn id(&self) -> usize {
        match self {
            Self::SimplePinhole { .. } => 0,
            Self::Pinhole { .. } => 1,
            Self::SimpleRadial { .. } => 2,
            Self::Radial { .. } => 3,
            Self::OpenCv { .. } => 4,
            Self::OpenCvFisheye { .. } => 5,
        }
    }

    /// COLMAP's name.
    pub fn name(&self) -> &'static str {
        COLMAP_MODELS[self.id()].0
    }

    /// From COLMAP's name and parameter list.
    ///
    /// # Errors
    /// When the name is unknown or the number of parameters does not fit it.
    pub fn from_colmap(name: &str, params: &[f64]) -> Result<Self, CameraError> {
        let Some(id) = COLMAP_MODELS.iter().position(|(n, _)| *n == name) else {
            return Err(CameraError::UnknownModel {
                name: name.to_owned(),
            });
        };
        let expected = COLMAP_MODELS[id].1;
        if params.len() != expected {
            return Err(CameraError::NumParameters {
                name: name.to_owned(),
                expected,
                actual: params.len(),
            });
        }
        let mut all = [0.0; 8];
        all[..expected].copy_from_slice(params);
        Ok(Self::from_id(id, all))
    }

    /// Model number `id` with as many of the parameters as it takes.
    pub(super) fn from_id(id: usize, [a, b, c, d, e, g, h, i]: [f64; 8]) -> Self {
        match id {
            0 => Self::SimplePinhole { f: a, cx: b, cy: c },
            1 => Self::Pinhole {
                fx: a,
                fy: b,
                cx: c,
                cy: d,
            },
            2 => Self::SimpleRadial {
                f: a,
                cx: b,
                cy: c,
                k: d,
            },
            3 => Self::Radial {
                f: a,
                cx: b,
                cy: c,
                k1: d,
                k2: e,
            },
            4 => Self::OpenCv {
                fx: a,
                fy: b,
                cx: c,
                cy: d,
                k1: e,
                k2: g,
                p1: h,
                p2: i,
            },
            _ => Self::OpenCvFisheye {
                fx: a,
                fy: b,
                cx: c,
                cy: d,
                k1: e,
                k2: g,
                k3: h,
                k4: i,
            },
        }
    }

    /// Parameters in COLMAP's order, and how many of the eight are used.
    pub fn params(&self) -> ([f64; 8], usize) {
        let all = match *self {
            Self::SimplePinhole { f, cx, cy } => [f, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0],
            Self::Pinhole { fx, fy, cx, cy } => [fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0],
            Self::SimpleRadial { f, cx, cy, k } => [f, cx, cy, k, 0.0, 0.0, 0.0, 0.0],
            Self::Radial { f, cx, cy, k1, k2 } => [f, cx, cy, k1, k2, 0.0, 0.0, 0.0],
            Self::OpenCv {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                p1,
                p2,
            } => [fx, fy, cx, cy, k1, k2, p1, p2],
            Self::OpenCvFisheye {
                fx,
                fy,
                cx,
                cy,
                k1,
                k2,
                k3,
                k4,
            } => [fx, fy, cx, cy, k1, k2, k3, k4],
        };
        (all, COLMAP_MODELS[self.id()].1)
    }

    /// How many focal lengths lead the parameters; the principal point follows them, then the distortion.
    pub(super) fn num_focals(&self) -> usize {
        match self {
            Self::SimplePinhole { .. } | Self::SimpleRadial { .. } | Self::Radial { .. } => 1,
            Self::Pinhole { .. } | Self::OpenCv { .. } | Self::OpenCvFisheye { .. } => 2,
        }
    }

    /// The model with two focal lengths that projects in the same way.
    pub(super) fn with_two_focals(&self) -> Self {
        match *self {
            Self::SimplePinhole { f, cx, cy } => Self::Pinhole {
                fx: f,
                fy: f,
                cx,
                cy,
            },
            Self::SimpleRadial { f, cx, cy, k } => {
                Self::from_id(4, [f, f, cx, cy, k, 0.0, 0.0, 0.0])
            }
            Self::Radial { f, cx, cy, k1, k2 } => {
                Self::from_id(4, [f, f, cx, cy, k1, k2, 0.0, 0.0])
            }
            two => two,
        }
    }
}
