//! The level-line field of the working image and the order in which its pixels become seeds.
//!
//! Source: `[lsd2012]`, sections on the gradient computation and the pseudo-ordering. The field is stored column by
//! column (x outer) inside a border of undefined pixels, because every scan of the algorithm goes that way.

use super::kernels;
use super::resample::{Resampler, Rows, Sample};

/// The pixel has a level line.
pub(super) const DEFINED: u8 = 1;
/// The pixel has a level line and belongs to no region yet. Bit set on top of [`DEFINED`].
pub(super) const AVAILABLE: u8 = 2;

/// Coordinates of a working pixel in 16 bits each. Sorted numerically, pixels come column by column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Packed(u32);

impl Packed {
    pub(super) fn new(x: usize, y: usize) -> Self {
        Self((x as u32) << 16 | y as u32)
    }

    pub(super) fn x(self) -> usize {
        (self.0 >> 16) as usize
    }

    pub(super) fn y(self) -> usize {
        (self.0 & 0xffff) as usize
    }
}

/// Level lines of the working image.
#[derive(Debug, Default)]
pub(super) struct Field {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Distance between columns in the arrays below: the height and two border pixels.
    pub(super) stride: usize,
    /// `DEFINED` and `AVAILABLE` bits.
    pub(super) state: Vec<u8>,
    /// Unit vector of the level line; meaningful where defined.
    pub(super) direction: Vec<[f64; 2]>,
    /// Length of the gradient; meaningful where defined.
    pub(super) norm: Vec<f64>,
    /// Largest of `norm` over the defined pixels, 0 when there are none.
    pub(super) max_norm: f64,
    /// Defined pixels from strong to weak, column by column inside a bin.
    pub(super) order: Vec<Packed>,
    rows: RowBuffers,
    defined: Vec<(Packed, u32)>,
    bin_ends: Vec<u32>,
}

#[derive(Debug, Default)]
struct RowBuffers {
    upper: Vec<f64>,
    lower: Vec<f64>,
    dx: Vec<f64>,
    dy: Vec<f64>,
    square: Vec<f64>,
    found: Vec<u16>,
}

impl Field {
    pub(super) fn index(&self, p: Packed) -> usize {
        (p.x() + 1) * self.stride + p.y() + 1
    }

    /// Computes the field of `image` resampled to `width` x `height`, both at least 2. Pixels with a gradient of at
    /// most `least_norm` and those whose gradient is not finite stay undefined, as do the last column and row.
    pub(super) fn compute<T: Sample>(
        &mut self,
        image: &Rows<'_, T>,
        resampler: &mut Resampler,
        (width, height): (usize, usize),
        least_norm: f64,
    ) {
        self.width = width;
        self.height = height;
        self.stride = height + 2;
        let len = (width + 2) * self.stride;
        self.state.clear();
        self.state.resize(len, 0);
        self.direction.resize(len, [0.0; 2]);
        self.norm.resize(len, 0.0);
        let rows = &mut self.rows;
        for buffer in [&mut rows.upper, &mut rows.lower] {
            buffer.resize(width, 0.0);
        }
        for buffer in [&mut rows.dx, &mut rows.dy, &mut rows.square] {
            buffer.resize(width - 1, 0.0);
        }
        rows.found.resize(width - 1, 0);

        let threshold = square_threshold(least_norm);
        let mut max_square = 0.0f64;
        resampler.row(image, 0, &mut rows.upper);
        for y in 0..height - 1 {
            resampler.row(image, y + 1, &mut rows.lower);
            kernels::level_lines(
                &rows.upper,
                &rows.lower,
                &mut rows.dx,
                &mut rows.dy,
                &mut rows.square,
            );
            let count = kernels::select_above(&rows.square, threshold, &mut rows.found);
            for &x in &rows.found[..count] {
                let x = usize::from(x);
                let index = (x + 1) * self.stride + y + 1;
                let square = rows.square[x];
                max_square = max_square.max(square);
                let length = square.sqrt();
                let inverse = 1.0 / length;
                self.direction[index] = [rows.dx[x] * inverse, rows.dy[x] * inverse];
                self.norm[index] = 0.5 * length;
                self.state[index] = DEFINED | AVAILABLE;
            }
            core::mem::swap(&mut rows.upper, &mut rows.lower);
        }
        self.max_norm = 0.5 * max_square.sqrt();
    }

