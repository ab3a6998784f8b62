//! The inner loops: halving of pictures, sampling between pixels, gradients of a template, and its products with a patch of the
//! picture.
#![expect(
    unsafe_code,
    reason = "vector instructions; sizes are asserted before the loops"
)]

use crate::simd::kernels::{Lanes, entry};

#[cfg(test)]
mod tests;

/// Side of a patch in pixels: a multiple of the widest vector.
pub(super) const SIDE: usize = 16;
/// Pixels of a patch.
pub(super) const AREA: usize = SIDE * SIDE;

/// Side of what a template is made of: the patch and a pixel on either side for the gradients.
pub(super) const RIM: usize = SIDE + 2;

/// Where a patch lies in a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) data: &'a [u8],
    pub(super) stride: usize,
    /// Index of the pixel up and left of the patch's first sample.
    pub(super) first: usize,
    /// How far the samples lie beyond their pixels, 0..1.
    pub(super) shift: [f32; 2],
}

/// Templates against which the patch is multiplied, row by row.
pub(super) type Rows = [f32; AREA];

/// Inner products of the samples `i`: with `a`, `b` and `c`, with one, with themselves.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    pub(super) a: f32,
    pub(super) b: f32,
    pub(super) c: f32,
    pub(super) one: f32,
    pub(super) square: f32,
}

/// One call of the kernel.
pub(super) struct Work<'a> {
    pub(super) place: Place<'a>,
    pub(super) a: &'a Rows,
    pub(super) b: &'a Rows,
    pub(super) c: &'a Rows,
    pub(super) sums: &'a mut Sums,
}

entry! {
    /// Fills `work.sums`.
    pub(super) fn multiply(work: Work<'_>) => multiply_lanes
}

#[inline(always)]
fn multiply_lanes<L: Lanes>(work: Work<'_>) {
    let Place {
        data,
        stride,
        first,
        shift,
    } = work.place;
    assert!(
        SIDE.is_multiple_of(L::LANES) && first + SIDE * stride + SIDE < data.len(),
        "the patch and one pixel more lie in the picture"
    );
    let (right, down) = (L::splat(shift[0]), L::splat(shift[1]));
    let zero = L::splat(0.0);
    let (mut a, mut b, mut c, mut one, mut square) = (zero, zero, zero, zero, zero);
    for column in (0..SIDE).step_by(L::LANES) {
        // SAFETY: rows 0..=SIDE and columns 0..=SIDE from `first` are in the picture (asserted), and the templates have AREA numbers.
        unsafe {
            let mut from = data.as_ptr().add(first + column);
            let across = |from: *const u8| {
                let left = L::load_bytes(from);
                left.mul_add(right, L::load_bytes(from.add(1)).sub(left))
            };
            let mut upper = across(from);
            for row in 0..SIDE {
                from = from.add(stride);
                let lower = across(from);
                let sample = upper.mul_add(down, lower.sub(upper));
                upper = lower;
                let at = row * SIDE + column;
                a = a.mul_add(sample, L::load(work.a.as_ptr().add(at)));
                b = b.mul_add(sample, L::load(work.b.as_ptr().add(at)));
                c = c.mul_add(sample, L::load(work.c.as_ptr().add(at)));
                one = one.add(sample);
                square = square.mul_add(sample, sample);
            }
        }
    }
    *work.sums = Sums {
        a: a.sum(),
        b: b.sum(),
        c: c.sum(),
        one: one.sum(),
        square: square.sum(),
    };
}

/// One row of a picture of half the size.
pub(super) struct Halving<'a> {
    /// Five rows from two before the middle one, each from two pixels before the first.
    pub(super) below: &'a [u8],
    pub(super) stride: usize,
    /// Sums down the columns, those of every other column each; memory that is used again.
    pub(super) even: &'a mut Vec<u16>,
    pub(super) odd: &'a mut Vec<u16>,
    pub(super) above: &'a mut [u8],
}

