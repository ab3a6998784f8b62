//! Pictures from files: decoded to grey or RGB, turned upright by their EXIF orientation.

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

/// Decodes a picture and turns it upright by its EXIF orientation.
///
/// # Errors
/// When the file cannot be opened or decoded.
pub fn read(path: &Path) -> Result<DynamicImage, PictureError> {
    let open = |source| PictureError::Open {
        path: path.to_owned(),
        source,
    };
    let decode = |source| PictureError::Decode {
        path: path.to_owned(),
        source,
    };
    let mut decoder = ImageReader::open(path)
        .map_err(open)?
        .with_guessed_format()
        .map_err(open)?
        .into_decoder()
        .map_err(decode)?;
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
    let frame = FrameView {
        bytes: &bytes,
        width,
        height,
        stride: width as usize * format.bytes_per_pixel(),
        format,
    };
    gray_from_frame(&frame, &mut gray).map_err(|source| PictureError::Refused {
        path: path.to_owned(),
        source,
    })?;
    Ok(gray)
}
