//! From a finished run to a scene file.

use super::run::Trained;
use crate::eval::held_out;
use crate::labels::Labels;
use landline::models::Preset;
use landline::nn::{NnError, WeightTensor, Weights};
use landline::regress::RegressError;
use landline::scene_file::{
    Precision, SceneFile, SceneFileError, SceneInfo, Timestamp, TrainingSummary,
};
use std::ops::Range;

/// What is said about a scene that neither labels nor training know.
#[derive(Debug, Clone)]
pub struct Statement {
    /// Named configuration that the network started from.
    pub preset: Preset,
    /// Licence of the map.
    pub licence: String,
    /// When it is made.
    pub created: Timestamp,
}

/// Why a run gives no scene file.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A tensor is not finite.
    #[error(transparent)]
    Tensor(#[from] NnError),
    /// The scene cannot be written as a file.
    #[error(transparent)]
    File(#[from] SceneFileError),
    /// The networks do not run on the labels' features.
    #[error("measuring the held-out accuracy: {0}")]
    Measure(#[from] RegressError),
}

/// The scene of a run, without its held-out accuracy.
///
/// # Errors
/// [`ExportError`].
pub fn scene(
    trained: &Trained,
    labels: &Labels,
    statement: Statement,
) -> Result<SceneFile, ExportError> {
    let mut weights = Weights::new();
    for (spec, values) in &trained.tensors {
        weights.insert(
            spec.name.clone(),
            WeightTensor::f32(&spec.shape, values.clone())?,
        );
    }
    let origin = &labels.origin;
    let num_taught = labels.map.views.len() - trained.held.len();
    let info = SceneInfo {
        preset: Some(statement.preset),
        scale: trained.scale,
        units: origin.units,
        gravity: origin.gravity,
        working_max_side: origin.working_max_side,
        camera: labels.map.views.first().map(|v| v.camera),
        training: Some(TrainingSummary {
            num_images: num_taught as u64,
            num_steps: trained.steps.iter().map(|(_, s)| *s as u64).sum(),
            seconds: trained.seconds.round(),
            held_out: None,
            source: origin.source.clone(),
        }),
        licence: statement.licence,
        created: Some(statement.created),
        ..SceneInfo::new(origin.extractor, origin.extractor_sha256.clone())
    };
    Ok(SceneFile {
        info,
        config: trained.config.clone(),
        weights,
        landmarks: None,
    })
}

/// Notes the held-out accuracy of a scene, of its weights as they are stored, on the pictures that were kept back. It is that
/// of the networks alone: landmarks are of all pictures.
///
/// # Errors
/// [`ExportError`].
pub fn measure(
    scene: &mut SceneFile,
    labels: &Labels,
    held: &Range<usize>,
    precision: Precision,
) -> Result<(), ExportError> {
    let views = labels.map.views.get(held.clone());
    let Some(views) = views.filter(|v| !v.is_empty()) else {
        return Ok(());
    };
    let stored = SceneFile::from_bytes(&scene.to_bytes(precision)?)?;
    let accuracy = held_out(&stored, labels, views)?;
    scene.info.training.get_or_insert_default().held_out = Some(accuracy);
    Ok(())
}
