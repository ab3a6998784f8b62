//! Configurations, tensor names and shapes, and graphs of all networks.
//!
//! * **In and out**: a configuration goes in; the list of tensors that a file holds, and a [`crate::nn::Graph`] with the
//!   step that turns those tensors into the graph's weights, come out.
//! * **Spaces and units**: descriptors are unit vectors; coordinates are normalised scene coordinates (centre and scale are
//!   undone in `regress`); pixels do not occur.
//! * **Method**: the branches are those of [plmap2025] (`proposed`), of PL2Map [pl2map2025] (`v1`), and branches anchored on
//!   landmarks (`compact`), which need no training ([`landmarks`]). The extractors are XFeat and SuperPoint. What is stored is what is trained; exact simplifications (folded biases and merges, the one-query line
//!   encoder) happen when weights are prepared for a graph, and tests hold them equal to the long form.
//! * **Invariants**: the trainer builds from the same configuration and the same [`TensorSpec`] list.
//! * **Cost**: `prepare` copies the weights once.

mod anchored;
mod attention;
mod config;
mod error;
mod extractor;
mod fold;
pub mod landmarks;
mod proposed;
mod superpoint;
#[cfg(test)]
mod tests;
mod v1;
mod xfeat;

pub use anchored::{AnchoredLineConfig, AnchoredPointConfig, AttentionOutput, LinePool};
pub use config::{
    LineBranchConfig, PointBranchConfig, Preset, RegressorConfig, TensorSpec, Variant,
};
pub use error::ModelError;
pub use extractor::{ExtractorKind, Sampler, Selection, SelectionRule};
pub use proposed::{AttentionLineConfig, AttentionPointConfig};
pub use v1::V1Config;

/// Side of a cell of all extractors: one descriptor for 8 x 8 pixels.
pub const CELL: usize = 8;

/// Names of counts, inputs and outputs of the branch graphs.
pub mod ports {
    /// Count of keypoints.
    pub const POINTS: &str = "points";
    /// Count of segments.
    pub const SEGMENTS: &str = "segments";
    /// Input: one unit descriptor for each keypoint.
    pub const DESCRIPTORS: &str = "descriptors";
    /// Input: the sampled unit descriptors along each segment, start to end.
    pub const TOKENS: &str = "tokens";
    /// Output: reliability logits, one for each element that went in.
    pub const LOGITS: &str = "logits";
    /// Output: coordinates of the elements that were kept; three for a point, six (start, end) for a segment.
    pub const COORDINATES: &str = "coordinates";
    /// Output: the row that each kept element had among the inputs. Missing where every element is kept.
    pub const ROWS: &str = "rows";
    /// Output of `v1`: coordinates and reliability number of every keypoint.
    pub const POINTS_3D: &str = "points3d";
    /// Output of `v1`: coordinates and reliability number of every segment.
    pub const LINES_3D: &str = "lines3d";
    /// Input of an extractor: the grey picture, 0..1.
    pub const GRAY: &str = "gray";
    /// Output of an extractor: unit descriptors for each cell.
    pub const FEATURES: &str = "features";
    /// Output of an extractor: probability of a keypoint for each pixel.
    pub const HEAT: &str = "heat";
    /// Output of XFeat: reliability for each cell, 0..1.
    pub const RELIABILITY: &str = "reliability";
    /// Input of the sampler: the cells' descriptors. Count of the sampler: [`SAMPLES`].
    pub const CELLS: &str = "cells";
    /// Input of the sampler: positions in pixels of the extractor's input.
    pub const POSITIONS: &str = "positions";
    /// Count of samples.
    pub const SAMPLES: &str = "samples";
}
