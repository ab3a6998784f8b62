//! What is of one scene: its networks, and its landmarks. The rest of a relocalizer serves any scene of its extractor.

use super::error::CreateError;
use super::options::RelocalizerOptions;
use super::second_look::Again;
use crate::features::FeatureSet;
use crate::regress::{Predictions, RegressError, Regressor};
use crate::scene_file::{ExtractorFile, SceneFile, SceneFileError, SceneInfo};

/// A scene in which frames can be solved: goes into a [`super::Relocalizer`] by `exchange`.
#[derive(Debug)]
pub struct LoadedScene {
    info: SceneInfo,
    /// None where there is no scene.
    regressor: Option<Regressor>,
    /// Present where the scene has landmarks.
    again: Option<Again>,
}

impl LoadedScene {
    /// Builds a scene's networks for a relocalizer with these options.
    ///
    /// # Errors
    /// [`CreateError`] when the networks cannot read what the options make of a frame.
    pub fn new(scene: SceneFile, options: &RelocalizerOptions) -> Result<Self, CreateError> {
        options.check(&scene)?;
        let again = scene
            .landmarks
            .as_ref()
            .map(|table| Again::new(table, scene.info.camera));
        let regressor = Regressor::with_level(
            &scene.config,
            scene.weights,
            scene.info.scale,
            options.front_end.keypoints.max_keypoints,
            options.front_end.max_segments,
            options.kernels,
        )
        .map_err(CreateError::Networks)?;
        Ok(Self {
            info: scene.info,
            regressor: Some(regressor),
            again,
        })
    }

    /// No scene: nothing is found in it.
    pub fn none(extractor: &ExtractorFile) -> Self {
        Self {
            info: SceneInfo::new(extractor.kind, extractor.source_sha256.clone()),
            regressor: None,
            again: None,
        }
    }

    /// What the scene file says about itself.
    pub fn info(&self) -> &SceneInfo {
        &self.info
    }

    /// Whether there are landmarks to look for again.
    pub fn has_landmarks(&self) -> bool {
        self.again.is_some()
    }

    /// Bytes held, nearly all of them.
    pub fn num_bytes(&self) -> usize {
        let networks = self.regressor.as_ref().map_or(0, Regressor::num_bytes);
        networks + self.again.as_ref().map_or(0, Again::num_bytes)
    }

    /// Refuses a scene of another extractor than another one's.
    pub(super) fn check_extractor_of(&self, other: &Self) -> Result<(), CreateError> {
        let (own, others) = (&self.info, &other.info);
        if own.extractor == others.extractor && own.extractor_sha256 == others.extractor_sha256 {
            return Ok(());
        }
        Err(CreateError::Scene(SceneFileError::WrongExtractor {
            needed: own.extractor.name().to_owned(),
            needed_sha256: own.extractor_sha256.clone(),
            found: others.extractor.name().to_owned(),
            found_sha256: others.extractor_sha256.clone(),
        }))
    }

    pub(super) fn again_mut(&mut self) -> Option<&mut Again> {
        self.again.as_mut()
    }

    /// Predicts what the scene has where features are; nothing without a scene.
    pub(super) fn predict(
        &mut self,
        features: &FeatureSet,
        out: &mut Predictions,
    ) -> Result<(), RegressError> {
        match &mut self.regressor {
            Some(regressor) => regressor.run(features, out),
            None => {
                out.clear();
                Ok(())
            }
        }
    }
}
