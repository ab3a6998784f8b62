//! One picture through all networks with one readback: extractor, selection, descriptor sampling, branches.
//!
//! [`GpuFrame::submit`] starts the extractor and returns at once, so that segments can be detected on the CPU meanwhile;
//! [`GpuFrame::finish`] takes the positions along the segments, runs the rest, and waits for the results. Once they are
//! there the next picture can be submitted, while the CPU works on what was read.

use std::sync::Arc;

use super::{
    device::GpuDevice,
    error::GpuError,
    executor::{GpuNetwork, Outputs, words_of},
    frame_plan::{
        FrameParts, FramePlan, FramePorts, LoweredPicture, Member, PictureParts, has_input,
        lower_all,
    },
    network::GpuCost,
    pipelines::Pipelines,
    readback::{Timer, read_mapped},
    storage::WeightStorage,
};
use crate::nn::shape::CountId;

/// What the one readback of a frame brings.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrameResult {
    /// `[keypoints, 2]` positions in pixels of the picture, ordered by (y, x).
    pub positions: Vec<f32>,
    /// Scores of the keypoints.
    pub scores: Vec<f32>,
    /// For each branch its outputs by name, at their run-time number of rows.
    pub branches: Vec<Outputs>,
    /// Descriptors of the keypoints, and those along the segments; empty unless the parts asked for them.
    pub descriptors: [Vec<f32>; 2],
}

/// The networks for one size of picture.
#[derive(Debug)]
struct Picture {
    extractor: GpuNetwork,
    point_sampler: GpuNetwork,
    line_sampler: Option<GpuNetwork>,
}

impl Picture {
    fn load(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        lowered: LoweredPicture,
    ) -> Result<Self, GpuError> {
        let mut load = |network| GpuNetwork::load(gpu, pipelines, network);
        Ok(Self {
            extractor: load(lowered.extractor)?,
            point_sampler: load(lowered.point_sampler)?,
            line_sampler: lowered.line_sampler.map(load).transpose()?,
        })
    }

    /// Of the keypoints, then along the segments.
    fn samplers(&self) -> impl Iterator<Item = &GpuNetwork> {
        core::iter::once(&self.point_sampler).chain(&self.line_sampler)
    }
}

/// A scene's networks on the device, for one size of picture at a time.
#[derive(Debug)]
pub struct GpuFrame {
    gpu: Arc<GpuDevice>,
    /// Missing only after [`Self::resize`] has failed.
    picture: Option<Picture>,
    branches: Vec<GpuNetwork>,
    plan: FramePlan,
    ports: FramePorts,
    tokens: usize,
    capacity: usize,
    storage: WeightStorage,
    staging: wgpu::Buffer,
    has_run: bool,
}

impl GpuFrame {
    /// Uploads everything and makes all pipelines.
    ///
    /// # Errors
    /// Any [`GpuError`] of the networks; [`GpuError::Network`] when names or sizes do not meet.
    pub async fn new(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        parts: FrameParts,
    ) -> Result<Self, GpuError> {
        let picture = parts.picture.lower(parts.storage)?;
        let branches = lower_all(parts.branches, parts.storage)?;
        let plan = FramePlan::new(
            &parts.ports,
            &picture,
            &branches.iter().collect::<Vec<_>>(),
            parts.reads_descriptors,
        )?;
        let capacity = picture.capacity;
        gpu.attempt("the networks of a frame", || {
            let staging = gpu.buffer(
                "frame staging",
                plan.staging_bytes,
                wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            );
            Ok(Self {
                gpu: Arc::clone(gpu),
                picture: Some(Picture::load(gpu, pipelines, picture)?),
                branches: branches
                    .into_iter()
                    .map(|branch| GpuNetwork::load(gpu, pipelines, branch))
                    .collect::<Result<Vec<_>, _>>()?,
                plan,
                ports: parts.ports,
                tokens: parts.tokens,
                capacity,
                storage: parts.storage,
                staging,
                has_run: false,
            })
        })
        .await
    }

