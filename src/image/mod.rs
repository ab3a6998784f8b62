//! Pictures: borrowed frames and grey views with a stride, an owned grey image, luma conversion and resizing.
//!
//! Input and output: [`FrameView`] in, [`GrayImage`] and a [`PixelMap`](crate::geometry::PixelMap) out.
//! Units: grey levels 0..=255; positions are corner-based pixels, so a plain resize is a scale without an offset.
//! Algorithm: luma by the Rec. 601 weights in 16-bit fixed point; area (box) averaging to shrink, bilinear
//! interpolation with half-pixel centres to enlarge or to feed networks that were trained that way.
//! Invariants: rows of a [`GrayImage`] are tight; the same picture gives the same bytes on every platform.
//! Cost: one pass over the source; nothing is allocated once the output image has its size.

mod luma;
mod resize;

pub use luma::gray_from_frame;
pub use resize::{resize_area, resize_bilinear, working_from_gray, working_size};

use thiserror::Error;

/// Longest side of a picture that is accepted, in pixels.
pub const MAX_SIDE: usize = 16_384;
/// Largest number of pixels of a picture that is accepted. Choice: 8192 x 8192, above any camera in a browser.
pub const MAX_PIXELS: usize = 1 << 26;

/// Why a picture is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ImageError {
    /// Width or height is zero.
    #[error("the picture is {width}x{height} pixels; both sides must be at least 1")]
    Empty {
        /// In pixels.
        width: usize,
        /// In pixels.
        height: usize,
    },
    /// A side or the number of pixels is over the limit.
    #[error(
        "the picture is {width}x{height} pixels; at most {MAX_SIDE} a side and {MAX_PIXELS} in all are accepted: resize it first"
    )]
    TooLarge {
        /// In pixels.
        width: usize,
        /// In pixels.
        height: usize,
    },
    /// The stride is less than one row.
    #[error(
        "the stride of {stride} is less than one row, {row} ({width} pixels); the stride counts from row to row"
    )]
    StrideTooSmall {
        /// Distance from row to row, in bytes (in samples for real-valued images).
        stride: usize,
        /// What one row needs, in the same unit.
        row: usize,
        /// In pixels.
        width: usize,
    },
    /// The buffer ends before the last pixel.
    #[error(
        "the buffer holds {len} but {needed} are needed for {width}x{height} pixels with stride {stride}"
    )]
    BufferTooShort {
        /// What the buffer holds, in bytes (in samples for real-valued images).
        len: usize,
        /// The least that is needed, in the same unit.
        needed: usize,
        /// In pixels.
        width: usize,
        /// In pixels.
        height: usize,
        /// Distance from row to row.
        stride: usize,
    },
    /// The buffer goes on after the last row: size or format do not belong to it.
    #[error(
        "the buffer holds {len} bytes but {width}x{height} pixels with stride {stride} end at {end}: check size and pixel format, or pass only this picture's bytes"
    )]
    BufferTooLong {
        /// What the buffer holds, in bytes.
        len: usize,
        /// Where the last row ends, padding included.
        end: usize,
        /// In pixels.
        width: usize,
        /// In pixels.
        height: usize,
        /// Distance from row to row.
        stride: usize,
    },
    /// `working_from_gray` was asked for a longest side of zero.
    #[error("the longest side of the working image must be at least 1 pixel")]
    ZeroMaxSide,
}

/// Layout of a frame's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// One byte a pixel.
    Luma8,
    /// Red, green, blue, alpha; alpha is ignored.
    Rgba8,
    /// Red, green, blue.
    Rgb8,
}

impl PixelFormat {
    /// Bytes of one pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Luma8 => 1,
            Self::Rgb8 => 3,
            Self::Rgba8 => 4,
        }
    }
}

/// A picture as it came from a camera or file, borrowed.
#[derive(Debug, Clone, Copy)]
pub struct FrameView<'a> {
    /// Rows of `stride` bytes; the padding of the last row may be missing.
    pub bytes: &'a [u8],
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// Layout of the bytes.
    pub format: PixelFormat,
}

