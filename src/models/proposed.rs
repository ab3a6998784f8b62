//! The network of [plmap2025]: two branches that share nothing.
//!
//! Points: prune by a sigmoid MLP on the descriptors, self-attention among the survivors, head. Lines: line encoder,
//! self-attention among all, prune, head. A linear input layer comes first where the descriptor size differs from the width.
//!
//! With [`AttentionOutput::Anchored`] the features shift the descriptor before it chooses among landmarks. Points that the
//! pruning MLP rejects are then only not attended to; they get coordinates, and their reliability comes from the choice.

use super::anchored::{AttentionOutput, Choice, UNIT_EPS, mean_pool};
use super::attention::{AttentionLayer, LineEncoder, Mlp, min_logit, pass_linear, widths};
use super::config::{Specs, TensorSpec};
use super::error::{ModelError, check_probability, check_size};
use super::ports;
use crate::nn::{Dense, Graph, GraphBuilder, Tensor, WeightTensor, Weights};
use serde::{Deserialize, Serialize};

/// Sizes of the point branch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttentionPointConfig {
    /// Numbers in a descriptor.
    pub descriptor_channels: usize,
    /// Width of the attention layers.
    pub width: usize,
    /// Attention heads; divides the width.
    pub heads: usize,
    /// Self-attention layers.
    pub num_layers: usize,
    /// Hidden width of each attention layer's MLP.
    pub mlp_hidden: usize,
    /// Hidden width of the pruning MLP.
    pub prune_hidden: usize,
    /// Hidden widths of the head.
    pub head_hidden: Vec<usize>,
    /// Keypoints whose probability is not above this are dropped; 0 keeps all. With an anchored output they are only not
    /// attended to, and 0 leaves the pruning MLP out.
    pub min_confidence: f32,
    /// From features to coordinates.
    #[serde(default)]
    pub output: AttentionOutput,
}

/// Sizes of the line branch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttentionLineConfig {
    /// Numbers in a descriptor.
    pub descriptor_channels: usize,
    /// Samples along a segment, both ends included.
    pub tokens: usize,
    /// Width of encoder and attention.
    pub width: usize,
    /// Attention heads; divides the width.
    pub heads: usize,
    /// Hidden width of the encoder's feed-forward part.
    pub encoder_hidden: usize,
    /// Self-attention layers after the encoder.
    pub num_layers: usize,
    /// Hidden width of each attention layer's MLP.
    pub mlp_hidden: usize,
    /// Hidden width of the pruning MLP.
    pub prune_hidden: usize,
    /// Hidden widths of the head.
    pub head_hidden: Vec<usize>,
    /// Segments whose probability is not above this are dropped; 0 keeps all.
    pub min_confidence: f32,
    /// From features to coordinates.
    #[serde(default)]
    pub output: AttentionOutput,
}

/// Ranges of the sizes that both branches and `v1` share.
pub(super) fn check_sizes(
    descriptor: usize,
    width: usize,
    heads: usize,
    num_layers: usize,
    mlp_hidden: usize,
    head_hidden: &[usize],
) -> Result<(), ModelError> {
    check_size("descriptor_channels", descriptor, 1, 1024)?;
    check_size("width", width, 1, 1024)?;
    check_size("heads", heads, 1, 32)?;
    check_size("num_layers", num_layers, 0, 32)?;
    check_size("mlp_hidden", mlp_hidden, 1, 4096)?;
    check_size("head_hidden.len", head_hidden.len(), 0, 8)?;
    for hidden in head_hidden {
        check_size("head_hidden", *hidden, 1, 4096)?;
    }
    if !width.is_multiple_of(heads) {
        return Err(ModelError::Mismatch(format!(
            "{heads} heads do not divide the width {width}"
        )));
    }
    Ok(())
}

impl AttentionPointConfig {
    fn has_input_layer(&self) -> bool {
        self.descriptor_channels != self.width
    }

    fn choice(&self) -> Option<Choice> {
        Choice::of_points(self.output, self.descriptor_channels)
    }

    fn has_pruning(&self) -> bool {
        self.choice().is_none() || self.min_confidence > 0.0
    }

    fn prune_widths(&self) -> [usize; 3] {
        [self.width, self.prune_hidden, 1]
    }