    /// Fills `order`: a counting sort by `norm` in `num_bins` bins up to `max_norm`, strong bins first.
    pub(super) fn sort(&mut self, num_bins: usize, max_norm: f64) {
        self.order.clear();
        self.defined.clear();
        self.bin_ends.clear();
        self.bin_ends.resize(num_bins, 0);
        if self.max_norm <= 0.0 {
            return;
        }
        let (bins, last) = (num_bins as f64, num_bins as u32 - 1);
        for x in 0..self.width - 1 {
            let first = (x + 1) * self.stride;
            let column = &self.state[first..first + self.stride];
            let norms = &self.norm[first..first + self.stride];
            let mut push = |i: usize| {
                let bin = ((norms[i] * bins / max_norm) as u32).min(last);
                self.bin_ends[bin as usize] += 1;
                self.defined.push((Packed::new(x, i - 1), bin));
            };
            let (eights, rest) = column.as_chunks::<8>();
            for (k, eight) in eights.iter().enumerate() {
                let mut flags = u64::from_le_bytes(*eight) & 0x0101_0101_0101_0101;
                while flags != 0 {
                    push(8 * k + (flags.trailing_zeros() / 8) as usize);
                    flags &= flags - 1;
                }
            }
            for (i, &state) in rest.iter().enumerate() {
                if state & DEFINED != 0 {
                    push(8 * eights.len() + i);
                }
            }
        }
        let mut sum = 0;
        for end in self.bin_ends.iter_mut().rev() {
            let count = *end;
            *end = sum;
            sum += count;
        }
        self.order.resize(self.defined.len(), Packed(0));
        for &(pixel, bin) in &self.defined {
            let place = &mut self.bin_ends[bin as usize];
            self.order[*place as usize] = pixel;
            *place += 1;
        }
    }
}

/// Largest sum of squares `s` with `sqrt(s) / 2 <= least_norm`, so that one comparison replaces the root. The sum is
/// of the doubled gradient, whence the half.
fn square_threshold(least_norm: f64) -> f64 {
    let mut square = 4.0 * least_norm * least_norm;
    while 0.5 * square.sqrt() > least_norm {
        square = square.next_down();
    }
    while 0.5 * square.next_up().sqrt() <= least_norm {
        square = square.next_up();
    }
    square
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threshold_is_the_last_square_below() {
        for norm in [
            0.0,
            1.0,
            5.226251859505506,
            2.0 / 0.382_683_432_365_089_8,
            1e6,
        ] {
            let t = square_threshold(norm);
            assert!(0.5 * t.sqrt() <= norm, "{norm}");
            assert!(0.5 * t.next_up().sqrt() > norm, "{norm}");
        }
    }

    fn field(data: &[f64], w: usize, h: usize, least_norm: f64) -> Field {
        let mut field = Field::default();
        let mut resampler = Resampler::default();
        resampler.prepare((w, h), (w, h), 1.0, 0.6);
        let rows = Rows {
            data,
            width: w,
            height: h,
            stride: w,
        };
        field.compute(&rows, &mut resampler, (w, h), least_norm);
        field
    }

    #[test]
    fn level_line_has_the_dark_side_at_its_right() {
        // Dark at the left of the picture: the level line points down, which has the left of the picture at its right.
        let data = [0.0, 10.0, 0.0, 10.0];
        let f = field(&data, 2, 2, 1.0);
        let i = f.index(Packed::new(0, 0));
        assert_eq!(f.direction[i], [0.0, 1.0]);
        assert_eq!(f.norm[i], 10.0);
        assert_eq!(f.max_norm, 10.0);
    }

    #[test]
    fn order_is_by_bin_then_by_column() {
        // Steps of two strengths in a 4x3 image, last row and column undefined.
        let data = [
            0.0, 50.0, 50.0, 50.0, //
            0.0, 50.0, 50.0, 60.0, //
            0.0, 50.0, 50.0, 60.0,
        ];
        let mut f = field(&data, 4, 3, 1.0);
        f.sort(10, f.max_norm);
        let got: Vec<_> = f.order.iter().map(|p| (p.x(), p.y())).collect();
        assert_eq!(got, [(0, 0), (0, 1), (2, 1), (2, 0)]);
    }

    #[test]
    fn pixels_that_are_not_finite_are_undefined() {
        let mut data = vec![0.0; 36];
        for y in 0..6 {
            for x in 3..6 {
                data[6 * y + x] = 100.0;
            }
        }
        data[6 * 2 + 2] = f64::NAN;
        data[0] = f64::INFINITY;
        let f = field(&data, 6, 6, 1.0);
        assert_eq!(f.max_norm, 100.0);
        let defined = f.state.iter().filter(|&&s| s & DEFINED != 0).count();
        assert_eq!(
            defined, 3,
            "five rows of 2x2 blocks, two of which touch the NaN"
        );
    }
}
