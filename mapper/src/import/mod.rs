//! Foreign checkpoints to our tensor names: XFeat, SuperPoint (both releases), PL2Map and the paper's network.
//!
//! In: the bytes of a checkpoint. Out: an [`ExtractorFile`] or the configuration and weights of a regressor. Which network a
//! checkpoint holds is recognised by its tensor names; all sizes are read from the tensors.

pub mod checkpoint;
pub mod pickle;
mod pl2map;
mod superpoint;
mod xfeat;
pub mod zip;

use checkpoint::{Checkpoint, CheckpointError, ForeignTensor};
use landline::models::{ExtractorKind, ModelError, RegressorConfig};
use landline::nn::{NnError, WeightTensor, Weights};
use landline::scene_file::ExtractorFile;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use thiserror::Error;

pub use pl2map::ImportOptions;

/// What a checkpoint turned out to be.
#[derive(Debug)]
pub enum Imported {
    /// A feature extractor.
    Extractor(ExtractorFile),
    /// A scene's regressor.
    Regressor {
        /// Its sizes, read from the tensors.
        config: RegressorConfig,
        /// Its weights under our names.
        weights: Weights,
    },
}

/// Why a checkpoint could not be converted.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The file could not be read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The tensors are of no network that is known.
    #[error(
        "the checkpoint is none of XFeat, SuperPoint, PL2Map or the paper's network; its first tensors are {found:?}"
    )]
    UnknownNetwork {
        /// First tensor names.
        found: Vec<String>,
    },
    /// A tensor that the network needs is missing.
    #[error("the checkpoint looks like {network} but has no tensor {name}")]
    Missing {
        /// The network.
        network: &'static str,
        /// The tensor.
        name: String,
    },
    /// A tensor has another shape than the network needs.
    #[error("{network}: tensor {name} has shape {found:?}, expected {expected:?}")]
    Shape {
        /// The network.
        network: &'static str,
        /// The tensor.
        name: String,
        /// Shape found.
        found: Vec<usize>,
        /// Shape needed; 0 where any size will do.
        expected: Vec<usize>,
    },
    /// A tensor holds a NaN or an infinity.
    #[error("{network}: tensor {name} holds a value that is not finite at position {index}")]
    NotFinite {
        /// The network.
        network: &'static str,
        /// The tensor.
        name: String,
        /// First such position.
        index: usize,
    },
    /// A batch norm's variance is negative.
    #[error("{network}: the running variance {name} is negative at position {index}")]
    Variance {
        /// The network.
        network: &'static str,
        /// The tensor.
        name: String,
        /// First such position.
        index: usize,
    },
    /// The number of heads does not divide the width.
    #[error("{heads} heads do not divide the network's width {width}; set the number of heads")]
    Heads {
        /// Heads asked for.
        heads: usize,
        /// Width read from the tensors.
        width: usize,
    },
    /// Tensors are left over that belong to no part of the network.
    #[error("{network}: tensor {name} belongs to no part of the network ({count} such tensors)")]
    LeftOver {
        /// The network.
        network: &'static str,
        /// First of them.
        name: String,
        /// How many there are.
        count: usize,
    },
    /// The sizes that were read make no valid network.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A tensor could not be made.
    #[error(transparent)]
    Nn(#[from] NnError),
}

/// Reads a checkpoint and converts it.
///
/// # Errors
/// [`ImportError`].
pub fn import(bytes: &[u8], options: &ImportOptions) -> Result<Imported, ImportError> {
    let checkpoint = Checkpoint::read(bytes)?;
    let has = |name: &str| checkpoint.tensors.contains_key(name);
    let extractor = |kind, weights, licence: &str| {
        Imported::Extractor(ExtractorFile {
            kind,
            source_sha256: sha256_hex(bytes),
            source: String::new(),
            licence: licence.to_owned(),
            weights,
        })
    };
    if has("block_fusion.2.weight") && has("keypoint_head.3.weight") {
        let weights = xfeat::convert(checkpoint)?;
        return Ok(extractor(ExtractorKind::Xfeat, weights, "Apache-2.0"));
    }
    if has("conv1a.weight") && has("convPa.weight") {
        let weights = superpoint::convert_v1(checkpoint)?;
        return Ok(extractor(ExtractorKind::SuperPointV1, weights, ""));
    }
    if has("backbone.0.0.conv.weight") && has("detector.0.conv.weight") {
        let weights = superpoint::convert_open(checkpoint)?;
        return Ok(extractor(ExtractorKind::SuperPointOpen, weights, ""));
    }
    if has("d2s.mapping_p.0.weight") {
        let (config, weights) = pl2map::convert_proposed(checkpoint, options)?;
        return Ok(Imported::Regressor { config, weights });
    }
    if has("gnn.layers.0.attn.merge.weight") && has("mapping_p.0.weight") {
        let (config, weights) = pl2map::convert_v1(checkpoint, options)?;
        return Ok(Imported::Regressor { config, weights });
    }
    Err(ImportError::UnknownNetwork {
        found: checkpoint.tensors.into_keys().take(5).collect(),
    })
}