entry! {
    /// Every other sample of the picture smoothed by the binomial 1 4 6 4 1 both ways (Burt and Adelson 1983). Integers: the same
    /// on every machine, and the same as OpenCV's `pyrDown`.
    pub(super) fn halve(work: Halving<'_>) => halve_lanes
}

/// Integers, which the compiler makes vectors of.
#[inline(always)]
fn halve_lanes<L: Lanes>(work: Halving<'_>) {
    let (count, stride) = (work.above.len(), work.stride);
    // One pair of columns before the first sample and one after the last.
    let pairs = count + 2;
    let row = |i: usize| &work.below[i * stride..][..2 * pairs].as_chunks::<2>().0[..pairs];
    let (a, b, c, d, e) = (row(0), row(1), row(2), row(3), row(4));
    work.even.resize(pairs, 0);
    work.odd.resize(pairs, 0);
    let (even, odd) = (&mut work.even[..pairs], &mut work.odd[..pairs]);
    for i in 0..pairs {
        // A pair as one number: its bytes come apart without shuffling.
        let [a, b, c, d, e] = [a[i], b[i], c[i], d[i], e[i]].map(u16::from_le_bytes);
        let column = |of: fn(u16) -> u16| {
            let [a, b, c, d, e] = [a, b, c, d, e].map(of);
            a + e + 4 * (b + d) + 6 * c
        };
        even[i] = column(|pair| pair & 0xFF);
        odd[i] = column(|pair| pair >> 8);
    }
    let (left, middle, right) = (&even[..count], &even[1..=count], &even[2..]);
    let (before, after) = (&odd[..count], &odd[1..=count]);
    for i in 0..count {
        // At most 255 * 256 + 128, which 16 bits hold.
        let sum = left[i] + right[i] + 4 * (before[i] + after[i]) + 6 * middle[i];
        work.above[i] = ((sum + 128) >> 8) as u8;
    }
}

/// A square of samples that lie as the pixels do.
pub(super) struct Straight<'a> {
    pub(super) place: Place<'a>,
    /// Samples in a row and rows, at least [`SIDE`].
    pub(super) side: usize,
    pub(super) out: &'a mut [f32],
}

entry! {
    /// Fills `work.out`.
    pub(super) fn sample_straight(work: Straight<'_>) => sample_straight_lanes
}

#[inline(always)]
fn sample_straight_lanes<L: Lanes>(work: Straight<'_>) {
    let Place {
        data,
        stride,
        first,
        shift,
    } = work.place;
    let side = work.side;
    assert!(
        side >= L::LANES
            && side < stride
            && first + side * stride + side < data.len()
            && work.out.len() >= side * side,
        "the square and one pixel more lie in the picture"
    );
    let (right, down) = (L::splat(shift[0]), L::splat(shift[1]));
    for column in (0..side).step_by(L::LANES) {
        // The last vector overlaps the one before.
        let column = column.min(side - L::LANES);
        // SAFETY: rows 0..=side and columns 0..=side from `first` are in the picture, and side² numbers fit (asserted).
        unsafe {
            let mut from = data.as_ptr().add(first + column);
            let mut to = work.out.as_mut_ptr().add(column);
            let across = |from: *const u8| {
                let left = L::load_bytes(from);
                left.mul_add(right, L::load_bytes(from.add(1)).sub(left))
            };
            let mut upper = across(from);
            for _ in 0..side {
                from = from.add(stride);
                let lower = across(from);
                upper.mul_add(down, lower.sub(upper)).store(to);
                upper = lower;
                to = to.wrapping_add(side);
            }
        }
    }
}

/// A square of samples at positions that a map gives.
pub(super) struct Warped<'a> {
    pub(super) data: &'a [u8],
    pub(super) stride: usize,
    /// Index coordinates of its middle.
    pub(super) center: [f32; 2],
    /// Offsets in the picture from offsets in the square, row by row.
    pub(super) map: [f32; 4],
    /// Samples in a row and rows, at most [`MAX_WARPED`].
    pub(super) side: usize,
    pub(super) out: &'a mut [f32],
}

/// Largest side of a warped square.
pub(super) const MAX_WARPED: usize = 32;

