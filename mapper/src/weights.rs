//! Extractor weights from disk: a converted file, or the original checkpoint, which is converted on the way.

use crate::import::{ImportError, ImportOptions, Imported, import};
use landline::scene_file::{ExtractorFile, SceneFileError};
use std::path::{Path, PathBuf};

/// Why weights could not be loaded.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The operating system refused.
    #[error("cannot read extractor weights {path}")]
    Io {
        /// The file.
        path: PathBuf,
        /// From the operating system.
        source: std::io::Error,
    },
    /// A Landline file that is damaged or of another kind.
    #[error("cannot use {path} as extractor weights")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: SceneFileError,
    },
    /// A checkpoint that cannot be converted.
    #[error("cannot use {path} as extractor weights")]
    Import {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: ImportError,
    },
    /// A checkpoint of something else.
    #[error("{path} holds a regressor ({variant}), not an extractor")]
    Regressor {
        /// The file.
        path: PathBuf,
        /// What it holds.
        variant: &'static str,
    },
}

/// Loads an extractor.
///
/// # Errors
/// [`WeightsError`].
pub fn load_extractor(path: &Path) -> Result<ExtractorFile, WeightsError> {
    let path_buf = || path.to_owned();
    let bytes = std::fs::read(path).map_err(|source| WeightsError::Io {
        path: path_buf(),
        source,
    })?;
    let source = match ExtractorFile::from_bytes(&bytes) {
        Ok(file) => return Ok(file),
        Err(source) => source,
    };
    // A file that says it is ours is not tried as something else: its own error is the one that helps.
    if matches!(
        source,
        SceneFileError::NotLandline { .. }
            | SceneFileError::HeaderTooLong { .. }
            | SceneFileError::Header { .. }
            | SceneFileError::Truncated { .. }
    ) && (bytes.starts_with(b"PK")
        || bytes.starts_with(&[0x80])
        || matches!(source, SceneFileError::NotLandline { .. }))
    {
        return match import(&bytes, &ImportOptions::default()) {
            Ok(Imported::Extractor(file)) => Ok(file),
            Ok(Imported::Regressor { config, .. }) => Err(WeightsError::Regressor {
                path: path_buf(),
                variant: config.variant().name(),
            }),
            Err(source) => Err(WeightsError::Import {
                path: path_buf(),
                source,
            }),
        };
    }
    Err(WeightsError::File {
        path: path_buf(),
        source,
    })
}
