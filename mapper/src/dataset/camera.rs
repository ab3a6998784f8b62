//! Cameras as files write them: COLMAP's model names, ids and parameter order.

use landline::geometry::{Camera, CameraModel};
use serde::{Deserialize, Serialize};

/// Why a camera of a file cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CameraError {
    /// The name is none of COLMAP's.
    #[error("unknown camera model `{0}`")]
    UnknownModel(String),
    /// COLMAP knows it, this tool does not.
    #[error(
        "camera model {0} is not supported; undistort the pictures first (COLMAP: image_undistorter)"
    )]
    UnsupportedModel(String),
    /// Parameters missing or too many.
    #[error("camera model {model} takes {expected} parameters, found {found}")]
    ParameterCount {
        /// COLMAP's name.
        model: String,
        /// By the model.
        expected: usize,
        /// In the file.
        found: usize,
    },
    /// A value that no camera has.
    #[error("camera {what}")]
    Implausible {
        /// Which value and why.
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
        let (model, params) = match camera.model {
            CameraModel::SimplePinhole { f, cx, cy } => ("SIMPLE_PINHOLE", vec![f, cx, cy]),
            CameraModel::Pinhole { fx, fy, cx, cy } => ("PINHOLE", vec![fx, fy, cx, cy]),
        };
        Self {
            model: model.to_owned(),
            width: camera.width,
            height: camera.height,
            params,
        }
    }

    /// The camera that the words describe.
    ///
    /// # Errors
    /// Unknown or unsupported model, wrong number of parameters, values no camera has.
    pub fn to_camera(&self) -> Result<Camera, CameraError> {
        let count = |expected: usize| CameraError::ParameterCount {
            model: self.model.clone(),
            expected,
            found: self.params.len(),
        };
        let model = match (self.model.as_str(), self.params.as_slice()) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => CameraModel::SimplePinhole { f, cx, cy },
            ("PINHOLE", &[fx, fy, cx, cy]) => CameraModel::Pinhole { fx, fy, cx, cy },
            ("SIMPLE_PINHOLE", _) => return Err(count(3)),
            ("PINHOLE", _) => return Err(count(4)),
            _ => return Err(CameraError::UnknownModel(self.model.clone())),
        };
        Ok(Camera {
            width: self.width,
            height: self.height,
            model,
        })
    }
}