impl<'a> FrameView<'a> {
    /// A frame whose rows follow each other without padding.
    pub const fn tight(bytes: &'a [u8], width: u32, height: u32, format: PixelFormat) -> Self {
        Self {
            bytes,
            width,
            height,
            stride: (width as usize).saturating_mul(format.bytes_per_pixel()),
            format,
        }
    }

    /// Checks size, stride and buffer length against each other.
    ///
    /// # Errors
    /// Any [`ImageError`] but `ZeroMaxSide`. Unlike a [`GrayView`], a frame must not be followed by other bytes:
    /// that is how a wrong pixel format or size shows.
    pub fn check(&self) -> Result<(), ImageError> {
        let (width, height) = (self.width as usize, self.height as usize);
        let row = width.saturating_mul(self.format.bytes_per_pixel());
        check_layout(self.bytes.len(), width, height, self.stride, row)?;
        let end = self.stride.saturating_mul(height);
        if self.bytes.len() > end {
            return Err(ImageError::BufferTooLong {
                len: self.bytes.len(),
                end,
                width,
                height,
                stride: self.stride,
            });
        }
        Ok(())
    }
}

/// A grey image, borrowed: one byte a pixel, rows of `stride` bytes. May be a window into a larger image.
#[derive(Debug, Clone, Copy)]
pub struct GrayView<'a> {
    /// At least `stride * (height - 1) + width` bytes.
    pub data: &'a [u8],
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// Bytes from one row to the next.
    pub stride: usize,
}

impl<'a> GrayView<'a> {
    /// A view whose rows follow each other without padding.
    pub const fn tight(data: &'a [u8], width: usize, height: usize) -> Self {
        Self {
            data,
            width,
            height,
            stride: width,
        }
    }

    /// Checks size, stride and buffer length against each other. Bytes after the last pixel are allowed.
    ///
    /// # Errors
    /// `Empty`, `TooLarge`, `StrideTooSmall` or `BufferTooShort`.
    pub fn check(&self) -> Result<(), ImageError> {
        check_layout(
            self.data.len(),
            self.width,
            self.height,
            self.stride,
            self.width,
        )
    }

    /// The rows of a view that has passed [`check`](Self::check), each `width` long.
    pub(crate) fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride..][..self.width]
    }
}

/// Refuses a size over the limits; for decoders, before they allocate for what a header declares.
///
/// # Errors
/// [`ImageError::Empty`] or [`ImageError::TooLarge`].
pub fn check_size(width: usize, height: usize) -> Result<(), ImageError> {
    if width == 0 || height == 0 {
        return Err(ImageError::Empty { width, height });
    }
    if width > MAX_SIDE || height > MAX_SIDE || width * height > MAX_PIXELS {
        return Err(ImageError::TooLarge { width, height });
    }
    Ok(())
}

/// Shared by all views; `row` is what one row needs in units of `stride` and `len`.
pub(crate) fn check_layout(
    len: usize,
    width: usize,
    height: usize,
    stride: usize,
    row: usize,
) -> Result<(), ImageError> {
    check_size(width, height)?;
    if stride < row {
        return Err(ImageError::StrideTooSmall { stride, row, width });
    }
    let needed = stride.saturating_mul(height - 1).saturating_add(row);
    if len < needed {
        return Err(ImageError::BufferTooShort {
            len,
            needed,
            width,
            height,
            stride,
        });
    }
    Ok(())
}

/// A grey image, owned and reused from frame to frame; rows are tight.
#[derive(Debug, Clone, Default)]
pub struct GrayImage {
    /// `width * height` bytes.
    pub data: Vec<u8>,
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
}

