//! Branches anchored on learned landmarks (preset `compact`), and the part of them that ends the attention branches of
//! `standard`.
//!
//! A unit descriptor is compared with `K` learned unit keys; a softmax with learned sharpness chooses softly among the
//! keys' 3D values (positions, or segments as start and end). A small MLP on the descriptor and the statistics of the choice
//! (best similarity, second best, their difference, entropy, spread) gives the reliability. An optional MLP of the same kind
//! adds an offset to the chosen value. A segment's descriptor is pooled from its tokens and made unit.
//!
//! Keys are normalised when they are prepared: their stored length means nothing, so 8-bit storage does not scale scores.

use super::attention::{pass, pass_linear, put_matrix, put_vector, take_linear};
use super::config::{Specs, TensorSpec};
use super::error::{ModelError, check_size};
use super::ports;
use crate::nn::{
    Activation, CHOICE_STATISTICS, Dense, Graph, GraphBuilder, Tensor, WeightTensor, Weights,
};
use serde::{Deserialize, Serialize};

/// Norms below this count as zero, as in the extractors.
pub(super) const UNIT_EPS: f32 = 1e-12;

/// What an attention branch makes of its features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum AttentionOutput {
    /// The paper's: the last layer of the head gives the coordinates.
    #[default]
    Linear,
    /// A linear layer on the features shifts the descriptor, the unit result chooses softly among learned landmarks, and the
    /// head adds an offset. Where shift and offset are zero, the branch is the landmarks.
    Anchored {
        /// Landmarks.
        num_anchors: usize,
        /// Hidden width of the reliability MLP.
        reliability_hidden: usize,
    },
}

/// How the tokens of a segment become one descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinePool {
    /// Their mean; `key_channels` equals the descriptor size. It has no tensor.
    Mean,
    /// A learned linear layer `line.pool.w` over all tokens side by side.
    Learned,
}

/// Sizes of the anchored point branch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchoredPointConfig {
    /// Numbers in a descriptor, thus in a key.
    pub descriptor_channels: usize,
    /// Landmarks.
    pub num_anchors: usize,
    /// Hidden width of the offset MLP; 0 for none.
    pub offset_hidden: usize,
    /// Hidden width of the reliability MLP.
    pub reliability_hidden: usize,
}

/// Sizes of the anchored line branch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchoredLineConfig {
    /// Numbers in a descriptor.
    pub descriptor_channels: usize,
    /// Samples along a segment, both ends included.
    pub tokens: usize,
    /// From tokens to a descriptor of the segment.
    pub pool: LinePool,
    /// Numbers in a segment's descriptor, thus in a key.
    pub key_channels: usize,
    /// Landmark segments.
    pub num_anchors: usize,
    /// Hidden width of the offset MLP; 0 for none.
    pub offset_hidden: usize,
    /// Hidden width of the reliability MLP.
    pub reliability_hidden: usize,
}

/// The part that all anchored branches share, from a unit descriptor on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Choice {
    /// `point` or `line`.
    prefix: &'static str,
    /// Name of the value tensor.
    values: &'static str,
    key_channels: usize,
    value_channels: usize,
    num_anchors: usize,
    offset_hidden: usize,
    reliability_hidden: usize,
}

impl Choice {
    /// Among points for descriptors of `key_channels`; `None` for the linear output.
    pub(super) fn of_points(output: AttentionOutput, key_channels: usize) -> Option<Self> {
        Self::of(output, "point", "positions", key_channels, 3)
    }

    /// Among segments.
    pub(super) fn of_segments(output: AttentionOutput, key_channels: usize) -> Option<Self> {
        Self::of(output, "line", "segments", key_channels, 6)
    }

    fn of(
        output: AttentionOutput,
        prefix: &'static str,
        values: &'static str,
        key_channels: usize,
        value_channels: usize,
    ) -> Option<Self> {
        match output {
            AttentionOutput::Linear => None,
            AttentionOutput::Anchored {
                num_anchors,
                reliability_hidden,
            } => Some(Self {
                prefix,
                values,
                key_channels,
                value_channels,
                num_anchors,
                offset_hidden: 0,
                reliability_hidden,
            }),
        }
    }

    pub(super) fn validate(&self) -> Result<(), ModelError> {
        check_size("num_anchors", self.num_anchors, 1, 65_536)?;
        check_size("key_channels", self.key_channels, 1, 1024)?;
        check_size("offset_hidden", self.offset_hidden, 0, 1024)?;
        check_size("reliability_hidden", self.reliability_hidden, 1, 1024)
    }

