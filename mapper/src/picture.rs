//! Pictures from files: decoded to grey or RGB, turned upright by their EXIF orientation.

use image::{DynamicImage, ImageDecoder, ImageReader};
use landline::image::GrayImage;
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
}

/// Decodes a picture and turns it upright by its EXIF orientation.
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

/// Decodes a picture to grey. Colour becomes luma with the weights of ITU-R BT.601, as browsers and OpenCV do.
pub fn read_gray(path: &Path) -> Result<GrayImage, PictureError> {
    let picture = read(path)?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let data = match picture {
        DynamicImage::ImageLuma8(gray) => gray.into_raw(),
        other => other
            .into_rgb8()
            .pixels()
            .map(|p| {
                let [r, g, b] = p.0.map(u32::from);
                // 0.299, 0.587, 0.114 in 14-bit fixed point, rounded.
                ((4899 * r + 9617 * g + 1868 * b + 8192) >> 14) as u8
            })
            .collect(),
    };
    Ok(GrayImage {
        data,
        width,
        height,
    })
}
