//! Extractor files: the frozen weights of a feature extractor under our names.

use super::info::check_sha256;
use super::{
    Element, FORMAT_VERSION, KIND_KEY, Precision, SceneFileError, TensorFile, check_kind, serialize,
};
use crate::models::ExtractorKind;
use crate::nn::Weights;
use std::collections::BTreeMap;

/// A feature extractor's weights with their origin.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtractorFile {
    /// Which extractor.
    pub kind: ExtractorKind,
    /// SHA-256 of the checkpoint that the weights came from, in hexadecimal. Scene files refer to it.
    pub source_sha256: String,
    /// Where the checkpoint came from, as text.
    pub source: String,
    /// Licence of the weights, as text.
    pub licence: String,
    /// The tensors of [`ExtractorKind::tensors`].
    pub weights: Weights,
}

impl ExtractorFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`SceneFileError`] for everything that is not exactly an extractor file of this version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SceneFileError> {
        let file = TensorFile::parse(bytes)?;
        check_kind(&file, "extractor")?;
        let name = file.text("extractor")?;
        let kind = ExtractorKind::from_name(name)
            .ok_or_else(|| SceneFileError::value("extractor", name, "not a known extractor"))?;
        let source_sha256 = file.text("source_sha256")?.to_owned();
        check_sha256("source_sha256", &source_sha256)?;
        let weights = file.weights()?;
        kind.check_weights(&weights)?;
        let text = |key: &str| file.metadata().get(key).cloned().unwrap_or_default();
        Ok(Self {
            kind,
            source_sha256,
            source: text("source"),
            licence: text("licence"),
            weights,
        })
    }

    /// The bytes of the file. In 8-bit precision XFeat keeps f16 where an error moves keypoints or runs through everything
    /// after it (keypoint head, second block, tensors that weigh nothing); its two largest convolutions, far from the
    /// input, take six bits, the rest eight. Other extractors are stored in f16: what they lose was not measured.
    ///
    /// # Errors
    /// [`SceneFileError`] when the weights are not those of the extractor or not finite.
    pub fn to_bytes(&self, precision: Precision) -> Result<Vec<u8>, SceneFileError> {
        self.kind.check_weights(&self.weights)?;
        check_sha256("source_sha256", &self.source_sha256)?;
        let metadata: BTreeMap<String, String> = [
            (KIND_KEY, "extractor".to_owned()),
            ("format", FORMAT_VERSION.to_string()),
            ("extractor", self.kind.name().to_owned()),
            ("source_sha256", self.source_sha256.clone()),
            ("source", self.source.clone()),
            ("licence", self.licence.clone()),
        ]
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect();
        serialize(&metadata, &self.weights, |name, shape| match precision {
            Precision::F32 => Element::F32,
            Precision::Int8 if self.kind == ExtractorKind::Xfeat => xfeat_element(name, shape),
            Precision::F16 | Precision::Int8 => Element::F16,
        })
    }
}

/// How few bits a tensor of XFeat can do with; descriptors keep a cosine of 0.999 to those of f32 in the mean, and 98 of 100
/// keypoints stay (`mapper/tests/models/extractors.rs` holds both).
fn xfeat_element(name: &str, shape: &[usize]) -> Element {
    let size: usize = shape.iter().product();
    if size < 2_000 || name.starts_with("keypoint.") || name.starts_with("block2.") {
        Element::F16
    } else if size > 70_000 {
        Element::I8 { largest: 31 }
    } else {
        Element::EIGHT_BIT
    }
}
