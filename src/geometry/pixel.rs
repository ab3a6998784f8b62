//! Positions in an image and the maps between differently sized versions of one image.

use core::marker::PhantomData;

/// Position in an image, corner-based: the centre of the first pixel is (0.5, 0.5). Names say of which image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pixel {
    /// To the right.
    pub x: f64,
    /// Downwards.
    pub y: f64,
}

impl Pixel {
    /// A position from its two coordinates.
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// From coordinates that count pixel centres as integers (OpenCV, LSD, PyTorch index coordinates).
    pub const fn from_index_coordinates(x: f64, y: f64) -> Self {
        Self {
            x: x + 0.5,
            y: y + 0.5,
        }
    }

    /// Distance in pixels.
    pub fn distance(self, other: Self) -> f64 {
        libm::hypot(self.x - other.x, self.y - other.y)
    }
}

/// The image as the camera or file delivered it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {}
/// The resized grey image that detector and extractor work on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Working {}

/// Axis-aligned map between two images of the same content: `x_in_to = scale_x * x_in_from + offset_x`, likewise y.
/// In corner-based pixels a plain resize has no offset.
#[derive(Debug)]
pub struct PixelMap<To, From> {
    /// Size ratio along x.
    pub scale_x: f64,
    /// Size ratio along y.
    pub scale_y: f64,
    /// In pixels of `To`.
    pub offset_x: f64,
    /// In pixels of `To`.
    pub offset_y: f64,
    images: PhantomData<(To, From)>,
}

/// From the sensor image into the working image.
pub type WorkingFromSensor = PixelMap<Working, Sensor>;

impl<To, From> Clone for PixelMap<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<To, From> Copy for PixelMap<To, From> {}

impl<To, From> PixelMap<To, From> {
    /// A resize by the given factors.
    pub const fn from_scale(scale_x: f64, scale_y: f64) -> Self {
        Self {
            scale_x,
            scale_y,
            offset_x: 0.0,
            offset_y: 0.0,
            images: PhantomData,
        }
    }

    /// Maps a position.
    pub fn apply(&self, p: Pixel) -> Pixel {
        Pixel::new(
            self.scale_x * p.x + self.offset_x,
            self.scale_y * p.y + self.offset_y,
        )
    }

    /// The map in the other direction.
    pub fn inverse(&self) -> PixelMap<From, To> {
        PixelMap {
            scale_x: 1.0 / self.scale_x,
            scale_y: 1.0 / self.scale_y,
            offset_x: -self.offset_x / self.scale_x,
            offset_y: -self.offset_y / self.scale_y,
            images: PhantomData,
        }
    }
}
