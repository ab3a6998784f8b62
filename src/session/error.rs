//! What can go wrong over frames.

use crate::relocalizer::LocateError;

/// Why a session refuses a frame or a camera.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The time of the frame is not a number.
    #[error("the frame's timestamp is {0}")]
    Timestamp(f64),
    /// A focal length that is to be recalled belongs to no camera.
    #[error(
        "camera {camera:?} cannot be recalled with a focal length of {focal_per_width} widths; it must have a name and 0.13 to 20"
    )]
    Recall {
        /// Name of the camera.
        camera: String,
        /// Focal length divided by the width.
        focal_per_width: f64,
    },
    /// The relocalizer refused the frame.
    #[error(transparent)]
    Locate(#[from] LocateError),
}
