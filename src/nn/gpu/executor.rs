//! A graph on the device: buffers, bind group and pipelines made at load, then only uploads, dispatches and one readback.

use std::sync::Arc;

use super::{
    device::GpuDevice,
    error::GpuError,
    fuse::fuse,
    lower::{Dispatch, Lowering},
    pipelines::{PARAMS_STRIDE, Pipelines},
    readback::{Timer, read_mapped},
    select::{GpuSelect, Selected},
};
use crate::nn::{
    Graph, NnError, Op, Weights,
    plan::Plan,
    shape::{CountId, Tensor},
};

/// A kernel call that is ready to be encoded.
struct Step {
    pipeline: Arc<wgpu::ComputePipeline>,
    params_offset: u32,
    groups: [u32; 3],
}

/// What a run costs at full capacity, from the plan: no device is needed to know it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GpuCost {
    /// Kernel calls.
    pub dispatches: usize,
    /// Bytes of activations that the kernels read and write (each tensor once per operation).
    pub bytes_moved: u64,
    /// Multiply-adds.
    pub macs: u64,
    /// Bytes of the activation arena.
    pub arena_bytes: u64,
    /// Bytes of the weights.
    pub weight_bytes: u64,
}

/// A network on the device.
///
/// Counts and inputs are written, [`Self::encode`] records the work, [`Self::read`] waits for outputs. Nothing is
/// allocated on the device after [`Self::new`].
pub struct GpuNetwork {
    gpu: Arc<GpuDevice>,
    graph: Graph,
    plan: Plan,
    arena: wgpu::Buffer,
    counts: wgpu::Buffer,
    staging: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
    steps: Vec<Step>,
    bytes_moved: u64,
    selected: Selected,
    host_counts: Vec<u32>,
    weight_bytes: u64,
}

impl core::fmt::Debug for GpuNetwork {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("GpuNetwork")
            .field("graph", &self.graph.name())
            .finish_non_exhaustive()
    }
}

/// Weights of a convolution from `[out, in, 3, 3]` to `[out, 3 * 3, in]`: the order in which the kernels walk them.
fn tap_major(weight: &[f32], in_channels: usize) -> Vec<f32> {
    let mut packed = Vec::with_capacity(weight.len());
    for of_output in weight.chunks_exact(9 * in_channels) {
        for tap in 0..9 {
            packed.extend((0..in_channels).map(|channel| of_output[channel * 9 + tap]));
        }
    }
    packed
}

/// All weights in one run of numbers, and where each starts.
fn pack(graph: &Graph, mut weights: Weights) -> Result<(Vec<f32>, Vec<usize>), NnError> {
    let mut is_conv = vec![false; graph.weights().len()];
    for node in graph.nodes() {
        if let Op::Conv3x3 { weight, .. } = node.op {
            is_conv[weight.0] = true;
        }
    }
    let mut packed = Vec::with_capacity(graph.num_parameters());
    let mut offsets = Vec::with_capacity(is_conv.len());
    for (spec, is_conv) in graph.weights().iter().zip(is_conv) {
        offsets.push(packed.len());
        let weight = weights.take_f32(&spec.name, &spec.shape)?;
        if is_conv {
            packed.extend(tap_major(&weight, spec.shape[1]));
        } else {
            packed.extend(weight);
        }
    }
    Ok((packed, offsets))
}

impl GpuNetwork {
    /// Uploads the weights and makes everything that a run needs.
    ///
    /// # Errors
    /// [`GpuError::Network`] for weights that do not fit, [`GpuError::TooLarge`], [`GpuError::Unsupported`],
    /// [`GpuError::Refused`].
    pub fn new(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        graph: Graph,
        weights: Weights,
    ) -> Result<Self, GpuError> {
        Self::with_selection(gpu, pipelines, graph, weights, None)
    }

