//! A network as data: inputs, operations in order, outputs, and the weights they name.

use super::{
    error::NnError,
    op::Op,
    shape::{CountId, Tensor, WeightId},
};

/// One operation with what it reads and writes.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// What is done.
    pub op: Op,
    /// What is read, in the order that the operation's documentation gives.
    pub inputs: Vec<Tensor>,
    /// What is written; always whole values.
    pub outputs: Vec<Tensor>,
    /// For listings: the weight's name or the operation's.
    pub label: String,
}

/// A named tensor at the edge of a graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// The name.
    pub name: String,
    /// The tensor.
    pub tensor: Tensor,
}

/// A run-time number of rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Count {
    /// The name.
    pub name: String,
    /// Most there can be.
    pub capacity: usize,
    /// Whether the network computes it (by [`Op::Keep`]) instead of the caller setting it.
    pub derived: bool,
}

/// A weight that a graph needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WeightSpec {
    /// The name in the file.
    pub name: String,
    /// The sizes of its axes.
    pub shape: Vec<usize>,
}

/// A network. Made by [`super::GraphBuilder`], which checks every operation; a graph that exists is valid.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph {
    pub(super) name: String,
    pub(super) counts: Vec<Count>,
    pub(super) weights: Vec<WeightSpec>,
    /// Numbers of each value at full capacity: what an executor has to make room for.
    pub(super) value_sizes: Vec<usize>,
    pub(super) inputs: Vec<Port>,
    pub(super) nodes: Vec<Node>,
    pub(super) outputs: Vec<Port>,
}

impl Graph {
    /// Name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Run-time numbers of rows; a [`CountId`] is a position here.
    pub fn counts(&self) -> &[Count] {
        &self.counts
    }

    /// Weights that the graph needs; a [`WeightId`] is a position here.
    pub fn weights(&self) -> &[WeightSpec] {
        &self.weights
    }

    /// A weight's name and shape.
    pub fn weight(&self, id: WeightId) -> &WeightSpec {
        &self.weights[id.0]
    }

    /// Numbers of each value at full capacity; a [`ValueId`] is a position here.
    pub fn value_sizes(&self) -> &[usize] {
        &self.value_sizes
    }

    /// Inputs.
    pub fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    /// Operations in the order in which they run.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Outputs.
    pub fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    /// The capacities of all counts.
    pub fn capacities(&self) -> Vec<usize> {
        self.counts.iter().map(|count| count.capacity).collect()
    }

    /// Numbers in all weights.
    pub fn num_parameters(&self) -> usize {
        self.weights
            .iter()
            .map(|spec| spec.shape.iter().product::<usize>())
            .sum()
    }

    /// Multiply-adds of a run with these counts (products only: convolutions, linear layers, attention, similarities).
    pub fn macs(&self, counts: &[usize]) -> u64 {
        self.nodes
            .iter()
            .map(|node| self.node_macs(node, counts))
            .sum()
    }

    /// Multiply-adds of one operation.
    pub fn node_macs(&self, node: &Node, counts: &[usize]) -> u64 {
        let rows = |index: usize| node.inputs[index].rows.at(counts) as u64;
        let size = |id: WeightId| self.weight(id).shape.iter().product::<usize>() as u64;
        match &node.op {
            Op::Conv3x3 { weight, .. } | Op::Linear { weight, .. } => {
                node.outputs[0].rows.at(counts) as u64 * size(*weight)
            }
            Op::Attention { .. } => {
                rows(0) * rows(1) * (node.inputs[1].channels + node.inputs[2].channels) as u64
            }
            Op::TokenPool { .. } => 2 * rows(1) * node.inputs[0].channels as u64,
            Op::SoftChoice { keys, values, .. } => rows(0) * (size(*keys) + size(*values)),
            Op::Activate { .. }
            | Op::Add { .. }
            | Op::Resize
            | Op::AvgPool { .. }
            | Op::MaxPool { .. }
            | Op::InstanceNorm { .. }
            | Op::Unfold { .. }
            | Op::DetectorHeat { .. }
            | Op::LayerNorm { .. }
            | Op::L2Norm { .. }
            | Op::Sample { .. }
            | Op::Keep { .. } => 0,
        }
    }

    /// Bytes that one operation reads and writes in activations at these counts.
    pub fn node_bytes(&self, node: &Node, counts: &[usize]) -> u64 {
        node.inputs
            .iter()
            .chain(&node.outputs)
            .map(|tensor| (tensor.rows.at(counts) * tensor.channels * size_of::<f32>()) as u64)
            .sum()
    }

    /// The input of this name.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    pub fn input(&self, name: &str) -> Result<Tensor, NnError> {
        self.port(&self.inputs, "input", name)
    }

    /// The output of this name.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    pub fn output(&self, name: &str) -> Result<Tensor, NnError> {
        self.port(&self.outputs, "output", name)
    }

    /// The count of this name.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    pub fn count(&self, name: &str) -> Result<CountId, NnError> {
        let position = self.counts.iter().position(|count| count.name == name);
        position
            .map(CountId)
            .ok_or_else(|| self.unknown("count", name))
    }

    /// Checks and applies a new number of rows; shared by the executors.
    pub(super) fn set_count(
        &self,
        counts: &mut [usize],
        name: &str,
        value: usize,
    ) -> Result<(), NnError> {
        let CountId(id) = self.count(name)?;
        let count = &self.counts[id];
        if count.derived {
            return Err(NnError::CountIsDerived {
                graph: self.name.clone(),
                name: name.to_owned(),
            });
        }
        if value > count.capacity {
            return Err(NnError::CountTooLarge {
                graph: self.name.clone(),
                name: name.to_owned(),
                count: value,
                capacity: count.capacity,
            });
        }
        counts[id] = value;
        Ok(())
    }

    /// Last operation that reads or writes each value; outputs of the graph get the number of operations.
    pub(super) fn last_uses(&self) -> Vec<usize> {
        let mut last = vec![0; self.value_sizes.len()];
        for (step, node) in self.nodes.iter().enumerate() {
            for tensor in node.inputs.iter().chain(&node.outputs) {
                last[tensor.value.0] = step;
            }
        }
        for output in &self.outputs {
            last[output.tensor.value.0] = self.nodes.len();
        }
        last
    }

    fn port(&self, ports: &[Port], kind: &'static str, name: &str) -> Result<Tensor, NnError> {
        let port = ports.iter().find(|port| port.name == name);
        port.map(|port| port.tensor)
            .ok_or_else(|| self.unknown(kind, name))
    }

    fn unknown(&self, kind: &'static str, name: &str) -> NnError {
        NnError::UnknownName {
            graph: self.name.clone(),
            kind,
            name: name.to_owned(),
        }
    }
}
