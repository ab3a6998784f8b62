//! Interrupt and resume: everything that the next step depends on, in one safetensors file.

use super::session::{Best, CoolDown, Session};
use crate::files;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView, serialize};
use std::collections::HashMap;
use std::fmt::Display;
use std::io;
use std::path::Path;
use std::str::FromStr;

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
        metadata.insert(format!("{i}/stale"), session.stale.to_string());
        if let Some(c) = session.cool_down {
            metadata.insert(format!("{i}/cool_down_from"), c.from_step.to_string());
            metadata.insert(format!("{i}/cool_down_rate"), c.from_rate.to_string());
        }
        if let Some(best) = &session.best {
            metadata.insert(format!("{i}/best_score"), best.score.to_string());
            metadata.insert(format!("{i}/best_step"), best.step.to_string());
            for (spec, values) in session.parameters().specs().zip(&best.values) {
                data.push((format!("{i}/best/{}", spec.name), bytes(values)));
            }
        }
        for (name, values) in tensors {
            data.push((format!("{i}/{name}"), bytes(&values)));
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

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
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
    fn number<T: FromStr<Err: Display>>(key: &str, text: &str) -> Result<T, String> {
        text.parse()
            .map_err(|e| format!("entry `{key}` is no number: {e}"))
    }
    let whole = |key: &str| number::<usize>(key, entry(key)?);
    let real = |key: &str| number::<f64>(key, entry(key)?);
    for (i, session) in sessions.iter_mut().enumerate() {
        session.step = whole(&format!("{i}/step"))?;
        session.recipe.steps = whole(&format!("{i}/steps"))?;
        session.stale = whole(&format!("{i}/stale"))?;
        let time = whole(&format!("{i}/time"))?;
        let take = |name: &str| {
            let tensor = file.tensor(&format!("{i}/{name}")).ok()?;
            let (chunks, _) = tensor.data().as_chunks::<4>();
            Some(chunks.iter().map(|c| f32::from_le_bytes(*c)).collect())
        };
        let missing = |name| format!("tensor `{name}` is missing or of another size");
        session
            .parameters_mut()
            .restore(take, time)
            .map_err(missing)?;
        session.cool_down = match metadata.contains_key(&format!("{i}/cool_down_from")) {
            true => Some(CoolDown {
                from_step: whole(&format!("{i}/cool_down_from"))?,
                from_rate: real(&format!("{i}/cool_down_rate"))?,
            }),
            false => None,
        };
        session.best = match metadata.contains_key(&format!("{i}/best_score")) {
            true => {
                let mut values = Vec::new();
                for spec in session.parameters().specs() {
                    let name = format!("best/{}", spec.name);
                    let len: usize = spec.shape.iter().product();
                    let found: Option<Vec<f32>> = take(&name).filter(|v: &Vec<f32>| v.len() == len);
                    values.push(found.ok_or_else(|| missing(name))?);
                }
                Some(Best {
                    score: real(&format!("{i}/best_score"))?,
                    step: whole(&format!("{i}/best_step"))?,
                    values,
                })
            }
            false => None,
        };
    }
    real("seconds")
}