    /// Name, hidden width and output width of the MLPs on descriptor and statistics.
    fn mlps(&self) -> Vec<(String, usize, usize)> {
        let mut out = vec![(
            format!("{}.reliability", self.prefix),
            self.reliability_hidden,
            1,
        )];
        if self.offset_hidden > 0 {
            out.push((
                format!("{}.offset", self.prefix),
                self.offset_hidden,
                self.value_channels,
            ));
        }
        out
    }

    pub(super) fn tensors(&self, specs: &mut Specs) {
        let anchor = format!("{}.anchor", self.prefix);
        specs.add(
            format!("{anchor}.keys"),
            &[self.num_anchors, self.key_channels],
        );
        specs.add(
            format!("{anchor}.{}", self.values),
            &[self.num_anchors, self.value_channels],
        );
        specs.add(format!("{anchor}.sharpness"), &[1]);
        for (name, hidden, out) in self.mlps() {
            specs.mlp(&name, &[self.key_channels + CHOICE_STATISTICS, hidden, out]);
        }
    }

    pub(super) fn prepare(
        &self,
        weights: &mut Weights,
        made: &mut Weights,
    ) -> Result<(), ModelError> {
        let anchor = format!("{}.anchor", self.prefix);
        let key_shape = [self.num_anchors, self.key_channels];
        let keys_name = format!("{anchor}.keys");
        let mut keys = weights.take_f32(&keys_name, &key_shape)?;
        for key in keys.chunks_exact_mut(self.key_channels) {
            let norm = key
                .iter()
                .map(|x| f64::from(*x).powi(2))
                .sum::<f64>()
                .sqrt();
            let inverse = 1.0 / norm.max(f64::from(UNIT_EPS));
            for x in key {
                *x = (f64::from(*x) * inverse) as f32;
            }
        }
        made.insert(keys_name, WeightTensor::f32(&key_shape, keys)?);
        let value_shape = [self.num_anchors, self.value_channels];
        let values = weights.take_f32(&format!("{anchor}.{}", self.values), &value_shape)?;
        made.insert(
            format!("{anchor}.values"),
            WeightTensor::f32(&value_shape, values)?,
        );
        pass(weights, made, &format!("{anchor}.sharpness"), &[1])?;
        let c = self.key_channels;
        for (name, hidden, out) in self.mlps() {
            let (w, b) = take_linear(weights, &format!("{name}.0"), hidden, c + CHOICE_STATISTICS)?;
            put_matrix(made, &format!("{name}.0.descriptor.w"), &w.columns(0, c))?;
            put_matrix(
                made,
                &format!("{name}.0.choice.w"),
                &w.columns(c, c + CHOICE_STATISTICS),
            )?;
            put_vector(made, &format!("{name}.0.choice.b"), &b)?;
            pass_linear(weights, made, &format!("{name}.1"), out, hidden)?;
        }
        Ok(())
    }

    /// Coordinates and reliability logits for unit descriptors.
    pub(super) fn graph(&self, g: &mut GraphBuilder, descriptor: Tensor) -> [Tensor; 2] {
        let [chosen, statistics] = g.soft_choice(
            descriptor,
            &format!("{}.anchor", self.prefix),
            self.num_anchors,
            self.value_channels,
        );
        let mlp = |g: &mut GraphBuilder, name: &str, hidden, out, residual: Option<Tensor>| {
            let own = g.linear(
                descriptor,
                Dense::new(&format!("{name}.0.descriptor"), hidden).without_bias(),
            );
            let h = g.linear(
                statistics,
                Dense::new(&format!("{name}.0.choice"), hidden)
                    .residual(own)
                    .activation(Activation::Relu),
            );
            let last = format!("{name}.1");
            let layer = Dense::new(&last, out);
            match residual {
                Some(r) => g.linear(h, layer.residual(r)),
                None => g.linear(h, layer),
            }
        };
        let logits = mlp(
            g,
            &format!("{}.reliability", self.prefix),
            self.reliability_hidden,
            1,
            None,
        );
        let coordinates = if self.offset_hidden > 0 {
            mlp(
                g,
                &format!("{}.offset", self.prefix),
                self.offset_hidden,
                self.value_channels,
                Some(chosen),
            )
        } else {
            chosen
        };
        [coordinates, logits]
    }

