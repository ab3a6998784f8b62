//! What is settled before the first run: how each convolution is computed, packed weights, working room.

use super::kernels::{attention, conv3x3, gemm::Packed, soft_choice, winograd};
use crate::nn::{
    graph::{Graph, Node},
    op::Op,
    shape::{Grid, Tensor},
};
use crate::simd::Level;

pub(super) fn grid_of(tensor: &Tensor) -> Grid {
    tensor.grid.unwrap_or(Grid {
        height: 0,
        width: 0,
    })
}

/// Packs a layer's matrix, one per group.
pub(super) fn pack(
    level: Level,
    shape: &[usize],
    numbers: &[f32],
    bias: Option<&[f32]>,
    groups: usize,
    to: &mut Vec<Packed>,
) {
    let out = shape[0] / groups;
    let inner = shape[1];
    for group in 0..groups {
        let bias = bias.map(|bias| &bias[group * out..][..out]);
        let numbers = &numbers[group * out * inner * if shape.len() == 4 { 9 } else { 1 }..];
        to.push(if shape.len() == 4 {
            // `[out, in, 3, 3]`
            Packed::new(level, 9 * inner, out, bias, |k, n| {
                numbers[conv3x3::weight_index(inner, k, n)]
            })
        } else {
            Packed::new(level, inner, out, bias, |k, n| numbers[n * inner + k])
        });
    }
}

/// Last operation that needs each weight.
pub(super) fn last_weight_uses(graph: &Graph) -> Vec<usize> {
    let mut last = vec![0; graph.weights().len()];
    for (step, node) in graph.nodes().iter().enumerate() {
        for id in node.op.weights() {
            last[id.0] = step;
        }
    }
    last
}

/// Whether an operation is a convolution that is computed patch by patch.
pub(super) fn is_winograd(level: Level, node: &Node) -> bool {
    let (input, out) = (&node.inputs[0], &node.outputs[0]);
    let Grid { height, width } = grid_of(out);
    matches!(node.op, Op::Conv3x3 { stride: 1, .. })
        && winograd::fits(level, input.channels, out.channels, height * width)
}

/// Numbers of working room that an operation needs at full capacity.
pub(super) fn scratch_len(level: Level, graph: &Graph, node: &Node, capacities: &[usize]) -> usize {
    match &node.op {
        Op::Conv3x3 { .. } if is_winograd(level, node) => {
            winograd::scratch_len(node.inputs[0].channels, node.outputs[0].channels)
        }
        Op::Conv3x3 { .. } => {
            conv3x3::band_len(grid_of(&node.inputs[0]).width, node.inputs[0].channels)
        }
        Op::Attention { heads, .. } => attention::scratch_len(
            node.inputs[0].rows.at(capacities),
            node.inputs[1].channels / heads,
            node.inputs[2].channels / heads,
        ),
        Op::TokenPool { tokens, .. } => *tokens,
        Op::SoftChoice { keys, .. } => soft_choice::scratch_len(graph.weight(*keys).shape[0]),
        Op::DetectorHeat { block } => block * block + 1,
        Op::Linear { .. }
        | Op::Activate { .. }
        | Op::Add { .. }
        | Op::Resize
        | Op::AvgPool { .. }
        | Op::MaxPool { .. }
        | Op::InstanceNorm { .. }
        | Op::Unfold { .. }
        | Op::LayerNorm { .. }
        | Op::L2Norm { .. }
        | Op::Sample { .. }
        | Op::Keep { .. } => 0,
    }
}
