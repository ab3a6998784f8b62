//! One configuration type for inference, scene files and the trainer.

use super::error::{ModelError, check_size};
use super::{
    AnchoredLineConfig, AnchoredPointConfig, AttentionLineConfig, AttentionOutput,
    AttentionPointConfig, LinePool, V1Config,
};
use crate::nn::{Graph, Weights};
use serde::{Deserialize, Serialize};

pub use crate::nn::graph::WeightSpec as TensorSpec;

/// Family of a network, as it is named in a scene file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// Two branches with attention, the network of the paper.
    Proposed,
    /// The joint graph network PL2Map.
    V1,
    /// Two branches anchored on learned landmarks.
    Anchored,
}

impl Variant {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Proposed => "proposed",
            Self::V1 => "v1",
            Self::Anchored => "anchored",
        }
    }
}

/// A named configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The paper's sizes: 8.3 M parameters.
    Paper,
    /// The same network sized for a CPU, with a choice among landmarks as its output.
    Standard,
    /// Anchored on learned landmarks, under 1 MB as a file. The default.
    Compact,
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Standard, Self::Compact];

    /// The name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Standard => "standard",
            Self::Compact => "compact",
        }
    }
}

/// Branch that maps keypoint descriptors to scene points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum PointBranchConfig {
    /// Pruning, self-attention, head.
    Attention(AttentionPointConfig),
    /// Soft choice among landmarks.
    Anchored(AnchoredPointConfig),
}

/// Branch that maps the sampled descriptors of a segment to a scene segment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LineBranchConfig {
    /// Line encoder, self-attention, pruning, head.
    Attention(AttentionLineConfig),
    /// Soft choice among landmark segments.
    Anchored(AnchoredLineConfig),
}

/// What both kinds of branch do, whatever is inside.
macro_rules! branch {
    ($type:ident: at most $element:literal) => {
        impl $type {
            /// Descriptor size that goes in.
            pub fn descriptor_channels(&self) -> usize {
                match self {
                    Self::Attention(c) => c.descriptor_channels,
                    Self::Anchored(c) => c.descriptor_channels,
                }
            }

            /// Checks the ranges of all sizes.
            ///
            /// # Errors
            /// [`ModelError::Size`], [`ModelError::Number`], [`ModelError::Mismatch`].
            pub fn validate(&self) -> Result<(), ModelError> {
                match self {
                    Self::Attention(c) => c.validate(),
                    Self::Anchored(c) => c.validate(),
                }
            }

            /// Names and shapes of the trained tensors, as files and the trainer have them.
            pub fn tensors(&self) -> Vec<TensorSpec> {
                match self {
                    Self::Attention(c) => c.tensors(),
                    Self::Anchored(c) => c.tensors(),
                }
            }

            #[doc = concat!("The graph for at most `capacity` ", $element, ". Ports are in [`super::ports`].")]
            ///
            /// # Errors
            /// [`ModelError`] when the configuration or the capacity is out of range.
            pub fn graph(&self, capacity: usize) -> Result<Graph, ModelError> {
                self.validate()?;
                check_size("capacity", capacity, 1, MAX_ROWS)?;
                match self {
                    Self::Attention(c) => c.graph(capacity),
                    Self::Anchored(c) => c.graph(capacity),
                }
            }

            /// Turns the tensors of [`Self::tensors`] into the weights of [`Self::graph`]. Tensors of other branches are
            /// left alone.
            ///
            /// # Errors
            /// [`ModelError::Nn`] for a missing or misshapen tensor.
            pub fn prepare(&self, weights: &mut Weights) -> Result<Weights, ModelError> {
                self.validate()?;
                match self {
                    Self::Attention(c) => c.prepare(weights),
                    Self::Anchored(c) => c.prepare(weights),
                }
            }
        }
    };
}

branch!(PointBranchConfig: at most "keypoints");
branch!(LineBranchConfig: at most "segments");

impl LineBranchConfig {
    /// Samples along a segment, both ends included.
    pub fn tokens(&self) -> usize {
        match self {
            Self::Attention(c) => c.tokens,
            Self::Anchored(c) => c.tokens,
        }
    }
}

/// Most keypoints or segments that a graph is built for.
pub(super) const MAX_ROWS: usize = 16_384;

/// A whole regressor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "network", rename_all = "snake_case")]
pub enum RegressorConfig {
    /// Two branches that share nothing; the line branch may be missing.
    Branches {
        /// Keypoints to scene points.
        point: PointBranchConfig,
        /// Segments to scene segments.
        line: Option<LineBranchConfig>,
    },
    /// The joint network.
    V1(V1Config),
}

