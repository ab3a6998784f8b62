//! What the caller can choose, and what a frame comes with.

use super::smoothing::Smoothing;
use crate::features::KeypointParams;
use crate::geometry::Camera;
use crate::lsd::LsdParams;
use crate::models::ExtractorKind;
use crate::nn::cpu::Level;
use crate::pose::{Gravity, PoseOptions};

/// Options of a [`super::Relocalizer`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelocalizerOptions {
    /// Longest side of the working image in pixels. The scene file's own value is best.
    pub max_side: usize,
    /// Selection of keypoints.
    pub keypoints: KeypointParams,
    /// Line segment detector.
    pub lsd: LsdParams,
    /// Shorter segments are dropped; pixels of the working image.
    pub min_segment_px: f64,
    /// Most segments of a frame; the longest are kept.
    pub max_segments: usize,
    /// Most points that the solver gets: the most confident.
    pub max_points: usize,
    /// Most lines that the solver gets.
    pub max_lines: usize,
    /// The solver; thresholds are in pixels of the working image.
    pub pose: PoseOptions,
    /// Smoothing of displayed poses.
    pub smoothing: Smoothing,
    /// Kernels of the networks on the CPU. [`Level::Portable`] gives the same bits on every machine and in the browser.
    pub kernels: Level,
}

impl RelocalizerOptions {
    /// Defaults for scenes of an extractor.
    pub fn new(extractor: ExtractorKind) -> Self {
        Self {
            max_side: 640,
            keypoints: KeypointParams {
                max_keypoints: 1024,
                ..KeypointParams::published(extractor)
            },
            lsd: LsdParams::default(),
            min_segment_px: 20.0,
            max_segments: 300,
            // On RedKitchen 800-899 this locates all pictures within 5 cm and 5 degrees where 300 and 150 leave one out;
            // the solver takes 25 instead of 14 ms.
            max_points: 600,
            max_lines: 300,
            // Hopeless frames use up all iterations: with 100,000 they would cost seconds. Good ones stop after hundreds.
            pose: PoseOptions {
                max_iterations: 10_000,
                ..PoseOptions::default()
            },
            smoothing: Smoothing::Off,
            kernels: Level::best(),
        }
    }
}

/// How the intrinsics of a frame came to be known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraSource {
    /// By the caller, as exact.
    Given,
    /// By the camera's own settings.
    Track,
    /// By the picture's EXIF block: a few percent off.
    Exif,
    /// From earlier frames of the same camera.
    Remembered,
    /// Solved from this frame.
    Estimated,
    /// A guess.
    Assumed,
}

impl CameraSource {
    /// Relative standard deviation of the focal length, where the source is not exact.
    pub(super) fn sigma_ln(self) -> Option<f64> {
        match self {
            Self::Given | Self::Track => None,
            // EXIF gives whole millimetres of the 35 mm equivalent: half a step of 26 is 2 %, and crops add to it.
            Self::Exif => Some(0.05),
            Self::Remembered | Self::Estimated | Self::Assumed => Some(0.25),
        }
    }
}

/// What is known about one frame besides its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Query<'a> {
    /// Intrinsics in pixels of the frame; `None` when unknown.
    pub camera: Option<Camera>,
    /// Where they come from.
    pub camera_source: CameraSource,
    /// Name under which the focal length is remembered; empty for none.
    pub camera_name: &'a str,
    /// Time of the frame.
    pub timestamp_ms: f64,
    /// Treat the frame as the next one of a moving camera.
    pub tracking: bool,
    /// Direction of gravity, if a sensor tells.
    pub gravity: Option<Gravity>,
}

impl Default for Query<'_> {
    fn default() -> Self {
        Self {
            camera: None,
            camera_source: CameraSource::Given,
            camera_name: "",
            timestamp_ms: 0.0,
            tracking: false,
            gravity: None,
        }
    }
}

impl Query<'_> {
    /// A single picture of a known camera.
    pub fn with_camera(camera: Camera) -> Self {
        Self {
            camera: Some(camera),
            ..Self::default()
        }
    }
}
