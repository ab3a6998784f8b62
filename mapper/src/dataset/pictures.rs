//! Where the pictures of a data set are.

use super::text::LFS_START;
use super::{Dataset, DatasetError};
use crate::picture;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Where pictures of a data set may lie.
pub(super) struct Pictures {
    folders: Vec<PathBuf>,
}

impl Pictures {
    pub(super) fn new(root: &Path, given: Option<&Path>) -> Result<Self, DatasetError> {
        let folders = match given {
            Some(folder) => {
                std::fs::metadata(folder).map_err(DatasetError::io(folder))?;
                vec![folder.to_owned()]
            }
            None => ["", "rgb", "images", "pictures", "../images", "../../images"]
                .iter()
                .map(|f| root.join(f))
                .filter(|f| f.is_dir())
                .collect(),
        };
        Ok(Self { folders })
    }

    /// As [`Self::find`], for names that may lack their extension; returns the name with it.
    pub(super) fn find_with_extension(
        &self,
        name: &str,
        dataset: &mut Dataset,
    ) -> Option<(String, PathBuf, (u32, u32))> {
        let full = ["", ".png", ".jpg", ".jpeg", ".JPG"]
            .iter()
            .map(|e| format!("{name}{e}"))
            .find(|n| self.folders.iter().any(|f| f.join(n).is_file()))
            .unwrap_or_else(|| name.to_owned());
        let (path, size) = self.find(&full, dataset)?;
        Some((full, path, size))
    }

    /// The file of a picture and its upright size. What cannot be found or read is noted as dropped.
    pub(super) fn find(&self, name: &str, dataset: &mut Dataset) -> Option<(PathBuf, (u32, u32))> {
        let Some(path) = self
            .folders
            .iter()
            .map(|f| f.join(name))
            .find(|p| p.is_file())
        else {
            dataset.drop_image(name, "picture is missing");
            return None;
        };
        match picture::size(&path) {
            Ok(size) => Some((path, size.upright)),
            Err(e) => {
                let reason = if is_lfs_pointer(&path) {
                    "picture is a Git LFS pointer; run `git lfs pull`".to_owned()
                } else {
                    format!("picture cannot be read: {}", e.short())
                };
                dataset.drop_image(name, reason);
                None
            }
        }
    }
}

/// Whether a pointer of Git LFS stands where a file was not fetched.
fn is_lfs_pointer(path: &Path) -> bool {
    let mut start = [0; LFS_START.len()];
    std::fs::File::open(path).is_ok_and(|mut file| file.read_exact(&mut start).is_ok())
        && start == *LFS_START
}

/// Files of a folder, sorted.
pub(super) fn list_files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(DatasetError::io(folder))? {
        let path = entry.map_err(DatasetError::io(folder))?.path();
        if path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}