    fn layer(&self) -> AttentionLayer {
        AttentionLayer {
            width: self.width,
            heads: self.heads,
            mlp_hidden: self.mlp_hidden,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ModelError> {
        check_sizes(
            self.descriptor_channels,
            self.width,
            self.heads,
            self.num_layers,
            self.mlp_hidden,
            &self.head_hidden,
        )?;
        check_size("prune_hidden", self.prune_hidden, 1, 4096)?;
        if let Some(choice) = self.choice() {
            choice.validate()?;
        }
        check_probability("min_confidence", self.min_confidence)
    }

    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        let mut specs = Specs::default();
        if self.has_input_layer() {
            specs.linear("point.in", self.width, self.descriptor_channels);
        }
        if self.has_pruning() {
            specs.mlp("point.prune", &self.prune_widths());
        }
        for i in 0..self.num_layers {
            self.layer().tensors(&mut specs, &format!("point.attn.{i}"));
        }
        if let Some(choice) = self.choice() {
            specs.linear("point.query", self.descriptor_channels, self.width);
            choice.tensors(&mut specs);
        }
        specs.mlp("point.head", &widths(self.width, &self.head_hidden, 3));
        specs.0
    }

    pub(super) fn graph(&self, capacity: usize) -> Result<Graph, ModelError> {
        let mut g = GraphBuilder::new("point branch");
        let points = g.count(ports::POINTS, capacity);
        let descriptors = g.input_rows(ports::DESCRIPTORS, points, self.descriptor_channels);
        let x = if self.has_input_layer() {
            g.linear(descriptors, Dense::new("point.in", self.width))
        } else {
            descriptors
        };
        let prune_widths = self.prune_widths();
        let prune = self.has_pruning().then(|| {
            let mlp = Mlp {
                name: "point.prune",
                widths: &prune_widths,
            };
            mlp.graph(&mut g, x)
        });
        let head_widths = widths(self.width, &self.head_hidden, 3);
        let head = Mlp {
            name: "point.head",
            widths: &head_widths,
        };
        let attended = |g: &mut GraphBuilder, mut x: Tensor, keep: Option<Tensor>| {
            for i in 0..self.num_layers {
                x = self.layer().graph(g, &format!("point.attn.{i}"), x, keep);
            }
            x
        };
        match (self.choice(), prune) {
            (Some(choice), keep) => {
                let x = attended(&mut g, x, keep);
                let shifted = g.linear(
                    x,
                    Dense::new("point.query", self.descriptor_channels).residual(descriptors),
                );
                let query = g.l2_norm(shifted, UNIT_EPS);
                let [chosen, logits] = choice.graph(&mut g, query);
                g.output(ports::LOGITS, logits);
                let coordinates = head.graph_onto(&mut g, x, Some(chosen));
                g.output(ports::COORDINATES, coordinates);
            }
            (None, Some(logits)) => {
                g.output(ports::LOGITS, logits);
                let [kept, rows] = g.keep(x, logits, min_logit(self.min_confidence), "kept points");
                g.output(ports::ROWS, rows);
                let kept = attended(&mut g, kept, None);
                let coordinates = head.graph(&mut g, kept);
                g.output(ports::COORDINATES, coordinates);
            }
            (None, None) => unreachable!("a linear output prunes"),
        }
        Ok(g.finish()?)
    }

    pub(super) fn prepare(&self, weights: &mut Weights) -> Result<Weights, ModelError> {
        let mut made = Weights::new();
        if self.has_input_layer() {
            pass_linear(
                weights,
                &mut made,
                "point.in",
                self.width,
                self.descriptor_channels,
            )?;
        }
        if self.has_pruning() {
            if self.choice().is_some() {
                // The mask of the attention is "above zero".
                lower_bias(weights, "point.prune.1.b", min_logit(self.min_confidence))?;
            }
            Mlp {
                name: "point.prune",
                widths: &self.prune_widths(),
            }
            .pass(weights, &mut made)?;
        }
        if let Some(choice) = self.choice() {
            pass_linear(
                weights,
                &mut made,
                "point.query",
                self.descriptor_channels,
                self.width,
            )?;
            choice.prepare(weights, &mut made)?;
        }
        for i in 0..self.num_layers {
            self.layer()
                .prepare(weights, &mut made, &format!("point.attn.{i}"))?;
        }
        Mlp {
            name: "point.head",
            widths: &widths(self.width, &self.head_hidden, 3),
        }
        .pass(weights, &mut made)?;
        Ok(made)
    }
}

/// Subtracts from a layer's only bias.
fn lower_bias(weights: &mut Weights, name: &str, by: f32) -> Result<(), ModelError> {
    let bias = weights.take_f32(name, &[1])?;
    weights.insert(name, WeightTensor::f32(&[1], vec![bias[0] - by])?);
    Ok(())
}

impl AttentionLineConfig {
    fn choice(&self) -> Option<Choice> {
        Choice::of_segments(self.output, self.descriptor_channels)
    }

