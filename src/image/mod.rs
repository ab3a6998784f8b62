//! Frames and grey images: views with a stride, and an owned grey image. Resize and luma live here too.

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

/// A picture as it came from a camera or file, borrowed.
#[derive(Debug, Clone, Copy)]
pub struct FrameView<'a> {
    /// Rows of `stride` bytes.
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

/// A grey image, borrowed: one byte a pixel, rows of `stride` bytes.
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
    /// Borrow as a view.
    pub fn view(&self) -> GrayView<'_> {
        GrayView {
            data: &self.data,
            width: self.width,
            height: self.height,
            stride: self.width,
        }
    }
}
