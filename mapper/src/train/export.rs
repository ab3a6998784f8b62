//! From a finished run to a scene file.

use super::run::Trained;
use crate::labels::Labels;
use landline::models::Preset;
use landline::nn::{NnError, WeightTensor, Weights};
use landline::scene_file::{ExtractorFile, HeldOut, SceneFile, SceneInfo, TrainingSummary};

/// What the scene file says besides what training knows.
#[derive(Debug, Clone, Default)]
pub struct Origin {
    /// Where pictures and poses came from.
    pub source: String,
    /// Licence of the map.
    pub licence: String,
    /// ISO 8601; empty leaves it out, so that equal runs give equal files.
    pub created: String,
    /// Longest side of the working image.
    pub working_max_side: u32,
    /// Accuracy of poses on pictures that were not trained on.
    pub held_out: Option<HeldOut>,
}

/// The scene of a run.
///
/// # Errors
/// [`NnError`] when a tensor is not finite.
pub fn scene(
    trained: &Trained,
    labels: &Labels,
    extractor: &ExtractorFile,
    preset: Preset,
    origin: Origin,
) -> Result<SceneFile, NnError> {
    let mut weights = Weights::new();
    for (spec, values) in &trained.tensors {
        weights.insert(
            spec.name.clone(),
            WeightTensor::f32(&spec.shape, values.clone())?,
        );
    }
    let first = labels.map.views.first();
    let info = SceneInfo {
        preset: Some(preset),
        scale: trained.scale,
        working_max_side: origin.working_max_side,
        camera: first.map(|i| i.camera),
        training: Some(TrainingSummary {
            num_images: labels.map.views.len() as u64,
            num_steps: trained.steps.iter().map(|(_, s)| *s as u64).sum(),
            seconds: trained.seconds.round(),
            held_out: origin.held_out,
            source: origin.source,
        }),
        licence: origin.licence,
        created: origin.created,
        ..SceneInfo::new(extractor.kind, extractor.source_sha256.clone())
    };
    Ok(SceneFile {
        info,
        config: trained.config.clone(),
        weights,
        landmarks: None,
    })
}
