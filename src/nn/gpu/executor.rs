//! A graph on the device: buffers, bind group and pipelines made at load, then only uploads, dispatches and one readback.

use std::sync::Arc;

use super::{
    device::GpuDevice,
    error::GpuError,
    network::{GpuCost, LoweredNetwork},
    pipelines::{PARAMS_STRIDE, Pipelines},
    readback::{Timer, read_mapped},
    storage::WeightStorage,
};
use crate::nn::{Graph, Tensor, Weights, shape::CountId};

/// A kernel call that is ready to be encoded.
struct Step {
    pipeline: Arc<wgpu::ComputePipeline>,
    params_offset: u32,
    groups: [u32; 3],
}

/// A network on the device.
///
/// Counts and inputs are written, [`Self::encode`] records the work, [`Self::run`] does both and waits for the outputs.
/// Nothing is allocated on the device after [`Self::new`].
pub struct GpuNetwork {
    gpu: Arc<GpuDevice>,
    lowered: LoweredNetwork,
    arena: wgpu::Buffer,
    counts: wgpu::Buffer,
    staging: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
    steps: Vec<Step>,
    host_counts: Vec<usize>,
    has_run: bool,
}

impl core::fmt::Debug for GpuNetwork {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("GpuNetwork")
            .field("graph", &self.lowered.graph.name())
            .finish_non_exhaustive()
    }
}

impl GpuNetwork {
    /// Uploads the weights and makes everything that a run needs.
    ///
    /// # Errors
    /// [`GpuError::Network`] for weights that do not fit, [`GpuError::TooLarge`], [`GpuError::Unsupported`],
    /// [`GpuError::Refused`].
    pub async fn new(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        graph: Graph,
        weights: Weights,
        storage: WeightStorage,
    ) -> Result<Self, GpuError> {
        let lowered = LoweredNetwork::new(graph, weights, storage, None)?;
        let what = format!("network `{}`", lowered.graph.name());
        gpu.attempt(&what, || Self::load(gpu, pipelines, lowered))
            .await
    }