    /// Replaces the networks that depend on the picture's size; the branches stay. Capacities must be the same.
    ///
    /// # Errors
    /// As for [`Self::new`]. The frame is of no use then.
    pub async fn resize(
        &mut self,
        pipelines: &mut Pipelines,
        parts: PictureParts,
    ) -> Result<(), GpuError> {
        // The old size goes first: two of them may not fit.
        self.picture = None;
        let lowered = parts.lower(self.storage)?;
        let branches: Vec<_> = self.branches.iter().map(GpuNetwork::lowered).collect();
        let reads_descriptors = self.plan.reads_descriptors;
        let plan = FramePlan::new(&self.ports, &lowered, &branches, reads_descriptors)?;
        if lowered.capacity != self.capacity || plan.staging_bytes != self.plan.staging_bytes {
            return Err(self.unusable("the number of keypoints cannot change with the size"));
        }
        let gpu = &self.gpu;
        let picture = gpu
            .attempt("the networks of a picture's size", || {
                Picture::load(gpu, pipelines, lowered)
            })
            .await?;
        self.picture = Some(picture);
        self.plan = plan;
        self.has_run = false;
        Ok(())
    }

    fn unusable(&self, problem: &str) -> GpuError {
        GpuError::Unsupported {
            network: "frame".to_owned(),
            op: "picture",
            problem: problem.to_owned(),
        }
    }

    fn picture(&self) -> Result<&Picture, GpuError> {
        self.picture
            .as_ref()
            .ok_or_else(|| self.unusable("the last change of size failed"))
    }

    /// Most keypoints.
    pub fn max_keypoints(&self) -> usize {
        self.capacity
    }

    /// Most segments; more are an error of [`Self::finish`].
    pub fn max_segments(&self) -> usize {
        let sampler = self
            .picture
            .as_ref()
            .and_then(|picture| picture.line_sampler.as_ref());
        sampler.map_or(0, |sampler| {
            sampler.graph().counts()[0].capacity / self.tokens.max(1)
        })
    }

    /// Bytes of the one readback.
    pub fn readback_bytes(&self) -> u64 {
        self.plan.staging_bytes
    }

    /// What a frame costs at full capacity.
    pub fn cost(&self) -> GpuCost {
        self.plan.cost
    }