entry! {
    /// Fills `work.out`. Positions outside the picture give some pixel of it.
    pub(super) fn sample_warped(work: Warped<'_>) => sample_warped_lanes
}

/// Positions and sums are vectors of the compiler's making; only the pixels are fetched one by one.
#[inline(always)]
fn sample_warped_lanes<L: Lanes>(work: Warped<'_>) {
    let (side, stride) = (work.side, work.stride);
    assert!(
        side <= MAX_WARPED
            && work.out.len() >= side * side
            && work.data.len() > stride + 1
            && work.data.len() < 1 << 31,
        "four pixels there, and room for the samples"
    );
    let [xx, xy, yx, yy] = work.map;
    let half = 0.5 * (side as f32 - 1.0);
    let last = (work.data.len() - stride - 2) as i32;
    let (columns, rows) = (stride as f32, (work.data.len() / stride) as f32);
    let mut first = [0_i32; MAX_WARPED];
    let (mut right, mut down) = ([0.0_f32; MAX_WARPED], [0.0_f32; MAX_WARPED]);
    let mut corners = [[0_u8; MAX_WARPED]; 4];
    for (row, line) in work.out[..side * side].chunks_exact_mut(side).enumerate() {
        let v = row as f32 - half;
        let (x, y) = (work.center[0] + xy * v, work.center[1] + yy * v);
        for column in 0..side {
            let u = column as f32 - half;
            let (x, y) = (
                (x + xx * u).max(0.0).min(columns),
                (y + yx * u).max(0.0).min(rows),
            );
            // SAFETY: numbers between zero and the picture's size; `max` takes NaN out.
            let (left, top) = unsafe { (x.to_int_unchecked::<i32>(), y.to_int_unchecked::<i32>()) };
            first[column] = (top * stride as i32 + left).min(last);
            (right[column], down[column]) = (x - left as f32, y - top as f32);
        }
        for column in 0..side {
            // SAFETY: `first` is at most `last`, from which one row and two pixels more are in the picture, and not negative.
            unsafe {
                let from = work.data.as_ptr().add(first[column] as usize);
                let upper = from.cast::<[u8; 2]>().read_unaligned();
                let lower = from.add(stride).cast::<[u8; 2]>().read_unaligned();
                (corners[0][column], corners[1][column]) = (upper[0], upper[1]);
                (corners[2][column], corners[3][column]) = (lower[0], lower[1]);
            }
        }
        for (column, value) in line.iter_mut().enumerate() {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k: usize| f32::from(corners[k][column]));
            let upper = a + right[column] * (b - a);
            let lower = c + right[column] * (d - c);
            *value = upper + down[column] * (lower - upper);
        }
    }
}

/// What a template is made from and of.
pub(super) struct Making<'a> {
    /// Rows of `stride` samples, of which the first [`RIM`] of the first [`RIM`] rows count.
    pub(super) rim: &'a [f32],
    pub(super) stride: usize,
    /// Gradients without their part of constants and of `gray`.
    pub(super) across: &'a mut Rows,
    pub(super) down: &'a mut Rows,
    /// Grey levels less their mean.
    pub(super) gray: &'a mut Rows,
    pub(super) moments: &'a mut Moments,
}

/// Means and products over a patch: of the gradients across and down, and of the grey levels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) gray: f32,
    /// Sum of the squares of the grey levels less their mean.
    pub(super) square: f32,
    /// Mean of each gradient, and what of it goes with the grey levels less their mean.
    pub(super) mean: [f32; 2],
    pub(super) share: [f32; 2],
    /// Sums of products of the gradients, xx, xy and yy: as they are, and without their part of constants and grey levels.
    pub(super) plain: [f32; 3],
    pub(super) free: [f32; 3],
}

