//! Features of training pictures with their 3D targets: what training starts from.
//!
//! Pixels are corner-based pixels of the picture as read, descriptors are as the extractor delivered them (points: unit
//! vectors). World coordinates are those of the data set. A segment's target may run against the segment's direction:
//! [`SegmentTarget::reversed`] says so, and [`Labels::segment_target_ends`] returns the ends in the segment's order.

mod build;
mod file;
mod import;
mod select;
mod variants;

pub use build::{LabelError, LabelParams, LabelStats, build, build_from};
pub use file::LabelFileError;
pub use import::Imported;
pub use select::cover;
pub use variants::{VariantStats, add_variants};

use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
use nalgebra::Vector3;

/// Where a track was seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Observation {
    /// Index into [`Labels::images`].
    pub image: u32,
    /// Index of the keypoint or segment in that image.
    pub feature: u32,
}

/// One 3D point and the keypoints that see it.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTrack {
    /// Triangulated position.
    pub point_in_world: Vector3<f64>,
    /// At least two, sorted by image.
    pub observations: Vec<Observation>,
    /// Mean of the observations' descriptors, of unit length.
    pub descriptor: Vec<f32>,
    /// Mean reprojection error over the observations.
    pub mean_error_px: f32,
}

/// One 3D segment and the image segments that see it.
#[derive(Debug, Clone, PartialEq)]
pub struct LineTrack {
    /// One end; which one is arbitrary.
    pub start_in_world: Vector3<f64>,
    /// The other end.
    pub end_in_world: Vector3<f64>,
    /// At least two, sorted by image.
    pub observations: Vec<Observation>,
    /// Mean over observations and samples of the segment descriptors, of unit length.
    pub descriptor: Vec<f32>,
    /// Mean distance of the observed ends to the projected infinite line.
    pub mean_error_px: f32,
}

/// A segment's 3D target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SegmentTarget {
    /// Index into [`Labels::lines`].
    pub track: u32,
    /// The track's end belongs to the segment's start.
    pub reversed: bool,
}

/// One training picture: features, camera, targets.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledImage {
    /// As the data set calls it.
    pub name: String,
    /// Of the picture as read.
    pub camera: Camera,
    /// From the data set.
    pub cam_from_world: CamFromWorld,
    /// Keypoints.
    pub pixels: Vec<Pixel>,
    /// Detector score of each keypoint.
    pub scores: Vec<f32>,
    /// `pixels.len()` rows of [`Labels::descriptor_len`].
    pub descriptors_nd: Vec<f32>,
    /// Index into [`Labels::points`] for each keypoint that has a target.
    pub point_targets: Vec<Option<u32>>,
    /// Detected segments.
    pub segments: Vec<Segment2>,
    /// `segments.len()` x [`Labels::samples_per_segment`] rows of [`Labels::descriptor_len`], start to end.
    pub segment_descriptors_nsd: Vec<f32>,
    /// Target of each segment that has one.
    pub segment_targets: Vec<Option<SegmentTarget>>,
}

/// Tracks and labelled pictures of one scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// Numbers in a descriptor.
    pub descriptor_len: usize,
    /// Samples along a segment, both ends included; 12 unless the file says otherwise.
    pub samples_per_segment: usize,
    /// Identity of the extractor, as a scene file writes it.
    pub extractor: String,
    /// 3D points.
    pub points: Vec<PointTrack>,
    /// 3D segments.
    pub lines: Vec<LineTrack>,
    /// Pictures in the data set's order.
    pub images: Vec<LabelledImage>,
    /// Changed copies of the pictures, for training only: no track counts them among its observations.
    pub variants: Vec<LabelledVariant>,
}

/// A picture that was turned, scaled, blurred or lit differently before its features were taken.
///
/// Features lie where they are in the unchanged picture, with that picture's camera and pose: what a network predicts does
/// not depend on where in the image a feature was, so reprojection needs no changed camera.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledVariant {
    /// Index into [`Labels::images`].
    pub of_image: u32,
    /// Features and targets.
    pub image: LabelledImage,
}

impl Labels {
    /// The 3D ends of a segment's target in the order of the segment's own ends.
    pub fn segment_target_ends(&self, target: SegmentTarget) -> Option<[Vector3<f64>; 2]> {
        let line = self.lines.get(target.track as usize)?;
        Some(if target.reversed {
            [line.end_in_world, line.start_in_world]
        } else {
            [line.start_in_world, line.end_in_world]
        })
    }
}