impl RegressorConfig {
    /// A named configuration for an extractor's descriptor size.
    pub fn preset(preset: Preset, descriptor_channels: usize) -> Self {
        let attention = |width, num_layers, ff, heads: [&[usize]; 2], outputs: [_; 2]| {
            let [point_head, line_head] = heads;
            let [point_output, line_output] = outputs;
            Self::Branches {
                point: PointBranchConfig::Attention(AttentionPointConfig {
                    descriptor_channels,
                    width,
                    heads: 4,
                    num_layers,
                    mlp_hidden: 2 * width,
                    prune_hidden: width,
                    head_hidden: point_head.to_vec(),
                    min_confidence: 0.8,
                    output: point_output,
                }),
                line: Some(LineBranchConfig::Attention(AttentionLineConfig {
                    descriptor_channels,
                    tokens: 12,
                    width,
                    heads: 4,
                    encoder_hidden: ff,
                    num_layers: 1,
                    mlp_hidden: 2 * width,
                    prune_hidden: width,
                    head_hidden: line_head.to_vec(),
                    min_confidence: 0.01,
                    output: line_output,
                })),
            }
        };
        let anchored = |num_anchors| AttentionOutput::Anchored {
            num_anchors,
            reliability_hidden: 64,
        };
        match preset {
            Preset::Paper => attention(
                256,
                5,
                1024,
                [&[512, 1024, 1024, 512], &[512, 1024, 512]],
                [AttentionOutput::Linear; 2],
            ),
            Preset::Standard => attention(
                128,
                3,
                256,
                [&[256], &[256]],
                [anchored(2048), anchored(1024)],
            ),
            Preset::Compact => Self::Branches {
                point: PointBranchConfig::Anchored(AnchoredPointConfig {
                    descriptor_channels,
                    num_anchors: 2048,
                    offset_hidden: 0,
                    reliability_hidden: 64,
                }),
                line: Some(LineBranchConfig::Anchored(AnchoredLineConfig {
                    descriptor_channels,
                    tokens: 12,
                    pool: LinePool::Mean,
                    key_channels: descriptor_channels,
                    num_anchors: 1024,
                    offset_hidden: 0,
                    reliability_hidden: 64,
                })),
            },
        }
    }

    /// The family.
    pub fn variant(&self) -> Variant {
        match self {
            Self::V1(_) => Variant::V1,
            Self::Branches {
                point: PointBranchConfig::Attention(_),
                ..
            } => Variant::Proposed,
            Self::Branches {
                point: PointBranchConfig::Anchored(_),
                ..
            } => Variant::Anchored,
        }
    }

    /// Descriptor size that goes in.
    pub fn descriptor_channels(&self) -> usize {
        match self {
            Self::V1(c) => c.descriptor_channels,
            Self::Branches { point, .. } => point.descriptor_channels(),
        }
    }

    /// Samples along a segment, or `None` without a line branch.
    pub fn line_tokens(&self) -> Option<usize> {
        match self {
            Self::V1(c) => Some(c.tokens),
            Self::Branches { line, .. } => line.as_ref().map(LineBranchConfig::tokens),
        }
    }

    /// Checks the ranges of all sizes.
    ///
    /// # Errors
    /// [`ModelError::Size`], [`ModelError::Number`], [`ModelError::Mismatch`].
    pub fn validate(&self) -> Result<(), ModelError> {
        match self {
            Self::V1(c) => c.validate(),
            Self::Branches { point, line } => {
                point.validate()?;
                if let Some(line) = line {
                    line.validate()?;
                    if line.descriptor_channels() != point.descriptor_channels() {
                        return Err(ModelError::Mismatch(format!(
                            "the point branch takes descriptors of {} numbers and the line branch of {}; both see one extractor",
                            point.descriptor_channels(),
                            line.descriptor_channels()
                        )));
                    }
                }
                Ok(())
            }
        }
    }

    /// Names and shapes of all tensors of a file.
    pub fn tensors(&self) -> Vec<TensorSpec> {
        match self {
            Self::V1(c) => c.tensors(),
            Self::Branches { point, line } => {
                let mut out = point.tensors();
                out.extend(line.iter().flat_map(LineBranchConfig::tensors));
                out
            }
        }
    }

    /// Numbers in all tensors.
    pub fn num_parameters(&self) -> usize {
        self.tensors()
            .iter()
            .map(|t| t.shape.iter().product::<usize>())
            .sum()
    }

    /// Checks that the weights are exactly the tensors of this configuration.
    ///
    /// # Errors
    /// [`ModelError::UnexpectedTensor`], [`ModelError::Nn`] for missing and misshapen ones.
    pub fn check_weights(&self, weights: &Weights) -> Result<(), ModelError> {
        self.validate()?;
        check_exactly(&self.tensors(), weights)
    }
}

