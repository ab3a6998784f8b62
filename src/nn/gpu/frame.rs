//! One picture through all networks with one readback: extractor, selection, descriptor sampling, branches.
//!
//! [`GpuFrame::submit`] starts the extractor and returns at once, so that segments can be detected on the CPU meanwhile;
//! [`GpuFrame::finish`] takes the positions along the segments, runs the rest, and waits for the results.

use std::sync::Arc;

use super::{
    device::GpuDevice,
    error::GpuError,
    executor::{GpuCost, GpuNetwork},
    pipelines::Pipelines,
    readback::{Timer, read_mapped},
    select::GpuSelect,
};
use crate::nn::{CountId, Graph, NnError, Tensor, Weights};

/// A graph with its weights.
#[derive(Debug, Clone)]
pub struct GpuPart {
    /// The network.
    pub graph: Graph,
    /// Its weights, as prepared for the graph.
    pub weights: Weights,
}

/// Names that the frame uses to join the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FramePorts {
    /// Input of the extractor: the grey picture.
    pub gray: &'static str,
    /// Output of the extractor: unit descriptors per cell.
    pub features: &'static str,
    /// Input of a sampler: those descriptors.
    pub cells: &'static str,
    /// Input of a sampler: positions.
    pub positions: &'static str,
    /// Count of a sampler.
    pub samples: &'static str,
    /// Output of a sampler and input of a branch: descriptors of the keypoints.
    pub descriptors: &'static str,
    /// Input of a branch: descriptors along the segments.
    pub tokens: &'static str,
    /// Count of a branch: keypoints.
    pub points: &'static str,
    /// Count of a branch: segments.
    pub segments: &'static str,
}

/// What a frame is made of.
#[derive(Debug, Clone)]
pub struct FrameParts {
    /// The extractor for the picture's size.
    pub extractor: GpuPart,
    /// Selection of keypoints behind it.
    pub select: GpuSelect,
    /// Sampler of the keypoints; its capacity is that of the selection.
    pub point_sampler: GpuPart,
    /// Sampler along the segments; its capacity is segments times tokens.
    pub line_sampler: Option<GpuPart>,
    /// Samples along a segment.
    pub tokens: usize,
    /// The regressors: each takes descriptors, tokens, or both.
    pub branches: Vec<GpuPart>,
    /// The names.
    pub ports: FramePorts,
}

/// What the one readback of a frame brings.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrameResult {
    /// `[keypoints, 2]` positions in pixels of the picture, ordered by (y, x).
    pub positions: Vec<f32>,
    /// Scores of the keypoints.
    pub scores: Vec<f32>,
    /// For each branch its outputs by name, at their run-time number of rows.
    pub branches: Vec<Vec<(String, Vec<f32>)>>,
}

/// One picture size of one scene on the device.
#[derive(Debug)]
pub struct GpuFrame {
    gpu: Arc<GpuDevice>,
    extractor: GpuNetwork,
    point_sampler: GpuNetwork,
    line_sampler: Option<GpuNetwork>,
    branches: Vec<GpuNetwork>,
    ports: FramePorts,
    tokens: usize,
    capacity: usize,
    staging: wgpu::Buffer,
    staging_bytes: u64,
}

/// Whether a graph has an input of this name.
fn has_input(graph: &Graph, name: &str) -> bool {
    graph.inputs().iter().any(|port| port.name == name)
}

impl GpuFrame {
    /// Uploads everything and makes all pipelines.
    ///
    /// # Errors
    /// Any [`GpuError`] of the networks; [`GpuError::Network`] when names or sizes do not meet.
    pub fn new(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        parts: FrameParts,
    ) -> Result<Self, GpuError> {
        use wgpu::BufferUsages as Usage;
        let FrameParts {
            extractor,
            select,
            point_sampler,
            line_sampler,
            tokens,
            branches,
            ports,
        } = parts;
        let extractor = GpuNetwork::with_selection(
            gpu,
            pipelines,
            extractor.graph,
            extractor.weights,
            Some(&select),
        )?;
        let mut load = |part: GpuPart| GpuNetwork::new(gpu, pipelines, part.graph, part.weights);
        let point_sampler = load(point_sampler)?;
        let line_sampler = line_sampler.map(&mut load).transpose()?;
        let branches = branches
            .into_iter()
            .map(&mut load)
            .collect::<Result<Vec<_>, _>>()?;
        let mut frame = Self {
            gpu: Arc::clone(gpu),
            extractor,
            point_sampler,
            line_sampler,
            branches,
            ports,
            tokens,
            capacity: select.capacity,
            staging: gpu.buffer("frame staging", 16, Usage::MAP_READ | Usage::COPY_DST),
            staging_bytes: 0,
        };
        frame.check_joints()?;
        frame.staging_bytes = frame.layout_bytes();
        frame.staging = gpu.buffer(
            "frame staging",
            frame.staging_bytes,
            Usage::MAP_READ | Usage::COPY_DST,
        );
        Ok(frame)
    }

