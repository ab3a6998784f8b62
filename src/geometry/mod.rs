//! What a coordinate means: rigid transforms between named spaces, cameras, pixels, segments.
//!
//! Spaces: world (right-handed, metres when metric), camera (x right, y down, z forward), image (corner-based pixels).

mod axes;
mod camera;
mod pixel;
mod scene_scale;
mod segment;
mod similarity;
mod spaces;
mod units;

pub use axes::CameraAxes;
pub use camera::{Camera, CameraError, CameraModel, CameraRecord, ColmapModel};
pub use pixel::{Pixel, PixelMap, Sensor, Working, WorkingFromSensor};
pub use scene_scale::SceneScale;
pub use segment::{ScenePoint, SceneSegment, Segment2};
pub use similarity::Similarity;
pub use spaces::{
    Cam, CamFromWorld, Rigid, World, WorldFromCam, rotation_from_vector, vector_from_rotation,
};
pub use units::Units;
