//! Grey pictures at falling sizes, and the last few of them.
//!
//! Positions in a level are index coordinates (the centre of the first pixel is (0, 0)): sample `i` of a level lies over sample
//! `2 i` of the one below, so a position is halved from level to level and nothing is added.

use crate::image::{GrayImage, GrayView};

/// Levels, the picture itself among them.
pub(super) const LEVELS: usize = 4;

/// A grey picture and its halves.
#[derive(Debug, Clone, Default)]
pub(super) struct Pyramid {
    levels: [GrayImage; LEVELS],
    even: Vec<u16>,
    odd: Vec<u16>,
}

impl Pyramid {
    /// Takes a picture by value of its bytes and makes the levels above it. No allocation once a picture of the size was seen.
    pub(super) fn build(&mut self, gray: &GrayView<'_>) {
        self.levels[0].set_size(gray.width, gray.height);
        for (y, row) in self.levels[0].data.chunks_exact_mut(gray.width).enumerate() {
            row.copy_from_slice(gray.row(y));
        }
        for level in 1..LEVELS {
            let (below, above) = self.levels.split_at_mut(level);
            halve(
                &below[level - 1],
                &mut above[0],
                &mut self.even,
                &mut self.odd,
            );
        }
    }

    pub(super) fn level(&self, level: usize) -> &GrayImage {
        &self.levels[level]
    }

    /// Width and height of the picture.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.levels[0].width, self.levels[0].height)
    }
}

/// Every other sample of the picture smoothed by the binomial 1 4 6 4 1 both ways (Burt and Adelson 1983), borders mirrored
/// without repeating the last pixel. Integers: the same on every machine, and the same as OpenCV's `pyrDown`.
fn halve(below: &GrayImage, above: &mut GrayImage, even: &mut Vec<u16>, odd: &mut Vec<u16>) {
    let (width, height) = (below.width, below.height);
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    above.set_size(half_width, half_height);
    // One sample more on either side of the even ones, one before the odd ones.
    even.resize(half_width + 2, 0);
    odd.resize(half_width + 1, 0);
    let mirror = |i: isize, len: usize| -> usize {
        if len == 1 {
            return 0;
        }
        let last = len as isize - 1;
        let i = i.abs();
        // At most two beyond the end; pictures of two samples are mirrored twice.
        (if i > last { (2 * last - i).abs() } else { i }) as usize
    };
    for (y, row_out) in above.data.chunks_exact_mut(half_width).enumerate() {
        let row = |dy: isize| &below.data[mirror(2 * y as isize + dy, height) * width..][..width];
        let rows = [row(-2), row(-1), row(0), row(1), row(2)];
        let column = |x: usize| {
            let [a, b, c, d, e] = rows.map(|row| u16::from(row[x]));
            a + e + 4 * (b + d) + 6 * c
        };
        let pairs = width / 2;
        let [a, b, c, d, e] = rows.map(|row| &row.as_chunks::<2>().0[..pairs]);
        let (evens, odds) = (&mut even[1..=pairs], &mut odd[1..=pairs]);
        for i in 0..pairs {
            let at = |k: usize| {
                let [a, b, c, d, e] = [a[i][k], b[i][k], c[i][k], d[i][k], e[i][k]].map(u16::from);
                a + e + 4 * (b + d) + 6 * c
            };
            evens[i] = at(0);
            odds[i] = at(1);
        }
        if width % 2 == 1 {
            even[half_width] = column(width - 1);
            odd[0] = column(mirror(-1, width));
            even[0] = column(mirror(-2, width));
            even[half_width + 1] = column(mirror(width as isize + 1, width));
            // The odd sample after the last even one.
            odd.resize(half_width + 1, 0);
            odd[half_width] = column(mirror(width as isize, width));
        } else {
            odd[0] = column(mirror(-1, width));
            even[0] = column(mirror(-2, width));
            even[half_width + 1] = column(mirror(width as isize, width));
        }
        let (left, middle, right) = (
            &even[..half_width],
            &even[1..=half_width],
            &even[2..half_width + 2],
        );
        let (before, after) = (&odd[..half_width], &odd[1..=half_width]);
        for (i, out) in row_out.iter_mut().enumerate() {
            // At most 255 * 256 + 128, which 16 bits hold.
            let sum = left[i] + right[i] + 4 * (before[i] + after[i]) + 6 * middle[i];
            *out = ((sum + 128) >> 8) as u8;
        }
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
    pub(super) fn push(&mut self, frame: u64, gray: &GrayView<'_>) {
        let oldest = self
            .slots
            .iter_mut()
            .min_by_key(|slot| (slot.is_held, slot.is_filled, slot.frame));
        if let Some(slot) = oldest {
            slot.pyramid.build(gray);
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
    fn halved(image: &GrayImage, x: usize, y: usize) -> u8 {
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
                sum += wx * wy * u32::from(image.data[row * image.width + column]);
            }
        }
        ((sum + 128) >> 8) as u8
    }

    #[test]
    fn levels_are_binomial_means() {
        let mut rng = Rng::from_seed(3);
        for (width, height) in [(64, 48), (33, 17), (5, 4), (3, 3), (2, 2), (1, 1)] {
            let image = GrayImage {
                data: (0..width * height)
                    .map(|_| rng.range(0.0, 256.0) as u8)
                    .collect(),
                width,
                height,
            };
            let mut pyramid = Pyramid::default();
            pyramid.build(&image.view());
            for level in 1..LEVELS {
                let (below, above) = (pyramid.level(level - 1), pyramid.level(level));
                assert_eq!(above.width, below.width.div_ceil(2));
                for y in 0..above.height {
                    for x in 0..above.width {
                        let expected = halved(below, x, y);
                        let found = above.data[y * above.width + x];
                        assert_eq!(found, expected, "{width}x{height} {level} {x} {y}");
                    }
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
            ring.push(frame, &view);
        }
        assert!(ring.hold(0));
        for frame in 3..9 {
            ring.push(frame, &view);
        }
        assert!(ring.get(0).is_some() && ring.get(8).is_some() && ring.get(7).is_some());
        assert_eq!(ring.at_most(6), Some(0));
        ring.release(0);
        ring.push(9, &view);
        assert!(ring.get(0).is_none());
        assert!(!ring.hold(0));
    }
}
