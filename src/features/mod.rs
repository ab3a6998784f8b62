//! Keypoints and descriptors of a picture: from a grey picture and its segments to a [`FeatureSet`].
//!
//! * **In and out**: a [`crate::image::GrayView`] and [`Segment2`]s in its pixels; keypoints with scores, one unit descriptor
//!   for each keypoint, and a row of unit descriptors sampled along each segment.
//! * **Spaces and units**: everything is in corner-based pixels of the picture that went in;
//!   [`FeatureSet::map_pixels`] carries positions to another version of the picture.
//! * **Method**: the extractor's network ([`crate::models::ExtractorKind`]), then the reference's selection (maximum
//!   suppression, threshold, border, best `n` by score) and the reference's sampler.
//! * **Invariants**: keypoints are ordered by (y, x), so that a last-digit difference in a score cannot reorder them;
//!   segments keep their order.
//! * **Cost**: one run of the network; nothing is allocated while the size of the picture stays the same, apart from growing
//!   buffers.

mod extractor;
#[cfg(feature = "webgpu")]
mod gpu;
mod select;

pub use extractor::{Extractor, ExtractorOptions, FeatureError, write_gray, write_token_positions};
#[cfg(feature = "webgpu")]
pub use gpu::{frame_parts, picture_parts};
pub use select::{KeypointParams, SelectScratch, select_keypoints};

use crate::geometry::{Pixel, PixelMap, Segment2};

/// A position that the extractor chose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Centre, corner-based.
    pub pixel: Pixel,
    /// What the extractor ranks by; comparable within one extractor only.
    pub score: f32,
}

/// What the regressors and the solver get to know about a picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FeatureSet {
    /// Ordered by (y, x).
    pub keypoints: Vec<Keypoint>,
    /// `[keypoints, descriptor_channels]`, unit rows.
    pub descriptors_nd: Vec<f32>,
    /// In the order in which they were given.
    pub segments: Vec<Segment2>,
    /// `[segments, tokens, descriptor_channels]`, unit rows from start to end.
    pub segment_descriptors_nsd: Vec<f32>,
    /// Numbers in a descriptor.
    pub descriptor_channels: usize,
    /// Samples along a segment, both ends included.
    pub tokens: usize,
}

impl FeatureSet {
    /// Empties the set, keeping its memory.
    pub fn clear(&mut self) {
        self.keypoints.clear();
        self.descriptors_nd.clear();
        self.segments.clear();
        self.segment_descriptors_nsd.clear();
    }

    /// Descriptor of one keypoint.
    pub fn descriptor(&self, keypoint_idx: usize) -> Option<&[f32]> {
        let start = keypoint_idx.checked_mul(self.descriptor_channels)?;
        self.descriptors_nd
            .get(start..start + self.descriptor_channels)
    }

    /// All samples of one segment, `[tokens, descriptor_channels]`.
    pub fn segment_descriptors(&self, segment_idx: usize) -> Option<&[f32]> {
        let len = self.tokens * self.descriptor_channels;
        let start = segment_idx.checked_mul(len)?;
        self.segment_descriptors_nsd.get(start..start + len)
    }

    /// Carries keypoints and segments to another version of the picture; descriptors stay.
    pub fn map_pixels<To, From>(&mut self, map: &PixelMap<To, From>) {
        for keypoint in &mut self.keypoints {
            keypoint.pixel = map.apply(keypoint.pixel);
        }
        for segment in &mut self.segments {
            *segment = segment.mapped(map);
        }
    }
}
