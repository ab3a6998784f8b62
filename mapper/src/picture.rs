//! Pictures from files: decoded to grey or RGB, turned upright by their EXIF orientation.
//!
//! A header that declares more than the core accepts is refused before anything is allocated for it.

mod folder;
mod whole;

pub use folder::{
    Listed, counted, is_called_picture, is_hidden, is_video, listed, undecoded_ending,
};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use landline::image::{FrameView, GrayImage, ImageError, PixelFormat, check_size, gray_from_frame};
use std::path::{Path, PathBuf};

/// Endings of the formats that are read.
const ENDINGS: [&str; 7] = ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp"];

/// Whether a file is called like a picture that can be read.
pub fn has_known_ending(path: &Path) -> bool {
    path.extension().is_some_and(|e| {
        let ending = e.to_string_lossy().to_ascii_lowercase();
        ENDINGS.contains(&ending.as_str())
    })
}

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
    /// Of a size that the core does not accept.
    #[error("picture {path}: {source}")]
    Refused {
        /// The file.
        path: PathBuf,
        /// From the core.
        source: ImageError,
    },
    /// The file ends before the picture does.
    #[error("picture {path}: {CUT_OFF}")]
    CutOff {
        /// The file.
        path: PathBuf,
    },
    /// A format that needs a decoder which this tool does not have.
    #[error("picture {path}: {}", not_decoded(format))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it is.
        format: &'static str,
    },
}

const CUT_OFF: &str = "the file ends before the picture does; copy it again";

/// That a format is not decoded, and what to do.
fn not_decoded(format: &str) -> String {
    let telephone = if format == "HEIC" {
        "; an iPhone takes JPEGs with Settings > Camera > Formats > Most Compatible"
    } else {
        ""
    };
    format!(
        "{format} pictures are not decoded here; convert them to JPEG (for example with `magick mogrify -format jpg`)\
         {telephone}"
    )
}

/// Whether bytes begin as a picture does, of a format that is decoded here or not.
pub fn is_picture(bytes: &[u8]) -> bool {
    image::guess_format(bytes).is_ok() || whole::undecoded_brand(bytes).is_some()
}

impl PictureError {
    /// What went wrong without the path, so that equal reasons can be counted.
    pub fn short(&self) -> String {
        match self {
            Self::Open { source, .. } => source.kind().to_string(),
            Self::Decode { source, .. } => source.to_string(),
            Self::Refused { source, .. } => source.to_string(),
            Self::CutOff { .. } => CUT_OFF.to_owned(),
            Self::Unsupported { format, .. } => not_decoded(format),
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

/// Reads the header of a picture, and looks whether the file is whole.
///
/// # Errors
/// When the file cannot be opened, is no picture, is larger than the core accepts, or is cut off.
pub fn size(path: &Path) -> Result<Size, PictureError> {
    let (format, mut decoder) = decoder(path)?;
    let stored = decoder.dimensions();
    let orientation = decoder
        .orientation()
        .map_err(|source| PictureError::Decode {
            path: path.to_owned(),
            source,
        })?;
    let is_whole = whole::is_whole(path, format).map_err(|source| PictureError::Open {
        path: path.to_owned(),
        source,
    })?;
    if !is_whole {
        // Some cameras leave the end marker out; only the pixels tell.
        read(path)?;
    }
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

/// A decoder that has read the header, of a picture that is not too large.
fn decoder(path: &Path) -> Result<(ImageFormat, impl ImageDecoder + use<>), PictureError> {
    let open = |source| PictureError::Open {
        path: path.to_owned(),
        source,
    };
    let decode = |source| PictureError::Decode {
        path: path.to_owned(),
        source,
    };
    let by_content = whole::undecoded_format(path).map_err(open)?;
    if let Some(format) = by_content.or_else(|| undecoded_ending(path)) {
        return Err(PictureError::Unsupported {
            path: path.to_owned(),
            format,
        });
    }
    let reader = ImageReader::open(path)
        .map_err(open)?
        .with_guessed_format()
        .map_err(open)?;
    let format = reader.format();
    let decoder = reader.into_decoder().map_err(decode)?;
    let (width, height) = decoder.dimensions();
    check_size(width as usize, height as usize).map_err(|source| PictureError::Refused {
        path: path.to_owned(),
        source,
    })?;
    // A decoder was found by its format.
    Ok((format.unwrap_or(ImageFormat::Png), decoder))
}

/// Decodes a picture and turns it upright by its EXIF orientation.
///
/// # Errors
/// When the file cannot be opened or decoded, is larger than the core accepts, or is cut off.
pub fn read(path: &Path) -> Result<DynamicImage, PictureError> {
    let decode = |source| PictureError::Decode {
        path: path.to_owned(),
        source,
    };
    let (format, mut decoder) = decoder(path)?;
    let orientation = decoder.orientation().map_err(decode)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(decode)?;
    let is_whole = whole::is_whole(path, format).map_err(|source| PictureError::Open {
        path: path.to_owned(),
        source,
    })?;
    if !is_whole && whole::ends_blank(&picture) {
        return Err(PictureError::CutOff {
            path: path.to_owned(),
        });
    }
    fill_depth(&mut picture);
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// Sensors of 10, 12 or 14 bits are often written into 16 without being scaled; such a picture would be read as black.
fn fill_depth(picture: &mut DynamicImage) {
    fn fill(pixels: &mut [u16], channels: usize, colors: usize) {
        let values = || pixels.chunks_exact(channels).flat_map(|p| &p[..colors]);
        let largest = values().copied().max().unwrap_or(0);
        let full = [8, 10, 12, 14].map(|bits| (1_u32 << bits) - 1);
        let Some(full) = full.into_iter().find(|full| u32::from(largest) <= *full) else {
            return;
        };
        for pixel in pixels.chunks_exact_mut(channels) {
            for v in &mut pixel[..colors] {
                *v = (u32::from(*v) * 65_535 / full) as u16;
            }
        }
    }
    match picture {
        DynamicImage::ImageLuma16(p) => fill(p, 1, 1),
        DynamicImage::ImageLumaA16(p) => fill(p, 2, 1),
        DynamicImage::ImageRgb16(p) => fill(p, 3, 3),
        DynamicImage::ImageRgba16(p) => fill(p, 4, 3),
        _ => {}
    }
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
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(std::io::Error::other)?;
    crate::files::write_bytes(path, bytes.get_ref())
}