    fn encoder(&self) -> LineEncoder {
        LineEncoder {
            input: self.descriptor_channels,
            width: self.width,
            heads: self.heads,
            hidden: self.encoder_hidden,
            tokens: self.tokens,
        }
    }

    fn layer(&self) -> AttentionLayer {
        AttentionLayer {
            width: self.width,
            heads: self.heads,
            mlp_hidden: self.mlp_hidden,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ModelError> {
        check_sizes(
            self.descriptor_channels,
            self.width,
            self.heads,
            self.num_layers,
            self.mlp_hidden,
            &self.head_hidden,
        )?;
        check_size("tokens", self.tokens, 2, 64)?;
        check_size("encoder_hidden", self.encoder_hidden, 1, 4096)?;
        check_size("prune_hidden", self.prune_hidden, 1, 4096)?;
        if let Some(choice) = self.choice() {
            choice.validate()?;
        }
        check_probability("min_confidence", self.min_confidence)
    }

    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        let mut specs = Specs::default();
        self.encoder().tensors(&mut specs);
        for i in 0..self.num_layers {
            self.layer().tensors(&mut specs, &format!("line.attn.{i}"));
        }
        match self.choice() {
            None => specs.mlp("line.prune", &[self.width, self.prune_hidden, 1]),
            Some(choice) => {
                specs.linear("line.query", self.descriptor_channels, self.width);
                choice.tensors(&mut specs);
            }
        }
        specs.mlp("line.head", &widths(self.width, &self.head_hidden, 6));
        specs.0
    }

    pub(super) fn graph(&self, capacity: usize) -> Result<Graph, ModelError> {
        let mut g = GraphBuilder::new("line branch");
        let segments = g.count(ports::SEGMENTS, capacity);
        let tokens = g.input_tokens(
            ports::TOKENS,
            segments,
            self.tokens,
            self.descriptor_channels,
        );
        let mut x = self.encoder().graph(&mut g, tokens);
        for i in 0..self.num_layers {
            x = self
                .layer()
                .graph(&mut g, &format!("line.attn.{i}"), x, None);
        }
        let min_logit = min_logit(self.min_confidence);
        let head_widths = widths(self.width, &self.head_hidden, 6);
        let head = Mlp {
            name: "line.head",
            widths: &head_widths,
        };
        let rows = if let Some(choice) = self.choice() {
            let joined = g.join_rows(tokens, self.tokens);
            let pooled = g.linear(
                joined,
                Dense::new("line.pool", self.descriptor_channels).without_bias(),
            );
            let descriptors = g.l2_norm(pooled, UNIT_EPS);
            let shifted = g.linear(
                x,
                Dense::new("line.query", self.descriptor_channels).residual(descriptors),
            );
            let query = g.l2_norm(shifted, UNIT_EPS);
            let [chosen, logits] = choice.graph(&mut g, query);
            g.output(ports::LOGITS, logits);
            let coordinates = head.graph_onto(&mut g, x, Some(chosen));
            let [kept, rows] = g.keep(coordinates, logits, min_logit, "kept segments");
            g.output(ports::COORDINATES, kept);
            rows
        } else {
            let prune = Mlp {
                name: "line.prune",
                widths: &[self.width, self.prune_hidden, 1],
            };
            let logits = prune.graph(&mut g, x);
            g.output(ports::LOGITS, logits);
            let [kept, rows] = g.keep(x, logits, min_logit, "kept segments");
            let coordinates = head.graph(&mut g, kept);
            g.output(ports::COORDINATES, coordinates);
            rows
        };
        g.output(ports::ROWS, rows);
        Ok(g.finish()?)
    }

    pub(super) fn prepare(&self, weights: &mut Weights) -> Result<Weights, ModelError> {
        let mut made = Weights::new();
        self.encoder().prepare(weights, &mut made)?;
        for i in 0..self.num_layers {
            self.layer()
                .prepare(weights, &mut made, &format!("line.attn.{i}"))?;
        }
        if let Some(choice) = self.choice() {
            made.insert(
                "line.pool.w",
                mean_pool(self.descriptor_channels, self.tokens)?,
            );
            pass_linear(
                weights,
                &mut made,
                "line.query",
                self.descriptor_channels,
                self.width,
            )?;
            choice.prepare(weights, &mut made)?;
        } else {
            Mlp {
                name: "line.prune",
                widths: &[self.width, self.prune_hidden, 1],
            }
            .pass(weights, &mut made)?;
        }
        Mlp {
            name: "line.head",
            widths: &widths(self.width, &self.head_hidden, 6),
        }
        .pass(weights, &mut made)?;
        Ok(made)
    }
}
