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

/// What COLMAP calls a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColmapModel {
    /// Its id in binary files.
    pub id: u32,
    /// Its name in texts.
    pub name: &'static str,
    /// Number of parameters.
    pub num_params: usize,
}

impl ColmapModel {
    /// A model of COLMAP.
    pub const fn new(id: u32, name: &'static str, num_params: usize) -> Self {
        Self {
            id,
            name,
            num_params,
        }
    }
}

impl CameraModel {
    /// Each model, with all parameters zero.
    #[rustfmt::skip]
    pub const ALL: [Self; 6] = [
        Self::SimplePinhole { f: 0.0, cx: 0.0, cy: 0.0 },
        Self::Pinhole { fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0 },
        Self::SimpleRadial { f: 0.0, cx: 0.0, cy: 0.0, k: 0.0 },
        Self::Radial { f: 0.0, cx: 0.0, cy: 0.0, k1: 0.0, k2: 0.0 },
        Self::OpenCv { fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0, k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0 },
        Self::OpenCvFisheye { fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0, k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0 },
    ];

    /// What COLMAP calls it.
    pub const fn colmap(&self) -> ColmapModel {
        match self {
            Self::SimplePinhole { .. } => ColmapModel::new(0, "SIMPLE_PINHOLE", 3),
            Self::Pinhole { .. } => ColmapModel::new(1, "PINHOLE", 4),
            Self::SimpleRadial { .. } => ColmapModel::new(2, "SIMPLE_RADIAL", 4),
            Self::Radial { .. } => ColmapModel::new(3, "RADIAL", 5),
            Self::OpenCv { .. } => ColmapModel::new(4, "OPENCV", 8),
            Self::OpenCvFisheye { .. } => ColmapModel::new(5, "OPENCV_FISHEYE", 8),
        }
    }

    /// COLMAP's name.
    pub fn name(&self) -> &'static str {
        self.colmap().name
    }

    /// From COLMAP's name and parameter list.
    ///
    /// # Errors
    /// When the name is unknown or the number of parameters does not fit it.
    pub fn from_colmap(name: &str, params: &[f64]) -> Result<Self, CameraError> {
        let Some(model) = Self::ALL.into_iter().find(|model| model.name() == name) else {
            return Err(CameraError::UnknownModel {
                name: name.to_owned(),
            });
        };
        let expected = model.colmap().num_params;
        if params.len() != expected {
            return Err(CameraError::NumParameters {
                name: name.to_owned(),
                expected,
                actual: params.len(),
            });
        }
        let mut all = [0.0; 8];
        all[..expected].copy_from_slice(params);
        Ok(model.with_params(all))
    }

    /// The same model with as many of these parameters as it takes.
    #[rustfmt::skip]
    pub(super) fn with_params(&self, [a, b, c, d, e, g, h, i]: [f64; 8]) -> Self {
        match self {
            Self::SimplePinhole { .. } => Self::SimplePinhole { f: a, cx: b, cy: c },
            Self::Pinhole { .. } => Self::Pinhole { fx: a, fy: b, cx: c, cy: d },
            Self::SimpleRadial { .. } => Self::SimpleRadial { f: a, cx: b, cy: c, k: d },
            Self::Radial { .. } => Self::Radial { f: a, cx: b, cy: c, k1: d, k2: e },
            Self::OpenCv { .. } => {
                Self::OpenCv { fx: a, fy: b, cx: c, cy: d, k1: e, k2: g, p1: h, p2: i }
            }
            Self::OpenCvFisheye { .. } => {
                Self::OpenCvFisheye { fx: a, fy: b, cx: c, cy: d, k1: e, k2: g, k3: h, k4: i }
            }
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
        (all, self.colmap().num_params)
    }

    /// How many focal lengths lead the parameters; the principal point follows them, then the distortion.
    pub(super) fn num_focals(&self) -> usize {
        match self {
            Self::SimplePinhole { .. } | Self::SimpleRadial { .. } | Self::Radial { .. } => 1,
            Self::Pinhole { .. } | Self::OpenCv { .. } | Self::OpenCvFisheye { .. } => 2,
        }
    }

    /// Whether it is more than a pinhole: has coefficients that are worth mentioning, or is a fisheye.
    pub fn has_distortion(&self) -> bool {
        let (params, count) = self.params();
        let mut coefficients = params[..count].iter().skip(self.num_focals() + 2);
        matches!(self, Self::OpenCvFisheye { .. }) || coefficients.any(|k| k.abs() > 1e-6)
    }

    /// The model with two focal lengths that projects in the same way.
    pub(super) fn with_two_focals(&self) -> Self {
        let opencv = |f, cx, cy, k1, k2| Self::OpenCv {
            fx: f,
            fy: f,
            cx,
            cy,
            k1,
            k2,
            p1: 0.0,
            p2: 0.0,
        };
        match *self {
            Self::SimplePinhole { f, cx, cy } => Self::Pinhole {
                fx: f,
                fy: f,
                cx,
                cy,
            },
            Self::SimpleRadial { f, cx, cy, k } => opencv(f, cx, cy, k, 0.0),
            Self::Radial { f, cx, cy, k1, k2 } => opencv(f, cx, cy, k1, k2),
            two => two,
        }
    }
}
