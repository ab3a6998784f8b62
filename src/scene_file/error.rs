//! What can be wrong with a file.

use crate::landmarks::LandmarkError;
use crate::models::ModelError;

/// Why a scene file or extractor file was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneFileError {
    /// The file is larger than any network.
    #[error("the file has {found} bytes; files above {limit} bytes are not read")]
    TooLarge {
        /// Bytes.
        found: u64,
        /// Most bytes.
        limit: u64,
    },
    /// The file ends too early.
    #[error("the file has {found} bytes but its header alone needs {needed}; it is truncated")]
    Truncated {
        /// Bytes.
        found: u64,
        /// Bytes needed.
        needed: u64,
    },
    /// The header claims to be longer than any header of ours.
    #[error(
        "the header would have {found} bytes, at most {limit} are read; this is no scene file, or it is damaged"
    )]
    HeaderTooLong {
        /// Bytes.
        found: u64,
        /// Most bytes.
        limit: u64,
    },
    /// The header is not valid safetensors, or does not account for every byte.
    #[error(
        "the header does not describe the file: {reason}; the file is truncated, padded or damaged"
    )]
    Header {
        /// From the parser.
        reason: String,
    },
    /// A safetensors file of somebody else.
    #[error(
        "this is a safetensors file without Landline's metadata; expected a Landline {expected} file (make one with `landline convert`)"
    )]
    NotLandline {
        /// Kind that was asked for.
        expected: &'static str,
    },
    /// A file of the other kind.
    #[error("this is a Landline {found} file, expected a Landline {expected} file")]
    Kind {
        /// Kind of the file.
        found: String,
        /// Kind that was asked for.
        expected: &'static str,
    },
    /// A version that this program does not know.
    #[error(
        "the file has format version {found}, this program reads versions up to {supported}; use a matching version of Landline"
    )]
    Version {
        /// Version of the file.
        found: String,
        /// Newest version that is read.
        supported: u32,
    },
    /// A metadata key is missing.
    #[error("the metadata lack the key `{key}`")]
    MissingKey {
        /// The key.
        key: &'static str,
    },
    /// A metadata value cannot be understood.
    #[error("metadata `{key}` is {found:?}: {reason}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value, shortened.
        found: String,
        /// What is wrong.
        reason: String,
    },
    /// A tensor has an element type that weights do not have.
    #[error("tensor `{tensor}` has elements of type {found}; expected F32, F16 or I8")]
    Element {
        /// The tensor.
        tensor: String,
        /// Its type.
        found: String,
    },
    /// A tensor holds a NaN or an infinity.
    #[error("tensor `{tensor}` holds a value that is not finite at position {index}")]
    NotFinite {
        /// The tensor.
        tensor: String,
        /// First such position.
        index: usize,
    },
    /// The row factors of an 8-bit tensor are missing or misshapen.
    #[error("8-bit tensor `{tensor}`: {reason}")]
    RowScale {
        /// The tensor.
        tensor: String,
        /// What is wrong.
        reason: String,
    },
    /// A tensor of the landmark table is missing, misshapen or unknown.
    #[error("tensor `{tensor}` {reason}")]
    LandmarkTensor {
        /// The tensor.
        tensor: String,
        /// What is wrong.
        reason: String,
    },
    /// The landmark table holds what it may not.
    #[error("landmark table: {0}")]
    Landmarks(#[from] LandmarkError),
    /// The configuration is out of range or the tensors are not its own.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The scene was taught with another extractor.
    #[error(
        "the scene was taught with extractor {needed} ({needed_sha256}), the loaded weights are {found} ({found_sha256}); load the matching weights"
    )]
    WrongExtractor {
        /// Extractor of the scene.
        needed: String,
        /// Its checkpoint's hash.
        needed_sha256: String,
        /// Extractor that is loaded.
        found: String,
        /// Its checkpoint's hash.
        found_sha256: String,
    },
}

impl SceneFileError {
    /// A metadata value that cannot be understood; long values are shortened for the message.
    pub(super) fn value(key: &'static str, found: &str, reason: impl ToString) -> Self {
        let mut shown: String = found.chars().take(80).collect();
        if shown.len() < found.len() {
            shown.push('…');
        }
        Self::Value {
            key,
            found: shown,
            reason: reason.to_string(),
        }
    }
}