    /// Makes the objects; the caller watches over them with [`GpuDevice::attempt`].
    pub(super) fn load(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        mut lowered: LoweredNetwork,
    ) -> Result<Self, GpuError> {
        use wgpu::BufferUsages as Usage;
        let label = |what: &str| format!("{} {what}", lowered.graph.name());
        let arena = gpu.buffer(
            &label("activations"),
            lowered.arena_bytes(),
            Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST,
        );
        let weights = gpu.buffer(
            &label("weights"),
            lowered.weights.bytes(),
            Usage::STORAGE | Usage::COPY_DST,
        );
        gpu.queue
            .write_buffer(&weights, 0, bytemuck::cast_slice(&lowered.weights.words));
        let host_counts = lowered.graph.capacities();
        let words: Vec<u32> = host_counts.iter().map(|&n| n as u32).collect();
        let counts = gpu.buffer(
            &label("counts"),
            4 * lowered.selected.num_counts as u64,
            Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST,
        );
        gpu.queue
            .write_buffer(&counts, 0, bytemuck::cast_slice(&words));
        let stride = PARAMS_STRIDE / 4;
        let mut blocks = vec![0_u32; lowered.dispatches.len().max(1) * stride];
        for (block, dispatch) in blocks.chunks_exact_mut(stride).zip(&lowered.dispatches) {
            block[..dispatch.params.words().len()].copy_from_slice(dispatch.params.words());
        }
        let params = gpu.buffer(
            &label("parameters"),
            4 * blocks.len() as u64,
            Usage::UNIFORM | Usage::COPY_DST,
        );
        gpu.queue
            .write_buffer(&params, 0, bytemuck::cast_slice(&blocks));
        let staging = gpu.buffer(
            &label("staging"),
            lowered.output_bytes(),
            Usage::MAP_READ | Usage::COPY_DST,
        );
        let bind_group = pipelines.bind(
            gpu,
            lowered.graph.name(),
            [&params, &arena, &weights, &counts],
        );
        let mut steps = Vec::with_capacity(lowered.dispatches.len());
        for (index, dispatch) in lowered.dispatches.iter().enumerate() {
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
        // They are on the device now.
        lowered.weights.words = Vec::new();
        Ok(Self {
            gpu: Arc::clone(gpu),
            lowered,
            arena,
            counts,
            staging,
            bind_group,
            steps,
            host_counts,
            has_run: false,
        })
    }

    /// The graph that is run.
    pub fn graph(&self) -> &Graph {
        &self.lowered.graph
    }

    /// The device that it runs on.
    pub fn device(&self) -> &Arc<GpuDevice> {
        &self.gpu
    }

    /// What a run costs at full capacity.
    pub fn cost(&self) -> GpuCost {
        self.lowered.cost()
    }

    /// What was loaded.
    pub(super) fn lowered(&self) -> &LoweredNetwork {
        &self.lowered
    }

    /// Sets a run-time number of rows.
    ///
    /// # Errors
    /// [`NnError::UnknownName`](crate::nn::NnError::UnknownName),
    /// [`NnError::CountTooLarge`](crate::nn::NnError::CountTooLarge),
    /// [`NnError::CountIsDerived`](crate::nn::NnError::CountIsDerived); nothing has reached the device then.
    pub fn set_count(&mut self, name: &str, count: usize) -> Result<(), GpuError> {
        let graph = &self.lowered.graph;
        graph.set_count(&mut self.host_counts, name, count)?;
        let CountId(id) = graph.count(name)?;
        self.gpu.queue.write_buffer(
            &self.counts,
            4 * id as u64,
            bytemuck::bytes_of(&(count as u32)),
        );
        Ok(())
    }

    /// Uploads an input: rows times channels numbers at the current count, row-major.
    ///
    /// # Errors
    /// [`NnError::UnknownName`](crate::nn::NnError::UnknownName); [`GpuError::Unsupported`] when there are more numbers than
    /// room.
    pub fn write_input(&self, name: &str, data: &[f32]) -> Result<(), GpuError> {
        let tensor = self.lowered.graph.input(name)?;
        let room = self.lowered.most_numbers(&tensor);
        if data.len() > room {
            return Err(GpuError::Unsupported {
                network: self.lowered.graph.name().to_owned(),
                op: "input",
                problem: format!("`{name}` got {} numbers, room is for {room}", data.len()),
            });
        }
        self.gpu.queue.write_buffer(
            &self.arena,
            self.lowered.byte_offset(&tensor),
            bytemuck::cast_slice(data),
        );
        Ok(())
    }

    /// Records the kernel calls of one run.
    pub(super) fn encode(&self, encoder: &mut wgpu::CommandEncoder) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.lowered.graph.name()),
            timestamp_writes: None,
        });
        for step in &self.steps {
            pass.set_pipeline(&step.pipeline);
            pass.set_bind_group(0, &self.bind_group, &[step.params_offset]);
            let [x, y, z] = step.groups;
            pass.dispatch_workgroups(x, y, z);
        }
    }

    /// Where a tensor lies: buffer, byte offset, bytes at full capacity.
    pub(super) fn place_of(&self, tensor: &Tensor) -> (&wgpu::Buffer, u64, u64) {
        (
            &self.arena,
            self.lowered.byte_offset(tensor),
            4 * self.lowered.most_numbers(tensor) as u64,
        )
    }

    /// The arena.
    pub(super) fn arena(&self) -> &wgpu::Buffer {
        &self.arena
    }

    /// The buffer of run-time numbers of rows.
    pub(super) fn counts_buffer(&self) -> &wgpu::Buffer {
        &self.counts
    }

    /// Records the copy of counts and outputs to a staging buffer from byte `at` on; where it ends.
    pub(super) fn encode_outputs(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        staging: &wgpu::Buffer,
        mut at: u64,
    ) -> u64 {
        let bytes = 4 * self.host_counts.len() as u64;
        encoder.copy_buffer_to_buffer(&self.counts, 0, staging, at, bytes);
        at += bytes;
        for port in self.lowered.graph.outputs() {
            let (buffer, offset, bytes) = self.place_of(&port.tensor);
            encoder.copy_buffer_to_buffer(buffer, offset, staging, at, bytes);
            at += bytes;
        }
        at
    }

    /// Takes apart what [`Self::encode_outputs`] copied: outputs by name at their run-time number of rows.
    pub(super) fn parse_outputs(&self, take: &mut impl FnMut(usize) -> Vec<u32>) -> Outputs {
        let counts: Vec<usize> = take(self.host_counts.len())
            .iter()
            .map(|&n| n as usize)
            .collect();
        let outputs = self.lowered.graph.outputs().iter();
        outputs
            .map(|port| {
                let all = take(self.lowered.most_numbers(&port.tensor));
                let filled = (port.tensor.rows.at(&counts) * port.tensor.channels).min(all.len());
                let numbers = all[..filled].iter().map(|&word| f32::from_bits(word));
                (port.name.clone(), numbers.collect())
            })
            .collect()
    }

    /// Runs once and reads every output: the simple form, for tests and for networks used alone.
    ///
    /// # Errors
    /// Any [`GpuError`] of the device.
    pub async fn run(&mut self, timer: Option<&Timer>) -> Result<Outputs, GpuError> {
        self.gpu.check()?;
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.encode(&mut encoder);
        let bytes = self.encode_outputs(&mut encoder, &self.staging, 0);
        self.gpu.queue.submit([encoder.finish()]);
        let is_first = !std::mem::replace(&mut self.has_run, true);
        let this = &*self;
        read_mapped(&this.gpu, &this.staging, bytes, is_first, timer, |view| {
            this.parse_outputs(&mut words_of(view))
        })
        .await
    }
}

/// Outputs by name.
pub type Outputs = Vec<(String, Vec<f32>)>;

/// Takes words off the front of bytes that were read back.
pub(super) fn words_of(bytes: &[u8]) -> impl FnMut(usize) -> Vec<u32> {
    let mut rest: &[u32] = bytemuck::cast_slice(bytes);
    move |n| {
        let (head, tail) = rest.split_at(n.min(rest.len()));
        rest = tail;
        head.to_vec()
    }
}