    /// Most keypoints.
    pub fn max_keypoints(&self) -> usize {
        self.capacity
    }

    /// Most segments; more are an error of [`Self::finish`].
    pub fn max_segments(&self) -> usize {
        let sampler = self
            .line_sampler
            .as_ref()
            .map(|sampler| &sampler.graph().counts()[0]);
        sampler.map_or(0, |count| count.capacity / self.tokens.max(1))
    }

    /// Bytes of the one readback.
    pub fn readback_bytes(&self) -> u64 {
        self.staging_bytes
    }

    /// What a frame costs at full capacity.
    pub fn cost(&self) -> GpuCost {
        let networks = [&self.extractor, &self.point_sampler];
        let all = networks
            .into_iter()
            .chain(&self.line_sampler)
            .chain(&self.branches);
        all.map(GpuNetwork::cost)
            .fold(GpuCost::default(), |sum, cost| GpuCost {
                dispatches: sum.dispatches + cost.dispatches,
                bytes_moved: sum.bytes_moved + cost.bytes_moved,
                macs: sum.macs + cost.macs,
                arena_bytes: sum.arena_bytes + cost.arena_bytes,
                weight_bytes: sum.weight_bytes + cost.weight_bytes,
            })
    }

    /// Uploads the picture (numbers 0..1, row-major) and starts extractor and selection. Returns at once.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] for a picture of another size; a device that is gone.
    pub fn submit(&self, gray: &[f32]) -> Result<(), GpuError> {
        self.gpu.check()?;
        self.extractor.write_input(self.ports.gray, gray)?;
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.extractor.encode(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// Takes the positions along the segments (x and y of each token), runs sampling and branches, and reads the results.
    /// No segment and no keypoint are valid.
    ///
    /// # Errors
    /// [`GpuError::Network`] for more segments than [`Self::max_segments`]; any error of the device.
    pub async fn finish(
        &mut self,
        token_positions: &[f32],
        timer: Option<&Timer>,
    ) -> Result<FrameResult, GpuError> {
        let num_segments = token_positions.len() / (2 * self.tokens.max(1));
        if let Some(sampler) = &mut self.line_sampler {
            sampler.set_count(self.ports.samples, num_segments * self.tokens)?;
            sampler.write_input(self.ports.positions, token_positions)?;
        }
        for branch in &mut self.branches {
            if has_input(branch.graph(), self.ports.tokens) {
                branch.set_count(self.ports.segments, num_segments)?;
            }
        }
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.encode_rest(&mut encoder)?;
        self.gpu.queue.submit([encoder.finish()]);
        let (branches, capacity) = (&self.branches, self.capacity);
        read_mapped(
            &self.gpu,
            &self.staging,
            self.staging_bytes,
            timer,
            |view| parse(bytemuck::cast_slice(view), branches, capacity),
        )
        .await
    }

    /// Checks that tensors which are copied into each other have the same size.
    fn check_joints(&self) -> Result<(), GpuError> {
        let meet = |from: (&GpuNetwork, Tensor), to: (&GpuNetwork, Tensor)| {
            let (from_bytes, to_bytes) = (from.0.place_of(&from.1).2, to.0.place_of(&to.1).2);
            if from_bytes == to_bytes {
                return Ok(());
            }
            Err(GpuError::Network(NnError::BadGraph {
                graph: to.0.graph().name().to_owned(),
                problem: format!(
                    "takes {to_bytes} bytes where `{}` gives {from_bytes}",
                    from.0.graph().name()
                ),
            }))
        };
        let ports = &self.ports;
        let features = self.extractor.graph().output(ports.features)?;
        for sampler in [&self.point_sampler].into_iter().chain(&self.line_sampler) {
            meet(
                (&self.extractor, features),
                (sampler, sampler.graph().input(ports.cells)?),
            )?;
        }
        for branch in &self.branches {
            for (name, sampler) in [
                (ports.descriptors, Some(&self.point_sampler)),
                (ports.tokens, self.line_sampler.as_ref()),
            ] {
                if let (true, Some(sampler)) = (has_input(branch.graph(), name), sampler) {
                    let given = sampler.graph().output(ports.descriptors)?;
                    meet((sampler, given), (branch, branch.graph().input(name)?))?;
                }
            }
        }
        Ok(())
    }

    fn encode_rest(&self, encoder: &mut wgpu::CommandEncoder) -> Result<(), GpuError> {
        let ports = &self.ports;
        let selected = self.extractor.selected();
        let copy = |encoder: &mut wgpu::CommandEncoder,
                    from: (&GpuNetwork, Tensor),
                    to: (&GpuNetwork, Tensor)| {
            let (source, source_offset, bytes) = from.0.place_of(&from.1);
            let (target, target_offset, _) = to.0.place_of(&to.1);
            encoder.copy_buffer_to_buffer(source, source_offset, target, target_offset, bytes);
        };
        let copy_count =
            |encoder: &mut wgpu::CommandEncoder, to: &GpuNetwork, CountId(id): CountId| {
                let source = self.extractor.counts_buffer();
                encoder.copy_buffer_to_buffer(
                    source,
                    4 * selected.count as u64,
                    to.counts_buffer(),
                    4 * id as u64,
                    4,
                );
            };
        let features = self.extractor.graph().output(ports.features)?;
        for sampler in [&self.point_sampler].into_iter().chain(&self.line_sampler) {
            copy(
                encoder,
                (&self.extractor, features),
                (sampler, sampler.graph().input(ports.cells)?),
            );
        }
        let sampler = &self.point_sampler;
        let (target, offset, bytes) = sampler.place_of(&sampler.graph().input(ports.positions)?);
        encoder.copy_buffer_to_buffer(
            self.extractor.arena(),
            4 * selected.positions as u64,
            target,
            offset,
            bytes,
        );
        copy_count(encoder, sampler, sampler.graph().count(ports.samples)?);
        for sampler in [&self.point_sampler].into_iter().chain(&self.line_sampler) {
            sampler.encode(encoder);
        }
        let mut at = 4;
        encoder.copy_buffer_to_buffer(
            self.extractor.counts_buffer(),
            4 * selected.count as u64,
            &self.staging,
            0,
            4,
        );
        for (offset, numbers) in [
            (selected.positions, 2 * self.capacity),
            (selected.scores, self.capacity),
        ] {
            let bytes = 4 * numbers as u64;
            encoder.copy_buffer_to_buffer(
                self.extractor.arena(),
                4 * offset as u64,
                &self.staging,
                at,
                bytes,
            );
            at += bytes;
        }
        for branch in &self.branches {
            let graph = branch.graph();
            if has_input(graph, ports.descriptors) {
                let given = self.point_sampler.graph().output(ports.descriptors)?;
                copy(
                    encoder,
                    (&self.point_sampler, given),
                    (branch, graph.input(ports.descriptors)?),
                );
                copy_count(encoder, branch, graph.count(ports.points)?);
            }
            if let (true, Some(sampler)) = (has_input(graph, ports.tokens), &self.line_sampler) {
                let given = sampler.graph().output(ports.descriptors)?;
                copy(
                    encoder,
                    (sampler, given),
                    (branch, graph.input(ports.tokens)?),
                );
            }
            branch.encode(encoder);
            let bytes = 4 * graph.counts().len() as u64;
            encoder.copy_buffer_to_buffer(branch.counts_buffer(), 0, &self.staging, at, bytes);
            at += bytes;
            for port in graph.outputs() {
                let (buffer, offset, bytes) = branch.place_of(&port.tensor);
                encoder.copy_buffer_to_buffer(buffer, offset, &self.staging, at, bytes);
                at += bytes;
            }
        }
        Ok(())
    }

    fn layout_bytes(&self) -> u64 {
        let of_branch = |branch: &GpuNetwork| {
            let outputs = branch
                .graph()
                .outputs()
                .iter()
                .map(|port| branch.place_of(&port.tensor).2);
            4 * branch.graph().counts().len() as u64 + outputs.sum::<u64>()
        };
        4 + 12 * self.capacity as u64 + self.branches.iter().map(of_branch).sum::<u64>()
    }
}

/// Takes the readback apart, in the order in which [`GpuFrame::encode_rest`] put it together.
fn parse(mut words: &[u32], branches: &[GpuNetwork], capacity: usize) -> FrameResult {
    let mut take = |n: usize| {
        let (head, tail) = words.split_at(n);
        words = tail;
        head
    };
    let floats = |words: &[u32]| {
        words
            .iter()
            .map(|&word| f32::from_bits(word))
            .collect::<Vec<f32>>()
    };
    let num_keypoints = (take(1)[0] as usize).min(capacity);
    let positions = floats(&take(2 * capacity)[..2 * num_keypoints]);
    let scores = floats(&take(capacity)[..num_keypoints]);
    let branches = branches
        .iter()
        .map(|branch| {
            let graph = branch.graph();
            let counts: Vec<usize> = take(graph.counts().len())
                .iter()
                .map(|&n| n as usize)
                .collect();
            let outputs = graph.outputs().iter().map(|port| {
                let all = take((branch.place_of(&port.tensor).2 / 4) as usize);
                let filled = (port.tensor.rows.at(&counts) * port.tensor.channels).min(all.len());
                (port.name.clone(), floats(&all[..filled]))
            });
            outputs.collect()
        })
        .collect();
    FrameResult {
        positions,
        scores,
        branches,
    }
}