/// Checks that the weights are exactly these tensors.
pub(super) fn check_exactly(specs: &[TensorSpec], weights: &Weights) -> Result<(), ModelError> {
    for spec in specs {
        match weights.get(&spec.name) {
            None => {
                return Err(crate::nn::NnError::MissingWeight {
                    name: spec.name.clone(),
                    expected: spec.shape.clone(),
                }
                .into());
            }
            Some(tensor) if tensor.shape() != spec.shape => {
                return Err(crate::nn::NnError::WeightShape {
                    name: spec.name.clone(),
                    found: tensor.shape().to_vec(),
                    expected: spec.shape.clone(),
                }
                .into());
            }
            Some(_) => {}
        }
    }
    if weights.len() != specs.len() {
        let stray = weights
            .iter()
            .find(|(name, _)| specs.iter().all(|s| s.name != *name));
        if let Some((name, _)) = stray {
            return Err(ModelError::UnexpectedTensor {
                name: name.to_owned(),
            });
        }
    }
    Ok(())
}

/// Collects [`TensorSpec`]s.
#[derive(Debug, Default)]
pub(super) struct Specs(pub(super) Vec<TensorSpec>);

impl Specs {
    pub(super) fn add(&mut self, name: impl Into<String>, shape: &[usize]) {
        self.0.push(TensorSpec {
            name: name.into(),
            shape: shape.to_vec(),
        });
    }

    /// `NAME.w` `[out, in]` and `NAME.b` `[out]`.
    pub(super) fn linear(&mut self, name: &str, out: usize, input: usize) {
        self.add(format!("{name}.w"), &[out, input]);
        self.add(format!("{name}.b"), &[out]);
    }

    /// `NAME.{0..}`: linear layers of these widths, the first number being the input.
    pub(super) fn mlp(&mut self, name: &str, widths: &[usize]) {
        for (i, pair) in widths.windows(2).enumerate() {
            self.linear(&format!("{name}.{i}"), pair[1], pair[0]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameter_counts_of_the_paper() {
        let paper = RegressorConfig::preset(Preset::Paper, 256);
        assert_eq!(paper.num_parameters(), 8_282_379);
        assert_eq!(paper.tensors().len(), 114);
        let with_input_layers = RegressorConfig::preset(Preset::Paper, 64);
        assert_eq!(with_input_layers.num_parameters(), 8_315_659);
        let v1 = RegressorConfig::V1(V1Config::paper());
        assert_eq!(v1.num_parameters(), 6_444_555);
        assert_eq!(v1.tensors().len(), 92);
    }

    #[test]
    fn compact_is_under_one_megabyte_even_in_f16() {
        let compact = RegressorConfig::preset(Preset::Compact, 64);
        assert!(
            compact.num_parameters() * 2 < 1_000_000,
            "{}",
            compact.num_parameters()
        );
    }

    #[test]
    fn configurations_survive_json_and_refuse_strangers() {
        for preset in Preset::ALL {
            let config = RegressorConfig::preset(preset, 64);
            let text = serde_json::to_string(&config).expect("plain data");
            let back: RegressorConfig = serde_json::from_str(&text).expect("own text");
            assert_eq!(back, config);
            let stranger = text.replacen("\"num_anchors\"", "\"anchors\"", 1).replacen(
                "\"heads\"",
                "\"headz\"",
                1,
            );
            assert!(serde_json::from_str::<RegressorConfig>(&stranger).is_err());
        }
    }

    #[test]
    fn sizes_out_of_range_are_refused() {
        let mut c = match RegressorConfig::preset(Preset::Paper, 256) {
            RegressorConfig::Branches {
                point: PointBranchConfig::Attention(c),
                ..
            } => c,
            other => panic!("{other:?}"),
        };
        c.heads = 3;
        assert!(matches!(c.validate(), Err(ModelError::Mismatch(_))));
        c.heads = 4;
        c.width = usize::MAX;
        assert!(matches!(
            c.validate(),
            Err(ModelError::Size { field: "width", .. })
        ));
        c.width = 256;
        c.min_confidence = f32::NAN;
        assert!(matches!(c.validate(), Err(ModelError::Number { .. })));
    }

    #[test]
    fn graphs_need_exactly_what_prepare_makes() {
        for preset in Preset::ALL {
            let config = RegressorConfig::preset(preset, 64);
            let mut weights: Weights = config
                .tensors()
                .into_iter()
                .map(|t| {
                    let n = t.shape.iter().product();
                    let data = (0..n).map(|i| 0.01 + (i % 7) as f32 * 1e-3).collect();
                    (
                        t.name,
                        crate::nn::WeightTensor::f32(&t.shape, data).expect("sizes"),
                    )
                })
                .collect();
            config.check_weights(&weights).expect("own list");
            let RegressorConfig::Branches { point, line } = &config else {
                panic!("a preset has branches")
            };
            let line = line.as_ref().expect("a preset has lines");
            let made = point.prepare(&mut weights).expect("prepares");
            check_exactly(point.graph(10).expect("builds").weights(), &made).expect("points");
            let made = line.prepare(&mut weights).expect("prepares");
            check_exactly(line.graph(10).expect("builds").weights(), &made).expect("lines");
            assert!(
                weights.is_empty(),
                "prepare takes every tensor: {:?}",
                weights.iter().next().map(|x| x.0)
            );
        }
    }
}
