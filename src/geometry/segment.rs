//! Finite pieces of lines in the image and in the world, and points in the world.

use super::pixel::{Pixel, PixelMap};
use nalgebra::Vector3;

/// Line segment in an image, corner-based pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment2 {
    /// First end. LSD's direction convention: the darker side lies on a fixed side of start to end.
    pub start: Pixel,
    /// Second end.
    pub end: Pixel,
    /// Width of the support rectangle in pixels.
    pub width_px: f64,
    /// Angle tolerance of the support rectangle divided by pi.
    pub precision: f64,
    /// -log10 of the number of false alarms; larger is more meaningful.
    pub neg_log10_nfa: f64,
}

impl Segment2 {
    /// Its numbers in the order in which files keep them: ends (x, y, x, y), width, precision, -log10(NFA).
    pub fn to_numbers(&self) -> [f64; 7] {
        [
            self.start.x,
            self.start.y,
            self.end.x,
            self.end.y,
            self.width_px,
            self.precision,
            self.neg_log10_nfa,
        ]
    }

    /// The segment of [`Self::to_numbers`].
    pub fn from_numbers([x1, y1, x2, y2, width_px, precision, neg_log10_nfa]: [f64; 7]) -> Self {
        Self {
            start: Pixel::new(x1, y1),
            end: Pixel::new(x2, y2),
            width_px,
            precision,
            neg_log10_nfa,
        }
    }

    /// Length in pixels.
    pub fn length_px(&self) -> f64 {
        self.start.distance(self.end)
    }

    /// The same segment in another version of the image. The width scales with the mean factor.
    pub fn mapped<To, From>(&self, map: &PixelMap<To, From>) -> Self {
        Self {
            start: map.apply(self.start),
            end: map.apply(self.end),
            width_px: self.width_px * 0.5 * (map.scale_x + map.scale_y),
            ..*self
        }
    }
}

/// 3D point in the world that a regressor predicts for a keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScenePoint {
    /// Metres when the scene is metric.
    pub point_in_world: Vector3<f64>,
    /// 0..1, what the network believes.
    pub confidence: f32,
}

/// 3D segment in the world that a regressor predicts for an image segment; ends correspond in order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneSegment {
    /// World point for the image segment's start.
    pub start_in_world: Vector3<f64>,
    /// World point for the image segment's end.
    pub end_in_world: Vector3<f64>,
    /// 0..1, what the network believes.
    pub confidence: f32,
}
