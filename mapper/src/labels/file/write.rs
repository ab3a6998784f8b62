//! Labels to a label file.

use super::super::Labels;
use super::LabelFileError;
use crate::files;
use landline::mapping::LabelSource;
use safetensors::SafeTensorError;
use safetensors::tensor::serialize_to_file;
use std::io;
use std::path::Path;

impl Labels {
    /// Writes the labels; the file appears whole or not at all.
    ///
    /// # Errors
    /// When the disk refuses, or a view has no pose.
    pub fn write(&self, path: &Path) -> Result<(), LabelFileError> {
        let variants = self.variants.iter().map(|v| (v.of_view, &v.features));
        let source = LabelSource {
            origin: &self.origin,
            map: &self.map,
            variants: variants.collect(),
        };
        let metadata = source.metadata().map_err(|what| LabelFileError::Content {
            path: path.to_owned(),
            what: what.to_string(),
        })?;
        let tensors = source.tensors();
        files::write_at_once(path, |temporary| {
            let named = tensors.iter().map(|(name, tensor)| (*name, tensor));
            serialize_to_file(named, Some(metadata), temporary).map_err(|e| match e {
                SafeTensorError::IoError(e) => e,
                other => io::Error::other(other),
            })
        })
        .map_err(|source| LabelFileError::Io {
            path: path.to_owned(),
            source,
        })
    }
}
