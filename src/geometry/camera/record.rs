//! A camera in words.

use super::{Camera, CameraError, CameraModel};
use serde::{Deserialize, Serialize};

/// A camera in COLMAP's words, as files write it. The model may be one that [`CameraModel`] does not have.
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
    /// [`CameraError`] for a model that [`CameraModel`] does not have, a wrong number of parameters, or values that no camera
    /// has.
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
