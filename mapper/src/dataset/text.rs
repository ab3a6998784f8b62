//! Text files of a data set, from the disk.

use super::DatasetError;
use landline::formats::TextFile;
use std::path::Path;

/// Reads a text file.
pub(super) fn read_text(path: &Path) -> Result<TextFile, DatasetError> {
    let bytes = std::fs::read(path).map_err(DatasetError::io(path))?;
    Ok(TextFile::from_bytes(path.display().to_string(), bytes)?)
}