    /// Uploads the picture (numbers 0..1, row-major) and starts extractor and selection. Returns at once.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] for a picture of another size, before anything has reached the device; a device that is
    /// gone.
    pub fn submit(&self, gray: &[f32]) -> Result<(), GpuError> {
        self.gpu.check()?;
        let extractor = &self.picture()?.extractor;
        let lowered = extractor.lowered();
        let needed = lowered.most_numbers(&lowered.graph.input(self.ports.gray)?);
        if gray.len() != needed {
            let problem = format!(
                "a picture of {} pixels came where one of {needed} was announced",
                gray.len()
            );
            return Err(self.unusable(&problem));
        }
        extractor.write_input(self.ports.gray, gray)?;
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        extractor.encode(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// Takes the positions along the segments (x and y of each token), runs sampling and branches, and reads the results.
    /// No segment and no keypoint are valid.
    ///
    /// # Errors
    /// [`GpuError::Network`] for more segments than [`Self::max_segments`], before anything has reached the device;
    /// [`GpuError::MapTimeout`], after which the frame can be used again; any other error of the device.
    pub async fn finish(
        &mut self,
        token_positions: &[f32],
        timer: Option<&Timer>,
    ) -> Result<FrameResult, GpuError> {
        let num_segments = token_positions.len() / (2 * self.tokens.max(1));
        let picture = self.picture.as_mut();
        if let Some(sampler) = picture.and_then(|picture| picture.line_sampler.as_mut()) {
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
        let is_first = !self.has_run;
        let this = &*self;
        let result = read_mapped(
            &this.gpu,
            &this.staging,
            this.plan.staging_bytes,
            is_first,
            timer,
            |view| this.parse(view),
        )
        .await?;
        self.has_run = true;
        Ok(result)
    }

    fn encode_rest(&self, encoder: &mut wgpu::CommandEncoder) -> Result<(), GpuError> {
        let picture = self.picture()?;
        let ports = &self.ports;
        let selected = picture.extractor.lowered().selected;
        let network = |member: Member| match member {
            Member::Extractor => Some(&picture.extractor),
            Member::PointSampler => Some(&picture.point_sampler),
            Member::LineSampler => picture.line_sampler.as_ref(),
            Member::Branch(index) => self.branches.get(index),
        };
        let copy_into = |encoder: &mut wgpu::CommandEncoder, member: Member| {
            for joint in self.plan.joints.iter().filter(|joint| joint.to.0 == member) {
                if let (Some(from), Some(to)) = (network(joint.from.0), network(joint.to.0)) {
                    let (source, source_offset, bytes) = from.place_of(&joint.from.1);
                    let (target, target_offset, _) = to.place_of(&joint.to.1);
                    encoder.copy_buffer_to_buffer(
                        source,
                        source_offset,
                        target,
                        target_offset,
                        bytes,
                    );
                }
            }
        };
        let num_keypoints = picture.extractor.counts_buffer();
        let at_num_keypoints = 4 * selected.count as u64;
        let copy_count =
            |encoder: &mut wgpu::CommandEncoder, to: &GpuNetwork, CountId(id): CountId| {
                let target = to.counts_buffer();
                encoder.copy_buffer_to_buffer(
                    num_keypoints,
                    at_num_keypoints,
                    target,
                    4 * id as u64,
                    4,
                );
            };

        let sampler = &picture.point_sampler;
        let (target, offset, bytes) = sampler.place_of(&sampler.graph().input(ports.positions)?);
        let chosen = picture.extractor.arena();
        encoder.copy_buffer_to_buffer(chosen, 4 * selected.positions as u64, target, offset, bytes);
        copy_count(encoder, sampler, sampler.graph().count(ports.samples)?);
        for member in [Member::PointSampler, Member::LineSampler] {
            copy_into(encoder, member);
            if let Some(sampler) = network(member) {
                sampler.encode(encoder);
            }
        }

        let staging = &self.staging;
        encoder.copy_buffer_to_buffer(num_keypoints, at_num_keypoints, staging, 0, 4);
        let mut at = 4;
        for (offset, numbers) in [
            (selected.positions, 2 * self.capacity),
            (selected.scores, self.capacity),
        ] {
            let bytes = 4 * numbers as u64;
            encoder.copy_buffer_to_buffer(chosen, 4 * offset as u64, staging, at, bytes);
            at += bytes;
        }
        for (index, branch) in self.branches.iter().enumerate() {
            copy_into(encoder, Member::Branch(index));
            if has_input(branch.graph(), ports.descriptors) {
                copy_count(encoder, branch, branch.graph().count(ports.points)?);
            }
            branch.encode(encoder);
            at = branch.encode_outputs(encoder, staging, at);
        }
        if self.plan.reads_descriptors {
            for sampler in picture.samplers() {
                at = sampler.encode_outputs(encoder, staging, at);
            }
        }
        Ok(())
    }

    /// Takes the readback apart, in the order in which [`Self::encode_rest`] put it together.
    fn parse(&self, view: &[u8]) -> FrameResult {
        let mut take = words_of(view);
        let num_keypoints = (take(1)[0] as usize).min(self.capacity);
        let floats = |words: Vec<u32>, n: usize| -> Vec<f32> {
            words[..n]
                .iter()
                .map(|&word| f32::from_bits(word))
                .collect()
        };
        let mut result = FrameResult {
            positions: floats(take(2 * self.capacity), 2 * num_keypoints),
            scores: floats(take(self.capacity), num_keypoints),
            branches: self
                .branches
                .iter()
                .map(|branch| branch.parse_outputs(&mut take))
                .collect(),
            descriptors: Default::default(),
        };
        if self.plan.reads_descriptors
            && let Some(picture) = &self.picture
        {
            for (of_sampler, sampler) in result.descriptors.iter_mut().zip(picture.samplers()) {
                let outputs = sampler.parse_outputs(&mut take);
                let wanted = |(name, _): &(String, _)| name == self.ports.descriptors;
                if let Some((_, numbers)) = outputs.into_iter().find(wanted) {
                    *of_sampler = numbers;
                }
            }
        }
        result
    }
}
