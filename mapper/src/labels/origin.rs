//! Where labels are from: what a scene file has to say that neither the map nor training know.

use landline::models::ExtractorKind;
use landline::scene_file::ExtractorFile;

/// What made the features of labels, and of which pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Origin {
    /// The extractor.
    pub extractor: ExtractorKind,
    /// SHA-256 of the checkpoint that its weights came from.
    pub extractor_sha256: String,
    /// Longest side of the working image that the features were taken from, pixels.
    pub working_max_side: u32,
    /// Which pictures, in words.
    pub source: String,
}

/// XFeat's features of no checkpoint that there is, for labels that are put together by hand.
impl Default for Origin {
    fn default() -> Self {
        Self {
            extractor: ExtractorKind::Xfeat,
            extractor_sha256: String::new(),
            working_max_side: 640,
            source: String::new(),
        }
    }
}

impl Origin {
    /// Features of an extractor.
    pub fn of_extractor(extractor: &ExtractorFile, working_max_side: u32) -> Self {
        Self {
            extractor: extractor.kind,
            extractor_sha256: extractor.source_sha256.clone(),
            working_max_side,
            source: String::new(),
        }
    }

    /// Whether the features are of the extractor with this checkpoint.
    pub fn is_of(&self, extractor: ExtractorKind, sha256: &str) -> bool {
        self.extractor == extractor && self.extractor_sha256 == sha256
    }
}
