//! What can go wrong. That a frame is not located is a result, not an error.

use crate::front_end::FrontEndError;
use crate::geometry::CameraError;
use crate::pose::PoseError;
use crate::regress::RegressError;
use crate::scene_file::SceneFileError;

/// Why a relocalizer cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CreateError {
    /// The scene file is refused, or does not fit the extractor.
    #[error("scene file: {0}")]
    Scene(#[source] SceneFileError),
    /// The extractor's file is refused.
    #[error("extractor file: {0}")]
    Extractor(#[source] SceneFileError),
    /// The extractor's network cannot be built, or an option of the front end has no meaning.
    #[error(transparent)]
    FrontEnd(#[from] FrontEndError),
    /// The scene's networks cannot be built.
    #[error("scene networks: {0}")]
    Networks(#[source] RegressError),
    /// An option has no meaning.
    #[error("option {name} is {value}; it must be {expected}")]
    Option {
        /// Field of the options.
        name: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A sampler that the scene was not taught with.
    #[error("option front_end.sampler is `{found}`; the scene was taught with `{taught}`")]
    Sampler {
        /// What was asked for.
        found: &'static str,
        /// What the scene needs.
        taught: &'static str,
    },
    /// Something that belongs to one frame stands among the options of all.
    #[error("option live.pose.{0} belongs to one frame: pass it with the frame's query")]
    OfAFrame(&'static str),
    /// An option of the solver has no meaning.
    #[error(transparent)]
    Pose(#[from] PoseError),
}

/// Why a frame cannot be processed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LocateError {
    /// The frame has no features.
    #[error(transparent)]
    FrontEnd(#[from] FrontEndError),
    /// The intrinsics make no sense.
    #[error("camera: {0}")]
    Camera(#[from] CameraError),
    /// The intrinsics are for another size of picture.
    #[error(
        "the intrinsics are for {camera_width}x{camera_height} pixels, the frame has {width}x{height}"
    )]
    CameraSize {
        /// Width that the intrinsics are for.
        camera_width: u32,
        /// Height that they are for.
        camera_height: u32,
        /// Width of the frame.
        width: u32,
        /// Height of the frame.
        height: u32,
    },
    /// A step of a frame came after a later frame had taken its place.
    #[error("frame {number} was replaced by a later one before this step")]
    OutOfOrder {
        /// Number of the frame, from 1 on.
        number: u64,
    },
    /// An option of the solver has no meaning.
    #[error("solver: {0}")]
    Pose(#[from] PoseError),
    /// The scene's networks refused.
    #[error("scene networks: {0}")]
    Regress(#[from] RegressError),
}