    /// The same with a keypoint selection behind the network.
    pub(super) fn with_selection(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        graph: Graph,
        weights: Weights,
        select: Option<&GpuSelect>,
    ) -> Result<Self, GpuError> {
        use wgpu::BufferUsages as Usage;
        gpu.check()?;
        let (packed, weight_offsets) = pack(&graph, weights)?;
        let (units, planned) = fuse(&graph);
        let plan = Plan::new(&planned);
        let lowering = Lowering {
            graph: &graph,
            plan: &plan,
            weight_offsets: &weight_offsets,
        };
        let mut dispatches: Vec<Dispatch> = Vec::new();
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
        let arena_bytes = 4 * selected.arena_len as u64;
        let weight_bytes = 4 * packed.len() as u64;
        let limit = super::device::needed_limits().max_storage_buffer_binding_size;
        for (what, needed) in [("activations", arena_bytes), ("weights", weight_bytes)] {
            if needed > limit {
                return Err(GpuError::TooLarge {
                    network: graph.name().to_owned(),
                    what,
                    needed,
                    limit,
                });
            }
        }
        let label = |what: &str| format!("{} {what}", graph.name());
        let arena = gpu.buffer(
            &label("activations"),
            arena_bytes,
            Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST,
        );
        let weight_buffer = gpu.buffer(
            &label("weights"),
            weight_bytes,
            Usage::STORAGE | Usage::COPY_DST,
        );
        gpu.queue
            .write_buffer(&weight_buffer, 0, bytemuck::cast_slice(&packed));
        let host_counts: Vec<u32> = graph.capacities().into_iter().map(|n| n as u32).collect();
        let counts = gpu.buffer(
            &label("counts"),
            4 * selected.num_counts as u64,
            Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST,
        );
        gpu.queue
            .write_buffer(&counts, 0, bytemuck::cast_slice(&host_counts));
        let mut blocks = vec![0_u32; dispatches.len().max(1) * PARAMS_STRIDE / 4];
        for (block, dispatch) in blocks.chunks_exact_mut(PARAMS_STRIDE / 4).zip(&dispatches) {
            block[..dispatch.params.words().len()].copy_from_slice(dispatch.params.words());
        }
        let params = gpu.buffer(
            &label("parameters"),
            4 * blocks.len() as u64,
            Usage::UNIFORM | Usage::COPY_DST,
        );
        gpu.queue
            .write_buffer(&params, 0, bytemuck::cast_slice(&blocks));
        let outputs: u64 = graph
            .outputs()
            .iter()
            .map(|port| 4 * Self::most_numbers(&graph, &port.tensor) as u64)
            .sum();
        let staging = gpu.buffer(
            &label("staging"),
            outputs + 4 * host_counts.len() as u64,
            Usage::MAP_READ | Usage::COPY_DST,
        );
        gpu.count_created();
        let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(graph.name()),
            layout: &pipelines.layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &params,
                        offset: 0,
                        size: core::num::NonZeroU64::new(PARAMS_STRIDE as u64),
                    }),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: arena.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: weight_buffer.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 3,
                    resource: counts.as_entire_binding(),
                },
            ],
        });
        let mut steps = Vec::with_capacity(dispatches.len());
        for (index, dispatch) in dispatches.iter().enumerate() {
            steps.push(Step {
                pipeline: pipelines.get(
                    gpu,
                    dispatch.kernel,
                    &dispatch.constants,
                    &dispatch.params,
                )?,
                params_offset: (index * PARAMS_STRIDE) as u32,
                groups: dispatch.groups.map(|n| n as u32),
            });
        }
        let capacities = graph.capacities();
        let bytes_moved = planned
            .nodes()
            .iter()
            .map(|node| graph.node_bytes(node, &capacities))
            .sum();
        gpu.check()?;
        Ok(Self {
            gpu: Arc::clone(gpu),
            graph,
            plan,
            arena,
            counts,
            staging,
            bind_group,
            steps,
            bytes_moved,
            selected,
            host_counts,
            weight_bytes,
        })
    }

    fn most_numbers(graph: &Graph, tensor: &Tensor) -> usize {
        tensor.rows.at(&graph.capacities()) * tensor.channels
    }

    /// The graph that is run.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// The device that it runs on.
    pub fn device(&self) -> &Arc<GpuDevice> {
        &self.gpu
    }

    /// What a run costs at full capacity.
    pub fn cost(&self) -> GpuCost {
        let capacities = self.graph.capacities();
        GpuCost {
            dispatches: self.steps.len(),
            bytes_moved: self.bytes_moved,
            macs: self.graph.macs(&capacities),
            arena_bytes: 4 * self.selected.arena_len as u64,
            weight_bytes: self.weight_bytes,
        }
    }

    /// Sets a run-time number of rows.
    ///
    /// # Errors
    /// [`NnError::UnknownName`], [`NnError::CountTooLarge`], [`NnError::CountIsDerived`].
    pub fn set_count(&mut self, name: &str, count: usize) -> Result<(), GpuError> {
        let mut counts: Vec<usize> = self.host_counts.iter().map(|&n| n as usize).collect();
        self.graph.set_count(&mut counts, name, count)?;
        let CountId(id) = self.graph.count(name)?;
        self.host_counts[id] = counts[id] as u32;
        self.gpu.queue.write_buffer(
            &self.counts,
            4 * id as u64,
            bytemuck::bytes_of(&self.host_counts[id]),
        );
        Ok(())
    }

    /// Uploads an input: rows times channels numbers at the current count, row-major.
    ///
    /// # Errors
    /// [`NnError::UnknownName`]; [`GpuError::Unsupported`] when there are more numbers than room.
    pub fn write_input(&self, name: &str, data: &[f32]) -> Result<(), GpuError> {
        let tensor = self.graph.input(name)?;
        let room = Self::most_numbers(&self.graph, &tensor);
        if data.len() > room {
            return Err(GpuError::Unsupported {
                network: self.graph.name().to_owned(),
                op: "input",
                problem: format!("`{name}` got {} numbers, room is for {room}", data.len()),
            });
        }
        self.gpu.queue.write_buffer(
            &self.arena,
            self.byte_offset(&tensor),
            bytemuck::cast_slice(data),
        );
        Ok(())
    }

    fn byte_offset(&self, tensor: &Tensor) -> u64 {
        4 * (self.plan.offsets[tensor.value.0] + tensor.offset) as u64
    }

    /// Records the kernel calls of one run.
    pub fn encode(&self, encoder: &mut wgpu::CommandEncoder) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.graph.name()),
            timestamp_writes: None,
        });
        for step in &self.steps {
            pass.set_pipeline(&step.pipeline);
            pass.set_bind_group(0, &self.bind_group, &[step.params_offset]);
            let [x, y, z] = step.groups;
            pass.dispatch_workgroups(x, y, z);
        }
    }

    /// Where a named tensor lies in the arena, for copies between networks: buffer, byte offset, bytes at full capacity.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    pub(super) fn place_of(&self, tensor: &Tensor) -> (&wgpu::Buffer, u64, u64) {
        (
            &self.arena,
            self.byte_offset(tensor),
            4 * Self::most_numbers(&self.graph, tensor) as u64,
        )
    }

    /// Where the selection behind this network leaves its results.
    pub(super) fn selected(&self) -> Selected {
        self.selected
    }

    /// The arena.
    pub(super) fn arena(&self) -> &wgpu::Buffer {
        &self.arena
    }

    /// The buffer of run-time numbers of rows.
    pub(super) fn counts_buffer(&self) -> &wgpu::Buffer {
        &self.counts
    }

    /// Runs once and reads every output: the simple form, for tests and for networks used alone.
    ///
    /// # Errors
    /// Any [`GpuError`] of the device.
    pub async fn run(
        &mut self,
        timer: Option<&Timer>,
    ) -> Result<Vec<(String, Vec<f32>)>, GpuError> {
        self.gpu.check()?;
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.encode(&mut encoder);
        let counts_bytes = 4 * self.host_counts.len() as u64;
        encoder.copy_buffer_to_buffer(&self.counts, 0, &self.staging, 0, counts_bytes);
        let mut bytes = counts_bytes;
        for port in self.graph.outputs() {
            let (buffer, offset, length) = self.place_of(&port.tensor);
            encoder.copy_buffer_to_buffer(buffer, offset, &self.staging, bytes, length);
            bytes += length;
        }
        self.gpu.queue.submit([encoder.finish()]);
        let graph = &self.graph;
        let num_counts = self.host_counts.len();
        read_mapped(&self.gpu, &self.staging, bytes, timer, |view| {
            let words: &[u32] = bytemuck::cast_slice(view);
            let (counts, mut rest) = words.split_at(num_counts);
            let counts: Vec<usize> = counts.iter().map(|&n| n as usize).collect();
            let mut outputs = Vec::new();
            for port in graph.outputs() {
                let (all, tail) = rest.split_at(Self::most_numbers(graph, &port.tensor));
                rest = tail;
                let filled = port.tensor.rows.at(&counts) * port.tensor.channels;
                let data = all[..filled]
                    .iter()
                    .map(|&word| f32::from_bits(word))
                    .collect();
                outputs.push((port.name.clone(), data));
            }
            outputs
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn convolution_weights_are_packed_tap_by_tap() {
        let weight: Vec<f32> = (0..18).map(|n| n as f32).collect();
        let packed = tap_major(&weight, 2);
        assert_eq!(packed[..6], [0.0, 9.0, 1.0, 10.0, 2.0, 11.0]);
    }
}
