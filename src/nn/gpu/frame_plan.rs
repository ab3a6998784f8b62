//! What a frame is made of, and how its networks are joined: everything that can be known without a device.

use super::{
    error::GpuError,
    network::{GpuCost, LoweredNetwork},
    select::GpuSelect,
    storage::WeightStorage,
};
use crate::nn::{Graph, NnError, Tensor, Weights};

/// A graph with its weights.
#[derive(Debug, Clone)]
pub struct GpuPart {
    /// The network.
    pub graph: Graph,
    /// Its weights, as prepared for the graph.
    pub weights: Weights,
}

impl GpuPart {
    fn lower(
        self,
        storage: WeightStorage,
        select: Option<&GpuSelect>,
    ) -> Result<LoweredNetwork, GpuError> {
        LoweredNetwork::new(self.graph, self.weights, storage, select)
    }
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

/// The networks that depend on the picture's size.
#[derive(Debug, Clone)]
pub struct PictureParts {
    /// The extractor for that size.
    pub extractor: GpuPart,
    /// Selection of keypoints behind it.
    pub select: GpuSelect,
    /// Sampler of the keypoints; its capacity is that of the selection.
    pub point_sampler: GpuPart,
    /// Sampler along the segments; its capacity is segments times tokens.
    pub line_sampler: Option<GpuPart>,
}

/// What a frame is made of.
#[derive(Debug, Clone)]
pub struct FrameParts {
    /// The networks for the picture's size.
    pub picture: PictureParts,
    /// Samples along a segment.
    pub tokens: usize,
    /// The regressors: each takes descriptors, tokens, or both.
    pub branches: Vec<GpuPart>,
    /// The names.
    pub ports: FramePorts,
    /// How weights are stored.
    pub storage: WeightStorage,
    /// Bring the descriptors back too, of keypoints and along segments.
    pub reads_descriptors: bool,
}

impl FrameParts {
    /// What a frame costs at full capacity, and the bytes of its one readback. Needs no device.
    ///
    /// # Errors
    /// Those of lowering: [`GpuError::Network`], [`GpuError::TooLarge`], [`GpuError::Unsupported`].
    pub fn cost(self) -> Result<(GpuCost, u64), GpuError> {
        let picture = self.picture.lower(self.storage)?;
        let branches = lower_all(self.branches, self.storage)?;
        let plan = FramePlan::new(
            &self.ports,
            &picture,
            &branches.iter().collect::<Vec<_>>(),
            self.reads_descriptors,
        )?;
        Ok((plan.cost, plan.staging_bytes))
    }
}

impl PictureParts {
    pub(super) fn lower(self, storage: WeightStorage) -> Result<LoweredPicture, GpuError> {
        Ok(LoweredPicture {
            extractor: self.extractor.lower(storage, Some(&self.select))?,
            capacity: self.select.capacity,
            point_sampler: self.point_sampler.lower(storage, None)?,
            line_sampler: self
                .line_sampler
                .map(|part| part.lower(storage, None))
                .transpose()?,
        })
    }
}

pub(super) fn lower_all(
    parts: Vec<GpuPart>,
    storage: WeightStorage,
) -> Result<Vec<LoweredNetwork>, GpuError> {
    parts
        .into_iter()
        .map(|part| part.lower(storage, None))
        .collect()
}

/// The networks for a picture's size, ready to be loaded.
#[derive(Debug)]
pub(super) struct LoweredPicture {
    pub(super) extractor: LoweredNetwork,
    pub(super) capacity: usize,
    pub(super) point_sampler: LoweredNetwork,
    pub(super) line_sampler: Option<LoweredNetwork>,
}

/// One of the networks of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Member {
    Extractor,
    PointSampler,
    LineSampler,
    Branch(usize),
}

/// A tensor of one network that is copied into another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joint {
    pub(super) from: (Member, Tensor),
    pub(super) to: (Member, Tensor),
}

