//! Scene files (`NAME.landline`) and extractor files: safetensors with metadata; read, validated, written as bytes.
//!
//! * **In and out**: bytes of a file and a [`SceneFile`] or an [`ExtractorFile`], both ways. No file system.
//! * **Spaces and units**: network coordinates are normalised; [`crate::geometry::SceneScale`] in the header undoes that, outside the network
//!   and in f64, because an f16 bias far from the origin would shift the whole map by centimetres.
//! * **Format**: [safetensors]; the metadata keys are documented in `docs/SCENE_FILE.md` and in [`SceneInfo`].
//! * **Invariants**: what is returned was checked: sizes bounded, every tensor of the configuration present with its shape,
//!   no other tensor, all numbers finite, versions and names known. Nothing is allocated before its size is known to fit the
//!   file. Equal scenes give equal bytes.
//! * **Cost**: one copy of the tensors.
//!
//! [safetensors]: https://huggingface.co/docs/safetensors

#![forbid(unsafe_code)]
#![deny(clippy::as_conversions)]

mod error;
mod extractor_file;
mod info;
mod landmarks;
mod scene;
mod tensor_file;
mod timestamp;

pub use crate::geometry::Units;
pub use error::SceneFileError;
pub use extractor_file::ExtractorFile;
pub use info::{HeldOut, MAX_OTHER_CAMERAS, MAX_WORKING_SIDE, SceneInfo, TrainingSummary};
pub use scene::{Precision, SceneFile};
pub use tensor_file::{Element, MAX_FILE_BYTES, MAX_HEADER_BYTES, TensorFile, serialize};
pub(crate) use tensor_file::{RawTensor, serialize_with};
pub use timestamp::{Timestamp, TimestampError};

/// Version of extractor files, and of scene files without landmarks.
pub const FORMAT_VERSION: u32 = 1;

/// Version of scene files with landmarks: programs that do not know them refuse these. A newer one is refused.
pub const LANDMARK_VERSION: u32 = 2;

/// Metadata key that says which kind of file this is.
pub(crate) const KIND_KEY: &str = "landline";

/// Checks kind and version.
fn check_kind(file: &TensorFile<'_>, expected: &'static str) -> Result<(), SceneFileError> {
    let found = file
        .metadata()
        .get(KIND_KEY)
        .ok_or(SceneFileError::NotLandline { expected })?;
    if found != expected {
        return Err(SceneFileError::Kind {
            found: found.clone(),
            expected,
        });
    }
    let version = file.text("format")?;
    let is_known = [FORMAT_VERSION, LANDMARK_VERSION].map(|v| v.to_string());
    if !is_known.iter().any(|known| known == version) {
        return Err(SceneFileError::Version {
            found: version.to_owned(),
            supported: LANDMARK_VERSION,
        });
    }
    Ok(())
}
