//! XFeat: layers, tensor names, graph. Batch norms are folded at import (exact: they stand before the activation).
//!
//! Source: [xfeat2024] and its published weights.

use super::CELL;
use super::config::{Specs, TensorSpec};
use super::error::ModelError;
use super::ports;
use crate::nn::{Activation, Dense, Graph, GraphBuilder, Tensor};

/// The picture is resized to multiples of this.
pub(super) const MULTIPLE: usize = 32;

/// Epsilon of the instance norm.
const INSTANCE_EPS: f32 = 1e-5;

#[derive(Debug, Clone, Copy)]
enum Kind {
    /// 3x3, stride 1.
    Conv,
    /// 3x3, stride 2.
    Down,
    /// 1x1.
    Point,
}

#[derive(Debug, Clone, Copy)]
struct Layer {
    name: &'static str,
    kind: Kind,
    input: usize,
    out: usize,
    relu: bool,
}

const fn layer(name: &'static str, kind: Kind, input: usize, out: usize) -> Layer {
    Layer {
        name,
        kind,
        input,
        out,
        relu: true,
    }
}

const fn last(name: &'static str, input: usize, out: usize) -> Layer {
    Layer {
        name,
        kind: Kind::Point,
        input,
        out,
        relu: false,
    }
}

const SKIP: Layer = last("skip", 1, 24);
const BLOCK1: [Layer; 4] = [
    layer("block1.0", Kind::Conv, 1, 4),
    layer("block1.1", Kind::Down, 4, 8),
    layer("block1.2", Kind::Conv, 8, 8),
    layer("block1.3", Kind::Down, 8, 24),
];
const BLOCK2: [Layer; 2] = [
    layer("block2.0", Kind::Conv, 24, 24),
    layer("block2.1", Kind::Conv, 24, 24),
];
const BLOCK3: [Layer; 3] = [
    layer("block3.0", Kind::Down, 24, 64),
    layer("block3.1", Kind::Conv, 64, 64),
    layer("block3.2", Kind::Point, 64, 64),
];
const BLOCK4: [Layer; 3] = [
    layer("block4.0", Kind::Down, 64, 64),
    layer("block4.1", Kind::Conv, 64, 64),
    layer("block4.2", Kind::Conv, 64, 64),
];
const BLOCK5: [Layer; 4] = [
    layer("block5.0", Kind::Down, 64, 128),
    layer("block5.1", Kind::Conv, 128, 128),
    layer("block5.2", Kind::Conv, 128, 128),
    layer("block5.3", Kind::Point, 128, 64),
];
const FUSION: [Layer; 3] = [
    layer("fusion.0", Kind::Conv, 64, 64),
    layer("fusion.1", Kind::Conv, 64, 64),
    last("fusion.2", 64, 64),
];
const RELIABILITY: [Layer; 3] = [
    layer("reliability.0", Kind::Point, 64, 64),
    layer("reliability.1", Kind::Point, 64, 64),
    last("reliability.2", 64, 1),
];
const KEYPOINT: [Layer; 4] = [
    layer("keypoint.0", Kind::Point, 64, 64),
    layer("keypoint.1", Kind::Point, 64, 64),
    layer("keypoint.2", Kind::Point, 64, 64),
    last("keypoint.3", 64, 65),
];

pub(super) fn tensors() -> Vec<TensorSpec> {
    let mut specs = Specs::default();
    let all = [
        &[SKIP][..],
        &BLOCK1,
        &BLOCK2,
        &BLOCK3,
        &BLOCK4,
        &BLOCK5,
        &FUSION,
        &RELIABILITY,
        &KEYPOINT,
    ];
    for layer in all.into_iter().flatten() {
        match layer.kind {
            Kind::Conv | Kind::Down => {
                specs.add(format!("{}.w", layer.name), &[layer.out, layer.input, 3, 3]);
                specs.add(format!("{}.b", layer.name), &[layer.out]);
            }
            Kind::Point => specs.linear(layer.name, layer.out, layer.input),
        }
    }
    specs.0
}

fn run(g: &mut GraphBuilder, x: Tensor, layers: &[Layer], residual: Option<Tensor>) -> Tensor {
    layers.iter().enumerate().fold(x, |x, (i, layer)| {
        let mut dense = Dense::new(layer.name, layer.out).activation(if layer.relu {
            Activation::Relu
        } else {
            Activation::None
        });
        if let (Some(residual), true) = (residual, i + 1 == layers.len()) {
            dense = dense.residual(residual);
        }
        match layer.kind {
            Kind::Conv => g.conv3x3(x, dense),
            Kind::Down => g.conv3x3(x, dense.stride(2)),
            Kind::Point => g.linear(x, dense),
        }
    })
}

pub(super) fn graph(width: usize, height: usize, diagnostics: bool) -> Result<Graph, ModelError> {
    let (w, h) = (width / MULTIPLE * MULTIPLE, height / MULTIPLE * MULTIPLE);
    let mut g = GraphBuilder::new("xfeat");
    let gray = g.input_grid(ports::GRAY, height, width, 1);
    let sized = if (w, h) == (width, height) {
        gray
    } else {
        g.resize(gray, h, w)
    };
    let x = g.instance_norm(sized, INSTANCE_EPS);

    let x1 = run(&mut g, x, &BLOCK1, None);
    let small = g.avg_pool(x, 4);
    let skip = run(&mut g, small, &[SKIP], Some(x1));
    let x2 = run(&mut g, skip, &BLOCK2, None);
    let x3 = run(&mut g, x2, &BLOCK3, None);
    let x4 = run(&mut g, x3, &BLOCK4, None);
    let x5 = run(&mut g, x4, &BLOCK5, None);
    let sum = g.resize_add(x4, x3);
    let sum = g.resize_add(x5, sum);
    let features = run(&mut g, sum, &FUSION, None);
    let reliability = run(&mut g, features, &RELIABILITY, None);
    let reliability = g.activate(reliability, Activation::Sigmoid);
    let unit = g.l2_norm(features, 1e-12);

    let cells = g.unfold(x, CELL);
    let logits = run(&mut g, cells, &KEYPOINT, None);
    let heat = g.detector_heat(logits, CELL);

    g.output(ports::FEATURES, unit);
    g.output(ports::HEAT, heat);
    g.output(ports::RELIABILITY, reliability);
    if diagnostics {
        g.output("raw_features", features);
        g.output("keypoint_logits", logits);
    }
    Ok(g.finish()?)
}
