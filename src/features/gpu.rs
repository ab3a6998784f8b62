//! Extractor and samplers as parts of a frame on the GPU: the same networks and the same selection as on the CPU.

use super::{ExtractorOptions, FeatureError};
use crate::models::{ExtractorKind, SelectionRule, ports};
use crate::nn::{
    Weights,
    gpu::{FrameParts, FramePorts, GpuPart, GpuSelect, PictureParts, WeightStorage},
};

/// How the parts of a frame call what they share.
const PORTS: FramePorts = FramePorts {
    gray: ports::GRAY,
    features: ports::FEATURES,
    cells: ports::CELLS,
    positions: ports::POSITIONS,
    samples: ports::SAMPLES,
    descriptors: ports::DESCRIPTORS,
    tokens: ports::TOKENS,
    points: ports::POINTS,
    segments: ports::SEGMENTS,
};

/// The parts of a frame for pictures of `width` x `height` pixels, ready for [`crate::nn::gpu::GpuFrame::new`]. `weights` are
/// the extractor's; `branches` are the scene's networks with room for `options.keypoints.max_keypoints` keypoints and
/// `options.max_segments` segments.
///
/// # Errors
/// [`FeatureError::Model`] for weights or sizes that do not fit the extractor.
pub fn frame_parts(
    kind: ExtractorKind,
    weights: &Weights,
    options: &ExtractorOptions,
    size: (usize, usize),
    branches: Vec<GpuPart>,
    storage: WeightStorage,
) -> Result<FrameParts, FeatureError> {
    Ok(FrameParts {
        picture: picture_parts(kind, weights, options, size)?,
        tokens: options.tokens,
        branches,
        ports: PORTS,
        storage,
        reads_descriptors: false,
    })
}

/// Those of them that depend on the picture's size, for [`crate::nn::gpu::GpuFrame::resize`].
///
/// # Errors
/// [`FeatureError::Model`] for weights or sizes that do not fit the extractor.
pub fn picture_parts(
    kind: ExtractorKind,
    weights: &Weights,
    options: &ExtractorOptions,
    (width, height): (usize, usize),
) -> Result<PictureParts, FeatureError> {
    kind.check_weights(weights)?;
    let sampler = |capacity: usize| {
        let graph = kind.sampler_graph(width, height, options.sampler, capacity)?;
        Ok::<_, FeatureError>(GpuPart {
            graph,
            weights: Weights::new(),
        })
    };
    let keypoints = &options.keypoints;
    let capacity = keypoints.max_keypoints.max(1);
    let inner = kind.inner_size(width, height);
    let selection = kind.selection();
    let reliability = match selection.rule {
        SelectionRule::Reliable {
            reliability,
            sampler,
        } => {
            let axis = |inner: usize| sampler.axis(inner, inner);
            Some((reliability, axis(inner.0), axis(inner.1)))
        }
        SelectionRule::ThreePass => None,
    };
    let (scale_x, scale_y) = selection.picture_per_map((width, height), inner);
    let line_samples = options.token_capacity();
    Ok(PictureParts {
        extractor: GpuPart {
            graph: kind.graph(width, height, false)?,
            weights: weights.clone(),
        },
        select: GpuSelect {
            heat: selection.heat,
            reliability,
            radius: keypoints.nms_radius,
            min_heat: keypoints.min_heat,
            border: keypoints.border,
            capacity,
            scale: [scale_x as f32, scale_y as f32],
        },
        point_sampler: sampler(capacity)?,
        line_sampler: if line_samples > 0 {
            Some(sampler(line_samples)?)
        } else {
            None
        },
    })
}
