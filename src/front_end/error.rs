//! Why a picture has no features.

use crate::features::FeatureError;
use crate::image::ImageError;
use crate::lsd::LsdError;

/// Why a front end cannot be made, or a frame not be processed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrontEndError {
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
    /// Size and bytes of the frame do not agree.
    #[error("frame: {0}")]
    Frame(#[from] ImageError),
    /// The frame is too small or too long and thin for the extractor.
    #[error(
        "a frame of {width}x{height} pixels becomes {working_width}x{working_height} in processing; {min_side} on each side are needed"
    )]
    FrameTooSmall {
        /// Width of the frame.
        width: u32,
        /// Height of the frame.
        height: u32,
        /// Width after resizing.
        working_width: usize,
        /// Height after resizing.
        working_height: usize,
        /// Smallest side.
        min_side: usize,
    },
    /// The segment detector refused.
    #[error("segments: {0}")]
    Segments(#[from] LsdError),
    /// The extractor refused its weights or the picture.
    #[error("extractor: {0}")]
    Extractor(#[from] FeatureError),
}