entry! {
    /// Fills all of `work`; the shares are zero where the patch is flat.
    pub(super) fn make_rows(work: Making<'_>) => make_rows_lanes
}

#[inline(always)]
fn make_rows_lanes<L: Lanes>(work: Making<'_>) {
    let stride = work.stride;
    assert!(
        SIDE.is_multiple_of(L::LANES) && work.rim.len() >= (RIM - 1) * stride + RIM,
        "the rim is there"
    );
    let zero = L::splat(0.0);
    // Scharr's weights: as central differences, with less noise.
    let (beside, middle) = (L::splat(3.0 / 32.0), L::splat(10.0 / 32.0));
    // Sums of small numbers lose less.
    let origin = work.rim[(RIM / 2) * stride + RIM / 2];
    let about = L::splat(origin);
    let mut sums = [zero; 9];
    for column in (0..SIDE).step_by(L::LANES) {
        for row in 0..SIDE {
            // SAFETY: RIM rows and columns of the rim are there (asserted), and the rows have AREA numbers.
            unsafe {
                let from = work.rim.as_ptr().add(row * stride + column);
                let at = |dx: usize, dy: usize| L::load(from.add(dy * stride + dx));
                let (a, b, c) = (at(0, 0), at(1, 0), at(2, 0));
                let (d, gray, f) = (at(0, 1), at(1, 1).sub(about), at(2, 1));
                let (g, h, i) = (at(0, 2), at(1, 2), at(2, 2));
                let across = middle.mul(f.sub(d)).mul_add(beside, c.sub(a).add(i.sub(g)));
                let down = middle.mul(h.sub(b)).mul_add(beside, g.sub(a).add(i.sub(c)));
                let to = row * SIDE + column;
                across.store(work.across.as_mut_ptr().add(to));
                down.store(work.down.as_mut_ptr().add(to));
                gray.store(work.gray.as_mut_ptr().add(to));
                sums = [
                    sums[0].add(gray),
                    sums[1].add(across),
                    sums[2].add(down),
                    sums[3].mul_add(gray, gray),
                    sums[4].mul_add(gray, across),
                    sums[5].mul_add(gray, down),
                    sums[6].mul_add(across, across),
                    sums[7].mul_add(across, down),
                    sums[8].mul_add(down, down),
                ];
            }
        }
    }
    let n = AREA as f32;
    let [
        gray,
        across,
        down,
        square,
        with_across,
        with_down,
        xx,
        xy,
        yy,
    ] = sums.map(L::sum);
    let [gray, across, down] = [gray, across, down].map(|sum| sum / n);
    let square = (square - n * gray * gray).max(0.0);
    let with = [with_across - n * gray * across, with_down - n * gray * down];
    let share = with.map(|with| if square > 0.0 { with / square } else { 0.0 });
    let moments = Moments {
        gray: origin + gray,
        square,
        mean: [across, down],
        share,
        plain: [xx, xy, yy],
        free: [
            xx - n * across * across - share[0] * with[0],
            xy - n * across * down - share[0] * with[1],
            yy - n * down * down - share[1] * with[1],
        ],
    };
    *work.moments = moments;
    let (mean_gray, mean_across, mean_down) = (L::splat(gray), L::splat(across), L::splat(down));
    let [share_across, share_down] = share.map(|share| L::splat(-share));
    for at in (0..AREA).step_by(L::LANES) {
        // SAFETY: the rows have AREA numbers, a multiple of the vector.
        unsafe {
            let [a, d, g] = [
                work.across.as_mut_ptr().add(at),
                work.down.as_mut_ptr().add(at),
                work.gray.as_mut_ptr().add(at),
            ];
            let gray = L::load(g).sub(mean_gray);
            gray.store(g);
            L::load(a)
                .sub(mean_across)
                .mul_add(gray, share_across)
                .store(a);
            L::load(d).sub(mean_down).mul_add(gray, share_down).store(d);
        }
    }
}

/// Numbers and their nearest bytes.
pub(super) struct Rounding<'a> {
    pub(super) from: &'a [f32],
    pub(super) to: &'a mut [u8],
}

entry! {
    /// Fills `work.to` with the bytes nearest to numbers from 0 to 255.
    pub(super) fn round_to_bytes(work: Rounding<'_>) => round_to_bytes_lanes
}

#[inline(always)]
fn round_to_bytes_lanes<L: Lanes>(work: Rounding<'_>) {
    let (least, most) = (0.0, 255.0);
    for (to, from) in work.to.iter_mut().zip(work.from) {
        // `clamp` would let NaN through.
        let nearest = (from + 0.5).max(least).min(most);
        // SAFETY: between 0 and 255.
        *to = unsafe { nearest.to_int_unchecked::<i32>() } as u8;
    }
}
