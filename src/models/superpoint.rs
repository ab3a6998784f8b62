//! SuperPoint: layers, tensor names, graph.
//!
//! Source: [superpoint2018]. The open re-training puts a batch
//! norm *after* each activation. It cannot be folded into the next convolution, whose border of zeros it does not reach, so
//! its two vectors stay as a channel-wise linear layer `NAME.post` (one group for each channel); where no activation lies
//! between (the last layers of the heads) it is folded at import.

use super::CELL;
use super::config::{Specs, TensorSpec};
use super::error::ModelError;
use super::ports;
use crate::nn::{Activation, Dense, Graph, GraphBuilder, Tensor};

/// Input and output channels of the encoder's 3x3 convolutions; a pool follows every second one but the last.
const ENCODER: [(usize, usize); 8] = [
    (1, 64),
    (64, 64),
    (64, 64),
    (64, 64),
    (64, 128),
    (128, 128),
    (128, 128),
    (128, 128),
];

/// Hidden channels of both heads.
const HEAD: usize = 256;

/// Numbers in a descriptor.
const DESCRIPTOR: usize = 256;

pub(super) fn tensors(post_norm: bool) -> Vec<TensorSpec> {
    let mut specs = Specs::default();
    let conv = |specs: &mut Specs, name: &str, input: usize, out: usize| {
        specs.add(format!("{name}.w"), &[out, input, 3, 3]);
        specs.add(format!("{name}.b"), &[out]);
        if post_norm {
            specs.linear(&format!("{name}.post"), out, 1);
        }
    };
    for (i, (input, out)) in ENCODER.into_iter().enumerate() {
        conv(&mut specs, &format!("encoder.{i}"), input, out);
    }
    conv(&mut specs, "detector.0", 128, HEAD);
    specs.linear("detector.1", CELL * CELL + 1, HEAD);
    conv(&mut specs, "descriptor.0", 128, HEAD);
    specs.linear("descriptor.1", DESCRIPTOR, HEAD);
    specs.0
}

fn block(g: &mut GraphBuilder, x: Tensor, name: &str, out: usize, post_norm: bool) -> Tensor {
    let y = g.conv3x3(x, Dense::new(name, out).activation(Activation::Relu));
    if post_norm {
        g.linear(y, Dense::new(&format!("{name}.post"), out).groups(out))
    } else {
        y
    }
}

pub(super) fn graph(
    width: usize,
    height: usize,
    post_norm: bool,
    diagnostics: bool,
) -> Result<Graph, ModelError> {
    let mut g = GraphBuilder::new("superpoint");
    let mut x = g.input_grid(ports::GRAY, height, width, 1);
    for (i, (_, out)) in ENCODER.into_iter().enumerate() {
        x = block(&mut g, x, &format!("encoder.{i}"), out, post_norm);
        if i % 2 == 1 && i + 1 < ENCODER.len() {
            x = g.max_pool(x, 2, 2, 0);
        }
    }
    let hidden = block(&mut g, x, "detector.0", HEAD, post_norm);
    let logits = g.linear(hidden, Dense::new("detector.1", CELL * CELL + 1));
    let heat = g.detector_heat(logits, CELL);
    let hidden = block(&mut g, x, "descriptor.0", HEAD, post_norm);
    let features = g.linear(hidden, Dense::new("descriptor.1", DESCRIPTOR));
    let unit = g.l2_norm(features, 1e-12);
    g.output(ports::FEATURES, unit);
    g.output(ports::HEAT, heat);
    if diagnostics {
        g.output("raw_features", features);
        g.output("keypoint_logits", logits);
    }
    Ok(g.finish()?)
}
