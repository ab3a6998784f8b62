//! The scene's networks on the CPU.

use super::decode::{Predictions, decode};
use crate::features::FeatureSet;
use crate::geometry::SceneScale;
use crate::models::{ModelError, RegressorConfig, ports};
use crate::nn::cpu::{CpuExecutor, Level};
use crate::nn::{Executor, Graph, NnError, Weights};

/// Why a regressor could not be made or run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RegressError {
    /// The features were made by another extractor or with other samples than the network takes.
    #[error(
        "the features have descriptors of {found_channels} numbers and {found_tokens} samples on a segment; the network takes {channels} and {tokens}"
    )]
    Features {
        /// Numbers in a descriptor given.
        found_channels: usize,
        /// Samples on a segment given.
        found_tokens: usize,
        /// Numbers in a descriptor needed.
        channels: usize,
        /// Samples on a segment needed.
        tokens: usize,
    },
    /// The feature set's buffers do not have as many descriptors as it has keypoints or segments.
    #[error("the feature set has {found} descriptor numbers for its {kind}, needs {needed}")]
    Buffer {
        /// `keypoints` or `segments`.
        kind: &'static str,
        /// Numbers given.
        found: usize,
        /// Numbers needed.
        needed: usize,
    },
    /// A network does not have an output that its configuration promises.
    #[error("network {network} has no output `{name}`")]
    Output {
        /// Its place in [`network_parts`].
        network: usize,
        /// Name of the output.
        name: &'static str,
    },
    /// The weights do not fit or a size is out of range.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The runtime refused, for example more keypoints than there is room for.
    #[error(transparent)]
    Nn(#[from] NnError),
}

/// A scene's regressor, ready to run.
#[derive(Debug)]
pub struct Regressor {
    config: RegressorConfig,
    /// As [`network_parts`] orders them.
    networks: Vec<CpuExecutor>,
    scale: SceneScale,
    channels: usize,
    tokens: Option<usize>,
}

/// Graph and prepared weights of each network of a configuration, for at most these many keypoints and segments: the point
/// branch and the line branch if there is one, or the joint network of `v1`.
///
/// # Errors
/// [`RegressError::Model`] when the weights do not fit the configuration or a capacity is out of range.
pub fn network_parts(
    config: &RegressorConfig,
    mut weights: Weights,
    max_keypoints: usize,
    max_segments: usize,
) -> Result<Vec<(Graph, Weights)>, RegressError> {
    config.check_weights(&weights)?;
    let mut parts = Vec::new();
    match config {
        RegressorConfig::Branches { point, line } => {
            let made = point.prepare(&mut weights)?;
            parts.push((point.graph(max_keypoints)?, made));
            if let Some(line) = line {
                let made = line.prepare(&mut weights)?;
                parts.push((line.graph(max_segments)?, made));
            }
        }
        RegressorConfig::V1(v1) => {
            let made = v1.prepare(&mut weights)?;
            parts.push((v1.graph(max_keypoints, max_segments)?, made));
        }
    }
    Ok(parts)
}

impl Regressor {
    /// Prepares the networks of a configuration with its file's weights, for at most these many keypoints and segments.
    ///
    /// # Errors
    /// [`RegressError::Model`] when the weights do not fit the configuration or a capacity is out of range.
    pub fn new(
        config: &RegressorConfig,
        weights: Weights,
        scale: SceneScale,
        max_keypoints: usize,
        max_segments: usize,
    ) -> Result<Self, RegressError> {
        let level = Level::best();
        Self::with_level(config, weights, scale, max_keypoints, max_segments, level)
    }

    /// [`Self::new`] with other kernels than the machine's best.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_level(
        config: &RegressorConfig,
        weights: Weights,
        scale: SceneScale,
        max_keypoints: usize,
        max_segments: usize,
        level: Level,
    ) -> Result<Self, RegressError> {
        let networks = network_parts(config, weights, max_keypoints, max_segments)?
            .into_iter()
            .map(|(graph, weights)| CpuExecutor::with_level(graph, weights, level))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            config: config.clone(),
            networks,
            scale,
            channels: config.descriptor_channels(),
            tokens: config.line_tokens(),
        })
    }

    /// Samples that a segment needs, or `None` when the network does not look at segments.
    pub fn line_tokens(&self) -> Option<usize> {
        self.tokens
    }

    /// Bytes held: weights, values between the operations, working room.
    pub fn num_bytes(&self) -> usize {
        let memory = self.networks.iter().map(CpuExecutor::memory);
        memory.map(|m| m.weights + m.arena + m.scratch).sum()
    }

    /// Predicts scene points and segments.
    ///
    /// # Errors
    /// [`RegressError::Features`] and [`RegressError::Buffer`] for features that the network does not take,
    /// [`RegressError::Nn`] for more of them than there is room for.
    pub fn run(
        &mut self,
        features: &FeatureSet,
        out: &mut Predictions,
    ) -> Result<(), RegressError> {
        self.check(features)?;
        out.clear();
        let (points, segments) = (features.keypoints.len(), features.segments.len());
        for (index, network) in self.networks.iter_mut().enumerate() {
            let has = |network: &CpuExecutor, name: &str| {
                network
                    .graph()
                    .inputs()
                    .iter()
                    .any(|port| port.name == name)
            };
            let takes_points = has(network, ports::DESCRIPTORS);
            let takes_segments = has(network, ports::TOKENS);
            if !(takes_points && points > 0 || takes_segments && segments > 0) {
                continue;
            }
            if takes_points {
                network.set_count(ports::POINTS, points)?;
                let input = network.input(ports::DESCRIPTORS)?;
                input.copy_from_slice(&features.descriptors_nd);
            }
            if takes_segments {
                network.set_count(ports::SEGMENTS, segments)?;
                let input = network.input(ports::TOKENS)?;
                input.copy_from_slice(&features.segment_descriptors_nsd);
            }
            network.run()?;
            let output = |name: &str| network.output(name).ok();
            decode(&self.config, index, &self.scale, output, out)?;
        }
        Ok(())
    }

    fn check(&self, features: &FeatureSet) -> Result<(), RegressError> {
        let (points, segments) = (features.keypoints.len(), features.segments.len());
        let wrong_channels =
            (points > 0 || segments > 0) && features.descriptor_channels != self.channels;
        let wrong_tokens =
            segments > 0 && self.tokens.is_some_and(|tokens| tokens != features.tokens);
        if wrong_channels || wrong_tokens {
            return Err(RegressError::Features {
                found_channels: features.descriptor_channels,
                found_tokens: features.tokens,
                channels: self.channels,
                tokens: self.tokens.unwrap_or(0),
            });
        }
        for (kind, found, needed) in [
            (
                "keypoints",
                features.descriptors_nd.len(),
                points * self.channels,
            ),
            (
                "segments",
                features.segment_descriptors_nsd.len(),
                segments * features.tokens * self.channels,
            ),
        ] {
            if found != needed {
                return Err(RegressError::Buffer {
                    kind,
                    found,
                    needed,
                });
            }
        }
        Ok(())
    }
}
