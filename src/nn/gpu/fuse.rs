//! Runs of operations that one kernel computes: SuperPoint's first two convolutions with the pool behind them.

use crate::nn::{Activation, Graph, Node, Op, ValueId, shape::WeightId};

/// Most output channels that `wgsl/stem.wgsl` keeps in registers.
const MAX_COLUMNS: usize = 64;

/// One of the stem's convolutions: weight, bias, and the optional scale and shift behind the activation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StemLayer {
    pub(super) weight: WeightId,
    pub(super) bias: WeightId,
    pub(super) post: Option<(WeightId, WeightId)>,
}

/// What is lowered as one.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Unit {
    /// An operation of the graph.
    One(Node),
    /// Conv, conv and pool on a grey picture. `node` reads the picture and writes the pooled map.
    Stem {
        node: Node,
        layers: [StemLayer; 2],
        hidden_channels: usize,
    },
}

impl Unit {
    /// Reads and writes of the unit as one operation.
    pub(super) fn node(&self) -> &Node {
        match self {
            Self::One(node) | Self::Stem { node, .. } => node,
        }
    }
}

/// The graph's operations with stems found, and the graph that the memory plan needs: without what stays inside a kernel.
pub(super) fn fuse(graph: &Graph) -> (Vec<Unit>, Graph) {
    let mut units = Vec::new();
    let mut planned = graph.clone();
    let mut rest = graph.nodes();
    while let Some(first) = rest.first() {
        let (unit, length) = match stem(graph, rest) {
            Some((unit, length)) => {
                for node in &rest[..length - 1] {
                    planned.value_sizes[node.outputs[0].value.0] = 0;
                }
                (unit, length)
            }
            None => (Unit::One(first.clone()), 1),
        };
        units.push(unit);
        rest = &rest[length..];
    }
    planned.nodes = units.iter().map(|unit| unit.node().clone()).collect();
    (units, planned)
}

fn times_read(graph: &Graph, value: ValueId) -> usize {
    let by_nodes = graph
        .nodes()
        .iter()
        .flat_map(|node| &node.inputs)
        .filter(|tensor| tensor.value == value)
        .count();
    by_nodes
        + graph
            .outputs()
            .iter()
            .filter(|port| port.tensor.value == value)
            .count()
}

/// A convolution with ReLU at the start of `nodes`, with the per-channel layer behind it, and how many operations that is.
fn stem_layer(graph: &Graph, nodes: &[Node]) -> Option<(StemLayer, usize)> {
    let node = nodes.first()?;
    let Op::Conv3x3 {
        weight,
        bias: Some(bias),
        stride: 1,
        activation: Activation::Relu,
    } = node.op
    else {
        return None;
    };
    let y = node.outputs[0];
    if node.inputs.len() != 1 || times_read(graph, y.value) != 1 {
        return None;
    }
    let mut layer = StemLayer {
        weight,
        bias,
        post: None,
    };
    if let Some(next) = nodes.get(1)
        && let Op::Linear {
            weight,
            bias: Some(bias),
            groups,
            activation: Activation::None,
        } = next.op
        && groups == y.channels
        && next.inputs[..] == [y]
        && times_read(graph, next.outputs[0].value) == 1
    {
        layer.post = Some((weight, bias));
        return Some((layer, 2));
    }
    Some((layer, 1))
}

fn stem(graph: &Graph, nodes: &[Node]) -> Option<(Unit, usize)> {
    let (a, length_a) = stem_layer(graph, nodes)?;
    let (b, length_b) = stem_layer(graph, &nodes[length_a..])?;
    let length = length_a + length_b;
    let pool = nodes.get(length)?;
    let (first, second) = (&nodes[0], &nodes[length_a]);
    let (hidden, out) = (second.inputs[0].channels, second.outputs[0].channels);
    let fits = matches!(
        pool.op,
        Op::MaxPool {
            size: 2,
            stride: 2,
            pad: 0
        }
    ) && first.inputs[0].channels == 1
        && hidden % 16 == 0
        && out % 4 == 0
        && out <= MAX_COLUMNS
        && second.inputs[0] == nodes[length_a - 1].outputs[0]
        && pool.inputs[..] == nodes[length - 1].outputs[..1];
    fits.then(|| {
        let node = Node {
            inputs: first.inputs.clone(),
            label: "stem".to_owned(),
            ..pool.clone()
        };
        (
            Unit::Stem {
                node,
                layers: [a, b],
                hidden_channels: hidden,
            },
            length + 1,
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Dense, GraphBuilder, plan::Plan};

    fn network(read_twice: bool) -> Graph {
        let mut g = GraphBuilder::new("stem");
        let x = g.input_grid("x", 64, 64, 1);
        let a = g.conv3x3(x, Dense::new("a", 64).activation(Activation::Relu));
        let b = g.conv3x3(a, Dense::new("b", 64).activation(Activation::Relu));
        let b = g.linear(b, Dense::new("b.post", 64).groups(64));
        let y = g.max_pool(b, 2, 2, 0);
        g.output("y", y);
        if read_twice {
            g.output("b", b);
        }
        g.finish().expect("a valid graph")
    }

    #[test]
    fn the_stem_of_superpoint_needs_no_room_inside() {
        let graph = network(false);
        let (units, planned) = fuse(&graph);
        assert_eq!(units.len(), 1);
        assert!(
            matches!(&units[0], Unit::Stem { layers: [a, b], .. } if a.post.is_none() && b.post.is_some())
        );
        assert_eq!(Plan::new(&planned).arena_len, 64 * 64 + 32 * 32 * 64);
    }

    #[test]
    fn what_is_read_elsewhere_is_not_fused() {
        assert_eq!(fuse(&network(true)).0.len(), 4);
    }
}