impl GrayImage {
    /// As the frame of a camera that delivers grey.
    pub fn frame(&self) -> FrameView<'_> {
        // A side that does not fit is far beyond what `FrameView::check` accepts.
        let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
        let (width, height) = (side(self.width), side(self.height));
        FrameView::tight(&self.data, width, height, PixelFormat::Luma8)
    }

    /// Borrow as a view.
    pub fn view(&self) -> GrayView<'_> {
        GrayView::tight(&self.data, self.width, self.height)
    }

    /// The picture turned by 90 degrees clockwise.
    pub fn turned_clockwise(&self) -> Self {
        let columns = 0..self.width;
        let data = columns.flat_map(|x| {
            let upwards = (0..self.height).rev();
            upwards.map(move |y| self.data[y * self.width + x])
        });
        Self {
            data: data.collect(),
            width: self.height,
            height: self.width,
        }
    }

    /// The picture as seen in a mirror: left and right change places.
    pub fn mirrored(&self) -> Self {
        let rows = self.data.chunks_exact(self.width.max(1));
        Self {
            data: rows.flat_map(|row| row.iter().rev().copied()).collect(),
            ..*self
        }
    }

    /// Gives the image a size. What the pixels hold afterwards is unspecified; memory is kept for reuse.
    pub(crate) fn set_size(&mut self, width: usize, height: usize) {
        self.width = width;
        self.height = height;
        self.data.resize(width * height, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(len: usize, width: u32, height: u32, stride: usize) -> Result<(), ImageError> {
        FrameView {
            bytes: &vec![0; len],
            width,
            height,
            stride,
            format: PixelFormat::Rgba8,
        }
        .check()
    }

    #[test]
    fn a_quarter_turn_brings_the_left_column_up() {
        let image = GrayImage {
            data: vec![1, 2, 3, 4, 5, 6],
            width: 3,
            height: 2,
        };
        let turned = image.turned_clockwise();
        assert_eq!((turned.width, turned.height), (2, 3));
        assert_eq!(turned.data, [4, 1, 5, 2, 6, 3]);
        let mirrored = image.mirrored();
        assert_eq!((mirrored.width, mirrored.height), (3, 2));
        assert_eq!(mirrored.data, [3, 2, 1, 6, 5, 4]);
    }

    #[test]
    fn layout_errors_name_what_disagrees() {
        assert_eq!(frame(24, 3, 2, 12), Ok(()));
        assert_eq!(frame(12 + 16, 3, 2, 16), Ok(()), "last row unpadded");
        assert_eq!(frame(32, 3, 2, 16), Ok(()), "last row padded");
        assert_eq!(
            frame(0, 0, 2, 12),
            Err(ImageError::Empty {
                width: 0,
                height: 2
            })
        );
        assert_eq!(
            frame(24, 3, 2, 11),
            Err(ImageError::StrideTooSmall {
                stride: 11,
                row: 12,
                width: 3
            })
        );
        assert_eq!(
            frame(23, 3, 2, 12),
            Err(ImageError::BufferTooShort {
                len: 23,
                needed: 24,
                width: 3,
                height: 2,
                stride: 12
            })
        );
        assert_eq!(
            frame(25, 3, 2, 12),
            Err(ImageError::BufferTooLong {
                len: 25,
                end: 24,
                width: 3,
                height: 2,
                stride: 12
            })
        );
        for (width, height) in [
            (MAX_SIDE as u32 + 1, 1),
            (u32::MAX, u32::MAX),
            (16_384, 16_384),
        ] {
            assert!(
                matches!(
                    frame(24, width, height, usize::MAX),
                    Err(ImageError::TooLarge { .. })
                ),
                "{width}x{height}"
            );
        }
    }

    #[test]
    fn gray_view_may_be_a_window() {
        let data = [0; 10];
        let view = GrayView {
            data: &data[3..],
            width: 2,
            height: 2,
            stride: 5,
        };
        assert_eq!(view.check(), Ok(()));
        assert!(
            GrayView {
                data: &data[4..],
                ..view
            }
            .check()
            .is_err()
        );
    }
}
