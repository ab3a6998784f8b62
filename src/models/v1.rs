//! PL2Map ([pl2map2025]), the predecessor: points and lines in one graph network of alternating self- and cross-attention.
//!
//! A layer's parameters serve both streams. Every element gets coordinates and one more number `x`; its reliability is
//! `1 / (1 + 100 |x|)`. Used for imported checkpoints; it is not trained here.

use super::attention::{AttentionLayer, LineEncoder, Mlp, pass_linear, widths};
use super::config::{MAX_ROWS, Specs, TensorSpec};
use super::error::{ModelError, check_probability, check_size};
use super::ports;
use super::proposed::check_sizes;
use crate::nn::{Dense, Graph, GraphBuilder, Weights};
use serde::{Deserialize, Serialize};

/// Sizes of the joint network. Layers with an odd index are cross-attention.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V1Config {
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
    /// Attention layers: self, cross, self, ...
    pub num_layers: usize,
    /// Hidden width of each attention layer's MLP.
    pub mlp_hidden: usize,
    /// Hidden widths of the head for points.
    pub point_head_hidden: Vec<usize>,
    /// Hidden widths of the head for segments.
    pub line_head_hidden: Vec<usize>,
    /// Keypoints whose reliability is below this are dropped.
    pub min_point_confidence: f32,
    /// Segments whose reliability is below this are dropped.
    pub min_line_confidence: f32,
}

impl V1Config {
    /// The published sizes and test thresholds.
    pub fn paper() -> Self {
        Self {
            descriptor_channels: 256,
            tokens: 12,
            width: 256,
            heads: 4,
            encoder_hidden: 1024,
            num_layers: 5,
            mlp_hidden: 512,
            point_head_hidden: vec![512, 1024, 512],
            line_head_hidden: vec![512, 1024, 512],
            min_point_confidence: 0.5,
            min_line_confidence: 0.02,
        }
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

    fn has_input_layer(&self) -> bool {
        self.descriptor_channels != self.width
    }

    pub(super) fn validate(&self) -> Result<(), ModelError> {
        for head in [&self.point_head_hidden, &self.line_head_hidden] {
            check_sizes(
                self.descriptor_channels,
                self.width,
                self.heads,
                self.num_layers,
                self.mlp_hidden,
                head,
            )?;
        }
        check_size("tokens", self.tokens, 2, 64)?;
        check_size("encoder_hidden", self.encoder_hidden, 1, 4096)?;
        check_probability("min_point_confidence", self.min_point_confidence)?;
        check_probability("min_line_confidence", self.min_line_confidence)
    }

    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        let mut specs = Specs::default();
        if self.has_input_layer() {
            specs.linear("point.in", self.width, self.descriptor_channels);
        }
        self.encoder().tensors(&mut specs);
        for i in 0..self.num_layers {
            self.layer().tensors(&mut specs, &format!("joint.attn.{i}"));
        }
        specs.mlp(
            "point.head",
            &widths(self.width, &self.point_head_hidden, 4),
        );
        specs.mlp("line.head", &widths(self.width, &self.line_head_hidden, 7));
        specs.0
    }

    /// The graph for at most these many keypoints and segments.
    ///
    /// # Errors
    /// [`ModelError`] when the configuration or a capacity is out of range.
    pub fn graph(&self, max_points: usize, max_segments: usize) -> Result<Graph, ModelError> {
        self.validate()?;
        check_size("max_points", max_points, 1, MAX_ROWS)?;
        check_size("max_segments", max_segments, 1, MAX_ROWS)?;
        let mut g = GraphBuilder::new("v1");
        let points = g.count(ports::POINTS, max_points);
        let segments = g.count(ports::SEGMENTS, max_segments);
        let descriptors = g.input_rows(ports::DESCRIPTORS, points, self.descriptor_channels);
        let tokens = g.input_tokens(
            ports::TOKENS,
            segments,
            self.tokens,
            self.descriptor_channels,
        );
        let mut p = if self.has_input_layer() {
            g.linear(descriptors, Dense::new("point.in", self.width))
        } else {
            descriptors
        };
        let mut l = self.encoder().graph(&mut g, tokens);
        let layer = self.layer();
        for i in 0..self.num_layers {
            let name = format!("joint.attn.{i}");
            let [pq, pk, pv] = layer.project(&mut g, &name, p);
            let [lq, lk, lv] = layer.project(&mut g, &name, l);
            let (for_p, for_l) = if i % 2 == 0 {
                ([pq, pk, pv], [lq, lk, lv])
            } else {
                ([pq, lk, lv], [lq, pk, pv])
            };
            p = layer.update(&mut g, &name, p, for_p, None);
            l = layer.update(&mut g, &name, l, for_l, None);
        }
        let head = Mlp {
            name: "point.head",
            widths: &widths(self.width, &self.point_head_hidden, 4),
        };
        let points_3d = head.graph(&mut g, p);
        g.output(ports::POINTS_3D, points_3d);
        let head = Mlp {
            name: "line.head",
            widths: &widths(self.width, &self.line_head_hidden, 7),
        };
        let lines_3d = head.graph(&mut g, l);
        g.output(ports::LINES_3D, lines_3d);
        Ok(g.finish()?)
    }

    /// Turns a file's tensors into the weights of [`Self::graph`].
    ///
    /// # Errors
    /// [`ModelError::Nn`] for a missing or misshapen tensor.
    pub fn prepare(&self, weights: &mut Weights) -> Result<Weights, ModelError> {
        self.validate()?;
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
        self.encoder().prepare(weights, &mut made)?;
        for i in 0..self.num_layers {
            self.layer()
                .prepare(weights, &mut made, &format!("joint.attn.{i}"))?;
        }
        for (name, hidden, out) in [
            ("point.head", &self.point_head_hidden, 4),
            ("line.head", &self.line_head_hidden, 7),
        ] {
            Mlp {
                name,
                widths: &widths(self.width, hidden, out),
            }
            .pass(weights, &mut made)?;
        }
        Ok(made)
    }
}
