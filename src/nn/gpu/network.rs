//! A network as kernel calls and sizes of buffers: everything that can be known without a device.

use super::{
    error::GpuError,
    fuse::fuse,
    lower::{Dispatch, Lowering},
    select::{GpuSelect, Selected},
    storage::{PackedWeights, WeightStorage},
};
use crate::nn::{Graph, Tensor, Weights, plan::Plan};

/// What a run costs at full capacity, from the plan: no device is needed to know it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GpuCost {
    /// Kernel calls.
    pub dispatches: usize,
    /// Bytes of activations that the kernels read and write (each tensor once per operation).
    pub bytes_moved: u64,
    /// Bytes of weights that they read (each weight once per operation).
    pub weight_bytes_read: u64,
    /// Bytes copied between networks, and from and to the host.
    pub bytes_copied: u64,
    /// Multiply-adds.
    pub macs: u64,
    /// Bytes of the activation arena.
    pub arena_bytes: u64,
    /// Bytes of the weights.
    pub weight_bytes: u64,
}

impl core::iter::Sum for GpuCost {
    fn sum<I: Iterator<Item = Self>>(costs: I) -> Self {
        costs.fold(Self::default(), |a, b| Self {
            dispatches: a.dispatches + b.dispatches,
            bytes_moved: a.bytes_moved + b.bytes_moved,
            weight_bytes_read: a.weight_bytes_read + b.weight_bytes_read,
            bytes_copied: a.bytes_copied + b.bytes_copied,
            macs: a.macs + b.macs,
            arena_bytes: a.arena_bytes + b.arena_bytes,
            weight_bytes: a.weight_bytes + b.weight_bytes,
        })
    }
}

/// A network ready to be loaded.
#[derive(Debug)]
pub(super) struct LoweredNetwork {
    pub(super) graph: Graph,
    pub(super) dispatches: Vec<Dispatch>,
    pub(super) weights: PackedWeights,
    pub(super) selected: Selected,
    plan: Plan,
    bytes_moved: u64,
    weight_bytes_read: u64,
}

impl LoweredNetwork {
    /// Lowers a graph, with a keypoint selection behind it if there is one.
    ///
    /// # Errors
    /// [`GpuError::Network`] for weights that do not fit, [`GpuError::TooLarge`], [`GpuError::Unsupported`].
    pub(super) fn new(
        graph: Graph,
        weights: Weights,
        storage: WeightStorage,
        select: Option<&GpuSelect>,
    ) -> Result<Self, GpuError> {
        let weights = PackedWeights::new(&graph, weights, storage)?;
        let (units, planned) = fuse(&graph);
        let plan = Plan::new(&planned);
        let lowering = Lowering {
            graph: &graph,
            plan: &plan,
            places: &weights.places,
        };
        let mut dispatches = Vec::new();
        for unit in &units {
            dispatches.extend(lowering.lower(unit)?);
        }
        let selected = match select {
            Some(select) => {
                let (more, selected) = select.lower(&graph, &plan)?;
                dispatches.extend(more);
                selected
            }
            None => Selected {
                arena_len: plan.arena_len,
                num_counts: graph.counts().len(),
                ..Selected::default()
            },
        };
        let capacities = graph.capacities();
        let of_nodes = planned.nodes().iter();
        let bytes_moved = of_nodes
            .map(|node| graph.node_bytes(node, &capacities))
            .sum::<u64>()
            + selected.bytes_moved;
        let weight_bytes_read = graph
            .nodes()
            .iter()
            .flat_map(|node| node.op.weights())
            .map(|id| weights.places[id.0].bytes as u64)
            .sum();
        let lowered = Self {
            graph,
            dispatches,
            weights,
            selected,
            plan,
            bytes_moved,
            weight_bytes_read,
        };
        lowered.check_size()?;
        Ok(lowered)
    }

    fn check_size(&self) -> Result<(), GpuError> {
        let limit = super::device::needed_limits().max_storage_buffer_binding_size;
        let sizes = [
            ("activations", self.arena_bytes()),
            ("weights", self.weights.bytes()),
        ];
        match sizes.into_iter().find(|(_, needed)| *needed > limit) {
            Some((what, needed)) => Err(GpuError::TooLarge {
                network: self.graph.name().to_owned(),
                what,
                needed,
                limit,
            }),
            None => Ok(()),
        }
    }

    /// Bytes of the activation arena.
    pub(super) fn arena_bytes(&self) -> u64 {
        4 * self.selected.arena_len as u64
    }

    /// Numbers of a tensor at full capacity.
    pub(super) fn most_numbers(&self, tensor: &Tensor) -> usize {
        tensor.rows.at(&self.graph.capacities()) * tensor.channels
    }

    /// First byte of a tensor in the arena.
    pub(super) fn byte_offset(&self, tensor: &Tensor) -> u64 {
        4 * (self.plan.offsets[tensor.value.0] + tensor.offset) as u64
    }

    /// Bytes of all outputs at full capacity, and of the counts that say how much of them is filled.
    pub(super) fn output_bytes(&self) -> u64 {
        let outputs = self.graph.outputs().iter();
        let numbers = outputs.map(|port| self.most_numbers(&port.tensor));
        4 * (self.graph.counts().len() + numbers.sum::<usize>()) as u64
    }

    /// What a run costs at full capacity.
    pub(super) fn cost(&self) -> GpuCost {
        GpuCost {
            dispatches: self.dispatches.len(),
            bytes_moved: self.bytes_moved,
            weight_bytes_read: self.weight_bytes_read,
            bytes_copied: 0,
            macs: self.graph.macs(&self.graph.capacities()),
            arena_bytes: self.arena_bytes(),
            weight_bytes: self.weights.bytes(),
        }
    }
}
