//! One run at a time in a folder: options, log, checkpoint and scene of two would mix.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Why a folder cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum RunLockError {
    /// Another process works in it.
    #[error(
        "another run works in {0}; wait for its end, or give this one its own folder (--run DIR)"
    )]
    Busy(PathBuf),
    /// The operating system refused.
    #[error("run folder {folder}: {source}")]
    Io {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// A run folder, held until this is dropped or the process ends, however it ends.
#[derive(Debug)]
pub struct RunLock {
    _file: File,
}

impl RunLock {
    /// Makes the folder, if need be, and holds it.
    ///
    /// # Errors
    /// When another process holds it, or the disk refuses.
    pub fn hold(folder: &Path) -> Result<Self, RunLockError> {
        let error = |source| RunLockError::Io {
            folder: folder.to_owned(),
            source,
        };
        fs::create_dir_all(folder).map_err(error)?;
        let file = File::create(folder.join("run.lock")).map_err(error)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(RunLockError::Busy(folder.to_owned())),
            Err(TryLockError::Error(source)) => Err(error(source)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_held_by_one_run_until_it_ends() {
        let folder = std::env::temp_dir().join(format!("landline-lock-{}", std::process::id()));
        let first = RunLock::hold(&folder).expect("free");
        let second = RunLock::hold(&folder).expect_err("held");
        assert!(second.to_string().contains("another run"), "{second}");
        drop(first);
        RunLock::hold(&folder).expect("free again");
        fs::remove_dir_all(&folder).expect("exists");
    }
}
