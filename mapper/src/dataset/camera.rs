//! Cameras as files write them: COLMAP's model names, ids and parameter order.

use landline::geometry::{Camera, CameraError, CameraModel};
use serde::{Deserialize, Serialize};

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
    /// Unknown or unsupported model, wrong number of parameters, values no camera has.
    pub fn to_camera(&self) -> Result<Camera, CameraError> {
        let camera = Camera {
            width: self.width,
            height: self.height,
            model: CameraModel::from_colmap(&self.model, &self.params)?,
        };
        camera.validate()?;
        Ok(camera)
    }
}