    /// As [`Self::graph`], for a branch that ends here.
    fn outputs(&self, g: &mut GraphBuilder, descriptor: Tensor) {
        let [coordinates, logits] = self.graph(g, descriptor);
        g.output(ports::LOGITS, logits);
        g.output(ports::COORDINATES, coordinates);
    }
}

/// The mean over the tokens of a segment as a linear layer `[channels, tokens * channels]`.
pub(super) fn mean_pool(channels: usize, tokens: usize) -> Result<WeightTensor, ModelError> {
    let input = tokens * channels;
    let mut w = vec![0.0; channels * input];
    for (channel, row) in w.chunks_exact_mut(input).enumerate() {
        for token in row.chunks_exact_mut(channels) {
            token[channel] = 1.0 / tokens as f32;
        }
    }
    Ok(WeightTensor::f32(&[channels, input], w)?)
}

impl AnchoredPointConfig {
    fn choice(&self) -> Choice {
        Choice {
            prefix: "point",
            values: "positions",
            key_channels: self.descriptor_channels,
            value_channels: 3,
            num_anchors: self.num_anchors,
            offset_hidden: self.offset_hidden,
            reliability_hidden: self.reliability_hidden,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ModelError> {
        check_size("descriptor_channels", self.descriptor_channels, 1, 1024)?;
        self.choice().validate()
    }

    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        let mut specs = Specs::default();
        self.choice().tensors(&mut specs);
        specs.0
    }

    pub(super) fn graph(&self, capacity: usize) -> Result<Graph, ModelError> {
        let mut g = GraphBuilder::new("anchored point branch");
        let points = g.count(ports::POINTS, capacity);
        let x = g.input_rows(ports::DESCRIPTORS, points, self.descriptor_channels);
        self.choice().outputs(&mut g, x);
        Ok(g.finish()?)
    }

    pub(super) fn prepare(&self, weights: &mut Weights) -> Result<Weights, ModelError> {
        let mut made = Weights::new();
        self.choice().prepare(weights, &mut made)?;
        Ok(made)
    }
}

impl AnchoredLineConfig {
    fn choice(&self) -> Choice {
        Choice {
            prefix: "line",
            values: "segments",
            key_channels: self.key_channels,
            value_channels: 6,
            num_anchors: self.num_anchors,
            offset_hidden: self.offset_hidden,
            reliability_hidden: self.reliability_hidden,
        }
    }

    fn pool_shape(&self) -> [usize; 2] {
        [self.key_channels, self.tokens * self.descriptor_channels]
    }

    pub(super) fn validate(&self) -> Result<(), ModelError> {
        check_size("descriptor_channels", self.descriptor_channels, 1, 1024)?;
        check_size("tokens", self.tokens, 2, 64)?;
        if self.pool == LinePool::Mean && self.key_channels != self.descriptor_channels {
            return Err(ModelError::Mismatch(format!(
                "a mean of tokens has {} numbers, the keys have {}",
                self.descriptor_channels, self.key_channels
            )));
        }
        self.choice().validate()
    }

    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        let mut specs = Specs::default();
        if self.pool == LinePool::Learned {
            specs.add("line.pool.w", &self.pool_shape());
        }
        self.choice().tensors(&mut specs);
        specs.0
    }

    pub(super) fn graph(&self, capacity: usize) -> Result<Graph, ModelError> {
        let mut g = GraphBuilder::new("anchored line branch");
        let segments = g.count(ports::SEGMENTS, capacity);
        let tokens = g.input_tokens(
            ports::TOKENS,
            segments,
            self.tokens,
            self.descriptor_channels,
        );
        let joined = g.join_rows(tokens, self.tokens);
        let pooled = g.linear(
            joined,
            Dense::new("line.pool", self.key_channels).without_bias(),
        );
        let descriptor = g.l2_norm(pooled, UNIT_EPS);
        self.choice().outputs(&mut g, descriptor);
        Ok(g.finish()?)
    }

    pub(super) fn prepare(&self, weights: &mut Weights) -> Result<Weights, ModelError> {
        let mut made = Weights::new();
        match self.pool {
            LinePool::Learned => pass(weights, &mut made, "line.pool.w", &self.pool_shape())?,
            LinePool::Mean => {
                made.insert(
                    "line.pool.w",
                    mean_pool(self.descriptor_channels, self.tokens)?,
                );
            }
        }
        self.choice().prepare(weights, &mut made)?;
        Ok(made)
    }
}
