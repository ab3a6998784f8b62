//! Scene files: a regressor's weights with everything needed to use them.

use super::info::check_sha256;
use super::tensor_file::{RawTensor, replace_metadata, serialize_with};
use super::{
    Element, ExtractorFile, FORMAT_VERSION, LANDMARK_VERSION, SceneFileError, SceneInfo,
    TensorFile, check_kind, landmarks,
};
use crate::geometry::SceneScale;
use crate::landmarks::LandmarkTable;
use crate::models::{RegressorConfig, Variant};
use crate::nn::Weights;
use std::collections::BTreeMap;

/// How weights are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// 32-bit.
    F32,
    /// 16-bit. The default.
    #[default]
    F16,
    /// Matrices as 8-bit rows with one factor each, the rest as 16-bit. In anchored networks only the keys are matrices of
    /// this kind: positions need their digits, and the small MLPs weigh nothing. Of extractors see
    /// [`ExtractorFile::to_bytes`](super::ExtractorFile::to_bytes).
    Int8,
}

/// A scene: network, weights, metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFile {
    /// Metadata.
    pub info: SceneInfo,
    /// The network.
    pub config: RegressorConfig,
    /// The tensors of [`RegressorConfig::tensors`].
    pub weights: Weights,
    /// What is looked for again once a pose is known; files of version 1 have none.
    pub landmarks: Option<LandmarkTable>,
}

impl SceneFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`SceneFileError`] for everything that is not exactly a scene file of this version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SceneFileError> {
        let file = TensorFile::parse(bytes)?;
        check_kind(&file, "scene")?;
        let info = SceneInfo::from_file(&file)?;
        let text = file.text("config")?;
        let config: RegressorConfig =
            serde_json::from_str(text).map_err(|e| SceneFileError::value("config", text, e))?;
        let variant = file.text("variant")?;
        if variant != config.variant().name() {
            return Err(SceneFileError::value(
                "variant",
                variant,
                format!(
                    "the configuration is of variant {}",
                    config.variant().name()
                ),
            ));
        }
        config.validate()?;
        check_descriptor_size(&info, &config)?;
        let weights = file.weights()?;
        config.check_weights(&weights)?;
        let landmarks = landmarks::from_file(&file, config.descriptor_channels())?;
        Ok(Self {
            info,
            config,
            weights,
            landmarks,
        })
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// [`SceneFileError`] when the weights are not those of the configuration, not finite, or too large for the precision.
    pub fn to_bytes(&self, precision: Precision) -> Result<Vec<u8>, SceneFileError> {
        self.config.check_weights(&self.weights)?;
        check_descriptor_size(&self.info, &self.config)?;
        check_sha256("extractor_sha256", &self.info.extractor_sha256)?;
        let (metadata, raw) = self.metadata()?;
        let anchored = self.config.variant() == Variant::Anchored;
        let world_heads = self.world_heads();
        let element_of = |name: &str, shape: &[usize]| match precision {
            Precision::F32 => Element::F32,
            _ if world_heads.iter().any(|head| head == name) => Element::F32,
            Precision::F16 => Element::F16,
            Precision::Int8 if anchored => {
                if name.ends_with(".anchor.keys") {
                    Element::EIGHT_BIT
                } else {
                    Element::F16
                }
            }
            Precision::Int8 => match shape {
                [_, columns] if *columns >= 16 => Element::EIGHT_BIT,
                _ => Element::F16,
            },
        };
        serialize_with(&metadata, &self.weights, raw, element_of)
    }

    /// The bytes of a scene file with other metadata. Its tensors stay as they are to the last bit, and keys that this version
    /// does not know stay too. Of what `change` does to the scene, metadata and the landmarks' grid go into the file.
    ///
    /// # Errors
    /// [`SceneFileError`] when the bytes are no scene file of this version, or would not be with these metadata.
    pub fn redescribed(
        bytes: &[u8],
        change: impl FnOnce(&mut Self),
    ) -> Result<Vec<u8>, SceneFileError> {
        let mut scene = Self::from_bytes(bytes)?;
        let (before, _) = scene.metadata()?;
        change(&mut scene);
        let (after, _) = scene.metadata()?;
        let bytes = replace_metadata(bytes, |metadata| {
            metadata.retain(|key, _| after.contains_key(key) || !before.contains_key(key));
            metadata.extend(after);
        })?;
        // What the new metadata say has to be readable.
        Self::from_bytes(&bytes)?;
        Ok(bytes)
    }

    /// The header's entries, and the landmarks' tensors.
    fn metadata(&self) -> Result<(BTreeMap<String, String>, Vec<RawTensor>), SceneFileError> {
        let version = self
            .landmarks
            .as_ref()
            .map_or(FORMAT_VERSION, |_| LANDMARK_VERSION);
        let mut metadata = self.info.to_metadata(&self.config, version)?;
        let mut raw = Vec::new();
        if let Some(table) = &self.landmarks {
            table.check(self.config.descriptor_channels())?;
            raw = landmarks::to_raw(table, &mut metadata);
        }
        Ok((metadata, raw))
    }

    /// Last head layers of a network that predicts raw world coordinates: stored in f32, because an f16 bias far from the
    /// origin would shift the whole map.
    fn world_heads(&self) -> Vec<String> {
        let normalised = self.info.scale != SceneScale::default();
        if normalised || self.config.variant() == Variant::Anchored {
            return Vec::new();
        }
        let mut out = Vec::new();
        for head in ["point.head", "line.head"] {
            let last = self
                .weights
                .iter()
                .filter_map(|(name, _)| name.strip_prefix(head)?.strip_suffix(".b"))
                .max();
            out.extend(
                last.iter()
                    .flat_map(|layer| [format!("{head}{layer}.w"), format!("{head}{layer}.b")]),
            );
        }
        out
    }

    /// Checks that the scene was taught with this extractor.
    ///
    /// # Errors
    /// [`SceneFileError::WrongExtractor`].
    pub fn check_extractor(&self, extractor: &ExtractorFile) -> Result<(), SceneFileError> {
        let same = self.info.extractor == extractor.kind
            && self.info.extractor_sha256 == extractor.source_sha256;
        if same {
            return Ok(());
        }
        Err(SceneFileError::WrongExtractor {
            needed: self.info.extractor.name().to_owned(),
            needed_sha256: self.info.extractor_sha256.clone(),
            found: extractor.kind.name().to_owned(),
            found_sha256: extractor.source_sha256.clone(),
        })
    }
}

fn check_descriptor_size(info: &SceneInfo, config: &RegressorConfig) -> Result<(), SceneFileError> {
    let (network, extractor) = (
        config.descriptor_channels(),
        info.extractor.descriptor_channels(),
    );
    if network == extractor {
        return Ok(());
    }
    Err(SceneFileError::value(
        "config",
        &format!("descriptor_channels {network}"),
        format!(
            "extractor {} makes descriptors of {extractor}",
            info.extractor.name()
        ),
    ))
}

#[cfg(test)]
mod tests;
