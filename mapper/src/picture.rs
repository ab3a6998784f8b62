//! Pictures from files: decoded to grey or RGB, turned upright by their EXIF orientation.

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader};
use landline::image::{FrameView, GrayImage, ImageError, PixelFormat, gray_from_frame};
use std::path::{Path, PathBuf};

/// Why a picture could not be read.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file is missing or unreadable.
    #[error("cannot open picture {path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// From the operating system.
        source: std::io::Error,
    },
    /// The file is no picture of a known format, or damaged.
    #[error("cannot decode picture {path}: {source}")]
    Decode {
        /// The file.
        path: PathBuf,
        /// From the decoder.
        source: image::ImageError,
    },
    /// Decoded, but of a size that the core does not accept.
    #[error("picture {path}: {source}")]
    Refused {
        /// The file.
        path: PathBuf,
        /// From the core.
        source: ImageError,
    },
}

impl PictureError {
    /// What went wrong without the path, so that equal reasons can be counted.
    pub fn short(&self) -> String {
        match self {
            Self::Open { source, .. } => source.kind().to_string(),
            Self::Decode { source, .. } => source.to_string(),
            Self::Refused { source, .. } => source.to_string(),
        }
    }
}

/// Size and orientation of a picture, from its header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Width and height of the pixels as stored.
    pub stored: (u32, u32),
    /// Width and height after turning upright.
    pub upright: (u32, u32),
    /// Clockwise turns by 90 degrees that make it upright.
    pub quarter_turns: u8,
    /// EXIF asks for a flip, which no pose can express.
    pub is_mirrored: bool,
}

/// Reads the header of a picture.
///
/// # Errors
/// When the file cannot be opened or is no picture.
pub fn size(path: &Path) -> Result<Size, PictureError> {
    let mut decoder = decoder(path)?;
    let stored = decoder.dimensions();
    let orientation = decoder
        .orientation()
        .map_err(|source| PictureError::Decode {
            path: path.to_owned(),
            source,
        })?;
    let (quarter_turns, is_mirrored) = match orientation {
        Orientation::NoTransforms => (0, false),
        Orientation::Rotate90 => (1, false),
        Orientation::Rotate180 => (2, false),
        Orientation::Rotate270 => (3, false),
        _ => (0, true),
    };
    let upright = if quarter_turns % 2 == 1 {
        (stored.1, stored.0)
    } else {
        stored
    };
    Ok(Size {
        stored,
        upright,
        quarter_turns,
        is_mirrored,
    })
}

fn decoder(path: &Path) -> Result<impl ImageDecoder + use<>, PictureError> {
    let open = |source| PictureError::Open {
        path: path.to_owned(),
        source,
    };
    ImageReader::open(path)
        .map_err(open)?
        .with_guessed_format()
        .map_err(open)?
        .into_decoder()
        .map_err(|source| PictureError::Decode {
            path: path.to_owned(),
            source,
        })
}

/// Decodes a picture and turns it upright by its EXIF orientation.
///
/// # Errors
/// When the file cannot be opened or decoded.
pub fn read(path: &Path) -> Result<DynamicImage, PictureError> {
    let decode = |source| PictureError::Decode {
        path: path.to_owned(),
        source,
    };
    let mut decoder = decoder(path)?;
    let orientation = decoder.orientation().map_err(decode)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(decode)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// Decodes a picture to grey, by the same luma as a frame in the browser.
///
/// # Errors
/// When the file cannot be opened or decoded, or the picture is larger than the core accepts.
pub fn read_gray(path: &Path) -> Result<GrayImage, PictureError> {
    let picture = read(path)?;
    let mut gray = GrayImage::default();
    let (width, height) = (picture.width(), picture.height());
    let (bytes, format) = match picture {
        DynamicImage::ImageLuma8(luma) => (luma.into_raw(), PixelFormat::Luma8),
        other => (other.into_rgb8().into_raw(), PixelFormat::Rgb8),
    };
    let frame = FrameView::tight(&bytes, width, height, format);
    gray_from_frame(&frame, &mut gray).map_err(|source| PictureError::Refused {
        path: path.to_owned(),
        source,
    })?;
    Ok(gray)
}

/// Writes a PNG; the file appears whole or not at all.
///
/// # Errors
/// When the disk refuses.
pub fn write_png(picture: &image::RgbImage, path: &Path) -> std::io::Result<()> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture
        .write_to(&mut bytes, image::ImageFormat::Png)
        .map_err(std::io::Error::other)?;
    crate::files::write_bytes(path, bytes.get_ref())
}