/// How the networks are joined, what that costs, and what is read back.
#[derive(Debug)]
pub(super) struct FramePlan {
    pub(super) joints: Vec<Joint>,
    pub(super) cost: GpuCost,
    pub(super) staging_bytes: u64,
    /// The samplers' outputs follow those of the branches.
    pub(super) reads_descriptors: bool,
}

/// Whether a graph has an input of this name.
pub(super) fn has_input(graph: &Graph, name: &str) -> bool {
    graph.inputs().iter().any(|port| port.name == name)
}

impl FramePlan {
    /// Joins the networks by their names.
    ///
    /// # Errors
    /// [`GpuError::Network`] for a name that is missing and for sizes that do not meet.
    pub(super) fn new(
        ports: &FramePorts,
        picture: &LoweredPicture,
        branches: &[&LoweredNetwork],
        reads_descriptors: bool,
    ) -> Result<Self, GpuError> {
        let features = picture.extractor.graph.output(ports.features)?;
        let mut samplers = vec![(Member::PointSampler, &picture.point_sampler)];
        samplers.extend(
            picture
                .line_sampler
                .as_ref()
                .map(|sampler| (Member::LineSampler, sampler)),
        );
        let mut joints = Vec::new();
        for (member, sampler) in &samplers {
            joints.push(Joint {
                from: (Member::Extractor, features),
                to: (*member, sampler.graph.input(ports.cells)?),
            });
        }
        for (index, branch) in branches.iter().enumerate() {
            for (name, (member, sampler)) in [ports.descriptors, ports.tokens].iter().zip(&samplers)
            {
                if has_input(&branch.graph, name) {
                    joints.push(Joint {
                        from: (*member, sampler.graph.output(ports.descriptors)?),
                        to: (Member::Branch(index), branch.graph.input(name)?),
                    });
                }
            }
        }
        let network = |member: Member| match member {
            Member::Extractor => Some(&picture.extractor),
            Member::PointSampler => Some(&picture.point_sampler),
            Member::LineSampler => picture.line_sampler.as_ref(),
            Member::Branch(index) => branches.get(index).copied(),
        };
        let bytes_of = |(member, tensor): &(Member, Tensor)| {
            network(*member).map_or(0, |network| 4 * network.most_numbers(tensor) as u64)
        };
        let mut bytes_copied = 0;
        for Joint { from, to } in &joints {
            let (given, taken) = (bytes_of(from), bytes_of(to));
            if given != taken {
                let name = |member| network(member).map_or("", |network| network.graph.name());
                return Err(GpuError::Network(NnError::BadGraph {
                    graph: name(to.0).to_owned(),
                    problem: format!("takes {taken} bytes where `{}` gives {given}", name(from.0)),
                }));
            }
            bytes_copied += given;
        }
        let read_samplers = samplers.iter().filter(|_| reads_descriptors);
        // Count, positions and scores of the keypoints, then each branch's counts and outputs, then the samplers'.
        let staging_bytes = 4
            + 12 * picture.capacity as u64
            + branches
                .iter()
                .map(|branch| branch.output_bytes())
                .sum::<u64>()
            + read_samplers
                .map(|(_, sampler)| sampler.output_bytes())
                .sum::<u64>();
        let uploads = [
            Some((&picture.extractor, ports.gray)),
            Some((&picture.point_sampler, ports.positions)),
            picture
                .line_sampler
                .as_ref()
                .map(|sampler| (sampler, ports.positions)),
        ];
        for (network, name) in uploads.into_iter().flatten() {
            bytes_copied += 4 * network.most_numbers(&network.graph.input(name)?) as u64;
        }
        let picture_networks = [
            Some(&picture.extractor),
            Some(&picture.point_sampler),
            picture.line_sampler.as_ref(),
        ];
        let all = picture_networks
            .into_iter()
            .flatten()
            .chain(branches.iter().copied());
        let cost = GpuCost {
            bytes_copied: bytes_copied + staging_bytes,
            ..all.map(LoweredNetwork::cost).sum()
        };
        Ok(Self {
            joints,
            cost,
            staging_bytes,
            reads_descriptors,
        })
    }
}
