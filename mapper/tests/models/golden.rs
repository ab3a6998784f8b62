//! Reads reference numbers and compares with them.

use safetensors::{Dtype, SafeTensors};
use std::collections::HashMap;
use std::path::Path;

/// Tensors of a file as f32, with their shapes.
pub(crate) struct Golden(HashMap<String, (Vec<usize>, Vec<f32>)>);

impl Golden {
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).expect("the reference file is readable");
        let file = SafeTensors::deserialize(&bytes).expect("the reference file is whole");
        let tensors = file.iter().map(|(name, view)| {
            let data = view.data();
            let numbers = match view.dtype() {
                Dtype::F32 => data
                    .as_chunks()
                    .0
                    .iter()
                    .map(|c| f32::from_le_bytes(*c))
                    .collect(),
                Dtype::F16 => data
                    .as_chunks()
                    .0
                    .iter()
                    .map(|c| half::f16::from_le_bytes(*c).to_f32())
                    .collect(),
                Dtype::U8 => data.iter().map(|b| f32::from(*b)).collect(),
                other => panic!("{name} has elements of type {other}"),
            };
            (name.to_owned(), (view.shape().to_vec(), numbers))
        });
        Self(tensors.collect())
    }

    pub(crate) fn shape(&self, name: &str) -> &[usize] {
        &self.0[name].0
    }

    pub(crate) fn get(&self, name: &str) -> &[f32] {
        &self.0[name].1
    }

    /// `[1, channels, h, w]` or `[1, channels, n]` as rows of channels.
    pub(crate) fn rows(&self, name: &str) -> Vec<f32> {
        let (shape, data) = &self.0[name];
        let channels = shape[1];
        let n: usize = shape[2..].iter().product();
        (0..n)
            .flat_map(|i| (0..channels).map(move |c| data[c * n + i]))
            .collect()
    }
}

/// Largest difference over the largest reference value.
pub(crate) fn relative_error(got: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(got.len(), expected.len(), "sizes differ");
    let largest = expected.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    let worst = got
        .iter()
        .zip(expected)
        .fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(worst.is_finite(), "a value is not finite");
    worst / largest
}

pub(crate) fn cosine(a: &[f32], b: &[f32]) -> f32 {
    let dot: f32 = a.iter().zip(b).map(|(x, y)| x * y).sum();
    let norm = |v: &[f32]| v.iter().map(|x| x * x).sum::<f32>().sqrt();
    dot / (norm(a) * norm(b))
}
