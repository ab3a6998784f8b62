//! The inner loop: inner products of a patch of the picture, interpolated between its pixels, with the rows of a template.
#![expect(
    unsafe_code,
    reason = "vector instructions; sizes are asserted before the loop"
)]

use crate::simd::kernels::{Lanes, entry};

/// Side of a patch in pixels: a multiple of the widest vector.
pub(super) const SIDE: usize = 16;
/// Pixels of a patch.
pub(super) const AREA: usize = SIDE * SIDE;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;
    use crate::simd::Level;

    #[test]
    fn every_level_multiplies_as_plain_sums() {
        let mut rng = Rng::from_seed(5);
        let (stride, height) = (40, 30);
        let data: Vec<u8> = (0..stride * height)
            .map(|_| rng.range(0.0, 256.0) as u8)
            .collect();
        let mut rows = || -> Rows { core::array::from_fn(|_| rng.range(-9.0, 9.0) as f32) };
        let (a, b, c) = (rows(), rows(), rows());
        for (x, y, shift) in [
            (0, 0, [0.0, 0.0]),
            (23, 13, [0.25, 0.75]),
            (7, 5, [0.9, 0.1]),
        ] {
            let first = y * stride + x;
            let at = |column: usize, row: usize| {
                let pixel = |dx, dy| f64::from(data[first + (row + dy) * stride + column + dx]);
                let [u, v] = shift.map(f64::from);
                (1.0 - v) * ((1.0 - u) * pixel(0, 0) + u * pixel(1, 0))
                    + v * ((1.0 - u) * pixel(0, 1) + u * pixel(1, 1))
            };
            let mut expected = [0.0; 5];
            for row in 0..SIDE {
                for column in 0..SIDE {
                    let (sample, at) = (at(column, row), row * SIDE + column);
                    for (sum, factor) in expected.iter_mut().zip([
                        f64::from(a[at]),
                        f64::from(b[at]),
                        f64::from(c[at]),
                        1.0,
                        sample,
                    ]) {
                        *sum += sample * factor;
                    }
                }
            }
            for level in Level::available() {
                let mut sums = Sums::default();
                let work = Work {
                    place: Place {
                        data: &data,
                        stride,
                        first,
                        shift,
                    },
                    a: &a,
                    b: &b,
                    c: &c,
                    sums: &mut sums,
                };
                multiply(level, work);
                let found = [sums.a, sums.b, sums.c, sums.one, sums.square];
                for (f, e) in found.into_iter().zip(expected) {
                    assert!(
                        (f64::from(f) - e).abs() < 2e-6 * expected[4],
                        "{}: {f} instead of {e}",
                        level.name()
                    );
                }
            }
        }
    }
}
