//! Interrupt and resume: everything that the next step depends on, in one safetensors file.

use super::session::Session;
use crate::files;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView, serialize};
use std::collections::HashMap;
use std::io;
use std::path::Path;

/// Writes the state of all branches; the file appears whole or not at all.
///
/// # Errors
/// Of the operating system.
pub fn write(path: &Path, sessions: &[Session], seconds: f64) -> io::Result<()> {
    let mut metadata = HashMap::from([("seconds".to_owned(), seconds.to_string())]);
    let mut data: Vec<(String, Vec<u8>)> = Vec::new();
    for (i, session) in sessions.iter().enumerate() {
        let (tensors, time) = session.parameters().state();
        metadata.insert(format!("{i}/step"), session.step.to_string());
        metadata.insert(format!("{i}/steps"), session.recipe.steps.to_string());
        metadata.insert(format!("{i}/time"), time.to_string());
        for (name, values) in tensors {
            let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            data.push((format!("{i}/{name}"), bytes));
        }
    }
    let views = data
        .iter()
        .map(|(name, bytes)| {
            TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes).map(|v| (name.as_str(), v))
        })
        .collect::<Result<Vec<_>, _>>()
        .map_err(io::Error::other)?;
    let bytes = serialize(views, Some(metadata)).map_err(io::Error::other)?;
    files::write_bytes(path, &bytes)
}

/// Takes over a state; returns the seconds that the run had taken.
///
/// # Errors
/// A sentence that says what is wrong with the file.
pub fn read(path: &Path, sessions: &mut [Session]) -> Result<f64, String> {
    let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| e.to_string())?;
    let metadata = header.metadata().clone().unwrap_or_default();
    let file = SafeTensors::deserialize(&bytes).map_err(|e| e.to_string())?;
    let entry = |key: &str| {
        metadata
            .get(key)
            .ok_or_else(|| format!("it has no entry `{key}`"))
    };
    let whole = |key: &str| -> Result<usize, String> {
        entry(key)?
            .parse()
            .map_err(|e| format!("entry `{key}` is no number: {e}"))
    };
    for (i, session) in sessions.iter_mut().enumerate() {
        session.step = whole(&format!("{i}/step"))?;
        session.recipe.steps = whole(&format!("{i}/steps"))?;
        let time = whole(&format!("{i}/time"))?;
        let take = |name: &str| {
            let tensor = file.tensor(&format!("{i}/{name}")).ok()?;
            let (chunks, _) = tensor.data().as_chunks::<4>();
            Some(chunks.iter().map(|c| f32::from_le_bytes(*c)).collect())
        };
        session
            .parameters_mut()
            .restore(take, time)
            .map_err(|name| format!("tensor `{name}` is missing or of another size"))?;
    }
    entry("seconds")?
        .parse()
        .map_err(|e| format!("entry `seconds` is no number: {e}"))
}
