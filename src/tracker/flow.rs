//! Points of one picture found in another: the tracker's patches by themselves, without poses.

use super::patch::{Back, IDENTITY, Template};
use super::pyramid::Pyramid;
use super::reference::{index_coordinates, pixel_at};
use crate::geometry::Pixel;
use crate::image::{GrayView, ImageError};
use crate::simd::Level;

/// Buffers for pairs of pictures.
#[derive(Debug, Default)]
pub struct PointFlow {
    from: Pyramid,
    to: Pyramid,
    template: Template,
    back: Back,
}

/// Where a point went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flow {
    /// In the second picture.
    pub pixel: Pixel,
    /// Correlation of the grey levels of the two patches, -1..1.
    pub correlation: f32,
    /// How far from the point the way back ends, in pixels; infinite where it ends nowhere.
    pub way_back_px: f32,
}

impl PointFlow {
    /// Takes a pair of pictures.
    ///
    /// # Errors
    /// [`ImageError`] for a picture that makes no sense.
    pub fn load(
        &mut self,
        from: &GrayView<'_>,
        to: &GrayView<'_>,
        vectors: Level,
    ) -> Result<(), ImageError> {
        from.check()?;
        to.check()?;
        self.from.build(from, vectors);
        self.to.build(to, vectors);
        Ok(())
    }

    /// Finds points of the first picture in the second, each from its own position. `None` for points too near the border, on
    /// too little structure, or not found.
    pub fn find(
        &mut self,
        points: &[Pixel],
        with_way_back: bool,
        vectors: Level,
        flows: &mut Vec<Option<Flow>>,
    ) {
        flows.clear();
        flows.extend(points.iter().map(|point| {
            let start = index_coordinates(*point);
            if !self.template.make(&self.from, start, IDENTITY, vectors) {
                return None;
            }
            let found = self.template.find(&self.to, start, vectors)?;
            let way_back_px = if with_way_back {
                self.template
                    .way_back(&self.to, &found, &mut self.back, vectors)
            } else {
                f32::INFINITY
            };
            Some(Flow {
                pixel: pixel_at(found.position),
                correlation: found.correlation,
                way_back_px,
            })
        }));
    }
}
