//! Grey pictures at falling sizes, and the last few of them.
//!
//! Positions in a level are index coordinates (the centre of the first pixel is (0, 0)): sample `i` of a level lies over sample
//! `2 i` of the one below, so a position is halved from level to level and nothing is added.

use super::kernels::{Halving, halve};
use crate::image::GrayView;
use crate::simd::Level as Vectors;

/// Levels, the picture itself among them.
pub(super) const LEVELS: usize = 4;
/// Border around each level. The largest thing that is cut out of a picture reaches 13 pixels from its centre, so whatever is
/// centred on a pixel lies inside.
pub(super) const BORDER: usize = 16;

/// A grey picture with a mirrored border, so that patches near its edge need no care.
#[derive(Debug, Clone, Default)]
pub(super) struct Bordered {
    /// All rows, those of the border too, without gaps.
    data: Vec<u8>,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Bordered {
    /// The picture without its border.
    pub(super) fn view(&self) -> GrayView<'_> {
        let stride = self.stride();
        GrayView {
            data: self.data.get(BORDER * stride + BORDER..).unwrap_or(&[]),
            width: self.width,
            height: self.height,
            stride,
        }
    }

    /// The picture with its border: its first pixel is that of [`Self::view`] less [`BORDER`] both ways.
    pub(super) fn whole(&self) -> GrayView<'_> {
        GrayView::tight(&self.data, self.stride(), self.height + 2 * BORDER)
    }

    fn stride(&self) -> usize {
        self.width + 2 * BORDER
    }

    fn set_size(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        let len = self.stride() * (height + 2 * BORDER);
        self.data.resize(len, 0);
    }

    fn row_mut(&mut self, y: usize) -> &mut [u8] {
        let start = (y + BORDER) * self.stride() + BORDER;
        &mut self.data[start..][..self.width]
    }

    /// Fills the border.
    fn mirror(&mut self) {
        let (stride, width, height) = (self.stride(), self.width, self.height);
        for row in self.data.chunks_exact_mut(stride).skip(BORDER).take(height) {
            for beyond in 1..=BORDER {
                row[BORDER - beyond] = row[BORDER + mirrored(-(beyond as isize), width)];
                let after = width - 1 + beyond;
                row[BORDER + after] = row[BORDER + mirrored(after as isize, width)];
            }
        }
        let rows = (-(BORDER as isize)..0).chain(height as isize..(height + BORDER) as isize);
        for row in rows {
            let from = (BORDER + mirrored(row, height)) * stride;
            let to = (row + BORDER as isize) as usize * stride;
            self.data.copy_within(from..from + stride, to);
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.data.clone_from(&other.data);
        (self.width, self.height) = (other.width, other.height);
    }
}

/// Index inside `0..len` that stands for one outside, mirrored without repeating the first or last pixel.
fn mirrored(i: isize, len: usize) -> usize {
    if len < 2 {
        return 0;
    }
    let last = len as isize - 1;
    let i = i.rem_euclid(2 * last);
    i.min(2 * last - i) as usize
}

/// A grey picture and its halves.
#[derive(Debug, Clone, Default)]
pub(super) struct Pyramid {
    levels: [Bordered; LEVELS],
    even: Vec<u16>,
    odd: Vec<u16>,
}

impl Pyramid {
    /// Takes a picture by value of its bytes and makes the levels above it. No allocation once a picture of the size was seen.
    /// The same on every machine.
    pub(super) fn build(&mut self, gray: &GrayView<'_>, vectors: Vectors) {
        self.levels[0].set_size(gray.width, gray.height);
        for y in 0..gray.height {
            self.levels[0].row_mut(y).copy_from_slice(gray.row(y));
        }
        self.levels[0].mirror();
        for level in 1..LEVELS {
            let (below, above) = self.levels.split_at_mut(level);
            let (below, above) = (&below[level - 1], &mut above[0]);
            above.set_size(below.width.div_ceil(2), below.height.div_ceil(2));
            let stride = below.stride();
            for y in 0..above.height {
                // Two rows and columns before those of the same place, which the border always has.
                let first = (BORDER + 2 * y - 2) * stride + BORDER - 2;
                let work = Halving {
                    below: &below.data[first..],
                    stride,
                    even: &mut self.even,
                    odd: &mut self.odd,
                    above: above.row_mut(y),
                };
                halve(vectors, work);
            }
            above.mirror();
        }
    }

    /// Takes another one; no allocation once one of its size was there.
    pub(super) fn copy_from(&mut self, other: &Self) {
        for (to, from) in self.levels.iter_mut().zip(&other.levels) {
            to.copy_from(from);
        }
    }

    pub(super) fn level(&self, level: usize) -> &Bordered {
        &self.levels[level]
    }

    /// Width and height of the picture.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.levels[0].width, self.levels[0].height)
    }
}

/// The last pyramids by number of frame, in a ring; one that is held is not written over.
#[derive(Debug)]
pub(super) struct Ring {
    slots: Vec<Slot>,
}

#[derive(Debug, Default)]
struct Slot {
    pyramid: Pyramid,
    frame: u64,
    is_filled: bool,
    is_held: bool,
}

impl Ring {
    pub(super) fn new(len: usize) -> Self {
        Self {
            slots: (0..len.max(2)).map(|_| Slot::default()).collect(),
        }
    }

    /// Forgets all pictures; their memory stays.
    pub(super) fn clear(&mut self) {
        for slot in &mut self.slots {
            (slot.is_filled, slot.is_held) = (false, false);
        }
    }