/// SHA-256 in lower-case hexadecimal.
pub fn sha256_hex(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

/// Takes tensors out of a checkpoint by name and puts weights under ours.
struct Converter {
    network: &'static str,
    tensors: BTreeMap<String, ForeignTensor>,
    made: Weights,
}

impl Converter {
    fn new(network: &'static str, checkpoint: Checkpoint) -> Self {
        Self {
            network,
            tensors: checkpoint.tensors,
            made: Weights::new(),
        }
    }

    /// Takes a tensor and checks that it is finite.
    fn take(&mut self, name: &str) -> Result<ForeignTensor, ImportError> {
        let Some(tensor) = self.tensors.remove(name) else {
            return Err(ImportError::Missing {
                network: self.network,
                name: name.to_owned(),
            });
        };
        match tensor.data.iter().position(|x| !x.is_finite()) {
            None => Ok(tensor),
            Some(index) => Err(ImportError::NotFinite {
                network: self.network,
                name: name.to_owned(),
                index,
            }),
        }
    }

    /// Takes a tensor of a known shape; trailing axes of size one (1x1 convolutions) do not count.
    fn take_shaped(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, ImportError> {
        let tensor = self.take(name)?;
        let mut found = tensor.shape.as_slice();
        while found.len() > shape.len() && found.last() == Some(&1) {
            found = &found[..found.len() - 1];
        }
        if found != shape {
            return Err(ImportError::Shape {
                network: self.network,
                name: name.to_owned(),
                found: tensor.shape,
                expected: shape.to_vec(),
            });
        }
        Ok(tensor.data)
    }

    /// Sizes of a matrix, trailing axes of size one left out, without taking it.
    fn matrix_size(&self, name: &str) -> Result<[usize; 2], ImportError> {
        let Some(tensor) = self.tensors.get(name) else {
            return Err(ImportError::Missing {
                network: self.network,
                name: name.to_owned(),
            });
        };
        match tensor.shape.as_slice() {
            [out, input] | [out, input, 1] | [out, input, 1, 1] => Ok([*out, *input]),
            _ => Err(ImportError::Shape {
                network: self.network,
                name: name.to_owned(),
                found: tensor.shape.clone(),
                expected: vec![0, 0],
            }),
        }
    }

    fn put(&mut self, name: String, shape: &[usize], data: Vec<f32>) -> Result<(), ImportError> {
        self.made.insert(name, WeightTensor::f32(shape, data)?);
        Ok(())
    }

    /// `FOREIGN.weight` and `.bias` become `OURS.w` and `.b`.
    fn linear(
        &mut self,
        foreign: &str,
        ours: &str,
        out: usize,
        input: usize,
    ) -> Result<(), ImportError> {
        let w = self.take_shaped(&format!("{foreign}.weight"), &[out, input])?;
        let b = self.take_shaped(&format!("{foreign}.bias"), &[out])?;
        self.put(format!("{ours}.w"), &[out, input], w)?;
        self.put(format!("{ours}.b"), &[out], b)
    }

    /// Gain and shift that a batch norm amounts to.
    fn batch_norm(
        &mut self,
        name: &str,
        channels: usize,
        eps: f64,
        affine: bool,
    ) -> Result<(Vec<f64>, Vec<f64>), ImportError> {
        let mean = self.take_shaped(&format!("{name}.running_mean"), &[channels])?;
        let var_name = format!("{name}.running_var");
        let var = self.take_shaped(&var_name, &[channels])?;
        if let Some(index) = var.iter().position(|v| *v < 0.0) {
            return Err(ImportError::Variance {
                network: self.network,
                name: var_name,
                index,
            });
        }
        let (gamma, beta) = if affine {
            (
                self.take_shaped(&format!("{name}.weight"), &[channels])?,
                self.take_shaped(&format!("{name}.bias"), &[channels])?,
            )
        } else {
            (vec![1.0; channels], vec![0.0; channels])
        };
        let gain: Vec<f64> = gamma
            .iter()
            .zip(&var)
            .map(|(g, v)| f64::from(*g) / (f64::from(*v) + eps).sqrt())
            .collect();
        let shift = beta
            .iter()
            .zip(&mean)
            .zip(&gain)
            .map(|((b, m), g)| f64::from(*b) - f64::from(*m) * g)
            .collect();
        Ok((gain, shift))
    }

    /// The weights, once nothing is left over but tensors whose names begin so.
    fn finish(self, ignored: &[&str]) -> Result<Weights, ImportError> {
        let left: Vec<&String> = self
            .tensors
            .keys()
            .filter(|name| !ignored.iter().any(|prefix| name.starts_with(prefix)))
            .filter(|name| !name.ends_with("num_batches_tracked"))
            .collect();
        match left.first() {
            None => Ok(self.made),
            Some(name) => Err(ImportError::LeftOver {
                network: self.network,
                name: (*name).clone(),
                count: left.len(),
            }),
        }
    }
}

/// `gain * w` by rows and `gain * b + shift`: a batch norm folded into the layer before it.
fn fold_norm(w: &[f32], b: Option<&[f32]>, gain: &[f64], shift: &[f64]) -> (Vec<f32>, Vec<f32>) {
    let columns = w.len() / gain.len();
    let folded = w
        .chunks_exact(columns)
        .zip(gain)
        .flat_map(|(row, g)| row.iter().map(move |x| (f64::from(*x) * g) as f32))
        .collect();
    let bias = gain
        .iter()
        .zip(shift)
        .enumerate()
        .map(|(i, (g, s))| (b.map_or(0.0, |b| f64::from(b[i])) * g + s) as f32)
        .collect();
    (folded, bias)
}