    /// Makes the pyramid of a frame in the oldest slot.
    pub(super) fn push(&mut self, frame: u64, gray: &GrayView<'_>, vectors: Vectors) {
        let oldest = self
            .slots
            .iter_mut()
            .min_by_key(|slot| (slot.is_held, slot.is_filled, slot.frame));
        if let Some(slot) = oldest {
            slot.pyramid.build(gray, vectors);
            (slot.frame, slot.is_filled, slot.is_held) = (frame, true, false);
        }
    }

    /// Keeps a frame until [`Self::release`], or until it is the only one left to write over.
    pub(super) fn hold(&mut self, frame: u64) -> bool {
        let slot = self
            .slots
            .iter_mut()
            .find(|s| s.is_filled && s.frame == frame);
        slot.map(|slot| slot.is_held = true).is_some()
    }

    /// Lets go of every frame up to this one.
    pub(super) fn release(&mut self, up_to: u64) {
        for slot in &mut self.slots {
            slot.is_held &= slot.frame > up_to;
        }
    }

    pub(super) fn get(&self, frame: u64) -> Option<&Pyramid> {
        self.slots
            .iter()
            .find(|slot| slot.is_filled && slot.frame == frame)
            .map(|slot| &slot.pyramid)
    }

    /// The newest frame that is there and not after the given one.
    pub(super) fn at_most(&self, frame: u64) -> Option<u64> {
        let frames = self.slots.iter().filter(|slot| slot.is_filled);
        frames.map(|slot| slot.frame).filter(|f| *f <= frame).max()
    }

    /// Bytes of all pictures.
    pub(super) fn bytes(&self) -> usize {
        let levels = self.slots.iter().flat_map(|slot| &slot.pyramid.levels);
        levels.map(|level| level.data.capacity()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    /// The definition, sample by sample.
    fn halved(image: &GrayView<'_>, x: usize, y: usize) -> u8 {
        let mirror = |i: i64, len: usize| {
            let mut i = i;
            let last = len as i64 - 1;
            while i < 0 || i > last {
                i = if i < 0 { -i } else { 2 * last - i };
                if last == 0 {
                    i = 0;
                }
            }
            i as usize
        };
        let taps = [1_u32, 4, 6, 4, 1];
        let mut sum = 0;
        for (j, wy) in taps.iter().enumerate() {
            for (i, wx) in taps.iter().enumerate() {
                let column = mirror(2 * x as i64 + i as i64 - 2, image.width);
                let row = mirror(2 * y as i64 + j as i64 - 2, image.height);
                sum += wx * wy * u32::from(image.row(row)[column]);
            }
        }
        ((sum + 128) >> 8) as u8
    }

    #[test]
    fn levels_are_binomial_means() {
        let mut rng = Rng::from_seed(3);
        for (width, height) in [(64, 48), (33, 17), (5, 4), (3, 3), (2, 2), (1, 1)] {
            let data: Vec<u8> = (0..width * height)
                .map(|_| rng.range(0.0, 256.0) as u8)
                .collect();
            for vectors in Vectors::available() {
                let mut pyramid = Pyramid::default();
                pyramid.build(&GrayView::tight(&data, width, height), vectors);
                for level in 1..LEVELS {
                    let (below, above) = (pyramid.level(level - 1), pyramid.level(level));
                    let (below, above) = (below.view(), above.view());
                    assert_eq!(above.width, below.width.div_ceil(2));
                    for y in 0..above.height {
                        for x in 0..above.width {
                            let (expected, found) = (halved(&below, x, y), above.row(y)[x]);
                            assert_eq!(found, expected, "{width}x{height} {level} {x} {y}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn borders_are_mirrored() {
        let mut rng = Rng::from_seed(4);
        for (width, height) in [(40, 30), (9, 5), (2, 1)] {
            let data: Vec<u8> = (0..width * height)
                .map(|_| rng.range(0.0, 256.0) as u8)
                .collect();
            let mut pyramid = Pyramid::default();
            pyramid.build(&GrayView::tight(&data, width, height), Vectors::Portable);
            let whole = pyramid.level(0).whole();
            // Step by step from the pixel inside, turning round at the ends.
            let walk = |len: usize| {
                let mut at = vec![0; BORDER + len + BORDER];
                for (beyond, at) in at.iter_mut().enumerate() {
                    let (mut i, mut step) = (0_isize, if beyond < BORDER { -1 } else { 1 });
                    for _ in 0..beyond.abs_diff(BORDER) {
                        if !(0..len as isize).contains(&(i + step)) {
                            step = -step;
                        }
                        i = (i + step).clamp(0, len as isize - 1);
                    }
                    *at = i as usize;
                }
                at
            };
            for (y, row) in walk(height).into_iter().enumerate() {
                for (x, column) in walk(width).into_iter().enumerate() {
                    let expected = data[row * width + column];
                    assert_eq!(whole.row(y)[x], expected, "{width}x{height} {x} {y}");
                }
            }
        }
    }

    #[test]
    fn what_is_held_stays() {
        let gray = [7; 16];
        let view = GrayView::tight(&gray, 4, 4);
        let mut ring = Ring::new(3);
        for frame in 0..3 {
            ring.push(frame, &view, Vectors::Portable);
        }
        assert!(ring.hold(0));
        for frame in 3..9 {
            ring.push(frame, &view, Vectors::Portable);
        }
        assert!(ring.get(0).is_some() && ring.get(8).is_some() && ring.get(7).is_some());
        assert_eq!(ring.at_most(6), Some(0));
        ring.release(0);
        ring.push(9, &view, Vectors::Portable);
        assert!(ring.get(0).is_none());
        assert!(!ring.hold(0));
    }
}
