//! Ranking kernels: the truncated score of one pose over all correspondences, four at a time in f32.
//!
//! Input: a 3x4 projection in pixels and blocks of four correspondences. Output: the sum of `max(0, w - h r^2)` over valid
//! correspondences, where r is the reprojection error of a point, or for a line the root of the summed squared distances of
//! its observed ends to the projected line. Valid means: in front of the camera (both ends of a line), and the projected
//! segment overlaps the observed one.
//! Every operation is a plain IEEE one in a fixed order, so x86, wasm and the portable version give the same bits. The result
//! only ranks candidates; whatever is kept is computed again in f64.
//! No allocation; one division for each correspondence.

#![cfg_attr(
    any(target_arch = "x86_64", target_arch = "wasm32"),
    expect(unsafe_code, reason = "SIMD intrinsics")
)]

/// Correspondences in a block.
pub(super) const LANES: usize = 4;

/// Four points: X, Y, Z, u, v, w in groups of four.
pub(super) type PointBlock = [[f32; LANES]; 6];

/// Four lines: X1, Y1, Z1, X2, Y2, Z2, u1, v1, u2, v2, w in groups of four.
pub(super) type LineBlock = [[f32; LANES]; 11];

/// Rows of the projection from normalised world points to centred pixels times depth.
pub(super) type Projection = [[f32; 4]; 3];

#[cfg(target_arch = "x86_64")]
mod lanes {
    use core::arch::x86_64::*;

    #[derive(Clone, Copy)]
    pub(super) struct F4(__m128);

    // SAFETY for all blocks below: SSE2 belongs to every x86_64 target, and the values are plain registers.
    impl F4 {
        #[inline(always)]
        pub(super) fn splat(v: f32) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_set1_ps(v) })
        }
        #[inline(always)]
        pub(super) fn load(v: &[f32; 4]) -> Self {
            // SAFETY: the array holds four floats; the load has no alignment demand.
            Self(unsafe { _mm_loadu_ps(v.as_ptr()) })
        }
        #[inline(always)]
        pub(super) fn add(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_add_ps(self.0, o.0) })
        }
        #[inline(always)]
        pub(super) fn sub(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_sub_ps(self.0, o.0) })
        }
        #[inline(always)]
        pub(super) fn mul(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_mul_ps(self.0, o.0) })
        }
        #[inline(always)]
        pub(super) fn div(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_div_ps(self.0, o.0) })
        }
        /// All bits set where self > o.
        #[inline(always)]
        pub(super) fn gt(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_cmpgt_ps(self.0, o.0) })
        }
        #[inline(always)]
        pub(super) fn and(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_and_ps(self.0, o.0) })
        }
        #[inline(always)]
        pub(super) fn or(self, o: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm_or_ps(self.0, o.0) })
        }
        #[inline(always)]
        pub(super) fn to_array(self) -> [f32; 4] {
            let mut out = [0.0; 4];
            // SAFETY: the array holds four floats; the store has no alignment demand.
            unsafe { _mm_storeu_ps(out.as_mut_ptr(), self.0) };
            out
        }
    }
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod lanes {
    use core::arch::wasm32::*;

    #[derive(Clone, Copy)]
    pub(super) struct F4(v128);

    impl F4 {
        #[inline(always)]
        pub(super) fn splat(v: f32) -> Self {
            Self(f32x4_splat(v))
        }
        #[inline(always)]
        pub(super) fn load(v: &[f32; 4]) -> Self {
            // SAFETY: the array holds sixteen bytes; the load has no alignment demand.
            Self(unsafe { v128_load(v.as_ptr().cast()) })
        }
        #[inline(always)]
        pub(super) fn add(self, o: Self) -> Self {
            Self(f32x4_add(self.0, o.0))
        }
        #[inline(always)]
        pub(super) fn sub(self, o: Self) -> Self {
            Self(f32x4_sub(self.0, o.0))
        }
        #[inline(always)]
        pub(super) fn mul(self, o: Self) -> Self {
            Self(f32x4_mul(self.0, o.0))
        }
        #[inline(always)]
        pub(super) fn div(self, o: Self) -> Self {
            Self(f32x4_div(self.0, o.0))
        }
        /// All bits set where self > o.
        #[inline(always)]
        pub(super) fn gt(self, o: Self) -> Self {
            Self(f32x4_gt(self.0, o.0))
        }
        #[inline(always)]
        pub(super) fn and(self, o: Self) -> Self {
            Self(v128_and(self.0, o.0))
        }
        #[inline(always)]
        pub(super) fn or(self, o: Self) -> Self {
            Self(v128_or(self.0, o.0))
        }
        #[inline(always)]
        pub(super) fn to_array(self) -> [f32; 4] {
            let mut out = [0.0; 4];
            // SAFETY: the array holds sixteen bytes; the store has no alignment demand.
            unsafe { v128_store(out.as_mut_ptr().cast(), self.0) };
            out
        }
    }
}

/// Portable lanes: what the others must agree with, and what other targets run.
#[cfg(any(
    test,
    not(any(
        target_arch = "x86_64",
        all(target_arch = "wasm32", target_feature = "simd128")
    ))
))]
mod portable {
    #[derive(Clone, Copy)]
    pub(super) struct F4([f32; 4]);

    impl F4 {
        #[inline(always)]
        fn zip(self, o: Self, f: impl Fn(f32, f32) -> f32) -> Self {
            Self(core::array::from_fn(|i| f(self.0[i], o.0[i])))
        }
        #[inline(always)]
        fn bits(self, o: Self, f: impl Fn(u32, u32) -> u32) -> Self {
            self.zip(o, |a, b| f32::from_bits(f(a.to_bits(), b.to_bits())))
        }
        pub(super) fn splat(v: f32) -> Self {
            Self([v; 4])
        }
        pub(super) fn load(v: &[f32; 4]) -> Self {
            Self(*v)
        }
        pub(super) fn add(self, o: Self) -> Self {
            self.zip(o, |a, b| a + b)
        }
        pub(super) fn sub(self, o: Self) -> Self {
            self.zip(o, |a, b| a - b)
        }
        pub(super) fn mul(self, o: Self) -> Self {
            self.zip(o, |a, b| a * b)
        }
        pub(super) fn div(self, o: Self) -> Self {
            self.zip(o, |a, b| a / b)
        }
        pub(super) fn gt(self, o: Self) -> Self {
            self.zip(o, |a, b| f32::from_bits(if a > b { u32::MAX } else { 0 }))
        }
        pub(super) fn and(self, o: Self) -> Self {
            self.bits(o, |a, b| a & b)
        }
        pub(super) fn or(self, o: Self) -> Self {
            self.bits(o, |a, b| a | b)
        }
        pub(super) fn to_array(self) -> [f32; 4] {
            self.0
        }
    }
}

#[cfg(not(any(
    target_arch = "x86_64",
    all(target_arch = "wasm32", target_feature = "simd128")
)))]
use portable as lanes;

/// The two kernels over one lane type; a macro because the lane types share no trait that would be worth its lines.
macro_rules! kernels {
    ($lane:ident, $points:ident, $lines:ident) => {
        /// Sum of the gains of the points of some blocks. `h` is 1 / (2 sigma^2).
        #[inline]
        pub(super) fn $points(blocks: &[PointBlock], p: &Projection, h: f32, min_z: f32) -> f32 {
            use $lane::F4;
            let m = p.map(|row| row.map(F4::splat));
            let (h, min_z) = (F4::splat(h), F4::splat(min_z));
            let zero = F4::splat(0.0);
            let mut sum = zero;
            for block in blocks {
                let [x, y, z, u, v, w] = block.each_ref().map(F4::load);
                let row = |r: &[F4; 4]| r[0].mul(x).add(r[1].mul(y)).add(r[2].mul(z)).add(r[3]);
                let (px, py, pz) = (row(&m[0]), row(&m[1]), row(&m[2]));
                let ex = px.sub(u.mul(pz));
                let ey = py.sub(v.mul(pz));
                let e = ex.mul(ex).add(ey.mul(ey));
                let gain = w.sub(h.mul(e).div(pz.mul(pz)));
                let is_valid = gain.gt(zero).and(pz.gt(min_z));
                sum = sum.add(gain.and(is_valid));
            }
            let [a, b, c, d] = sum.to_array();
            (a + b) + (c + d)
        }

        /// Sum of the gains of the lines of some blocks. `h` is 1 / (2 sigma^2).
        #[inline]
        pub(super) fn $lines(blocks: &[LineBlock], p: &Projection, h: f32, min_z: f32) -> f32 {
            use $lane::F4;
            let m = p.map(|row| row.map(F4::splat));
            let (h, min_z) = (F4::splat(h), F4::splat(min_z));
            let zero = F4::splat(0.0);
            let mut sum = zero;
            for block in blocks {
                let [x1, y1, z1, x2, y2, z2, u1, v1, u2, v2, w] = block.each_ref().map(F4::load);
                let row = |r: &[F4; 4], x: F4, y: F4, z: F4| {
                    r[0].mul(x).add(r[1].mul(y)).add(r[2].mul(z)).add(r[3])
                };
                let (ax, ay, az) = (
                    row(&m[0], x1, y1, z1),
                    row(&m[1], x1, y1, z1),
                    row(&m[2], x1, y1, z1),
                );
                let (bx, by, bz) = (
                    row(&m[0], x2, y2, z2),
                    row(&m[1], x2, y2, z2),
                    row(&m[2], x2, y2, z2),
                );
                let lx = ay.mul(bz).sub(az.mul(by));
                let ly = az.mul(bx).sub(ax.mul(bz));
                let lz = ax.mul(by).sub(ay.mul(bx));
                let d1 = lx.mul(u1).add(ly.mul(v1)).add(lz);
                let d2 = lx.mul(u2).add(ly.mul(v2)).add(lz);
                let e = d1.mul(d1).add(d2.mul(d2));
                let gain = w.sub(h.mul(e).div(lx.mul(lx).add(ly.mul(ly))));
                // Position of the projected ends along the observed segment, times depth: the intervals must meet.
                let (dx, dy) = (u2.sub(u1), v2.sub(v1));
                let length_sq = dx.mul(dx).add(dy.mul(dy));
                let along =
                    |x: F4, y: F4, z: F4| x.sub(u1.mul(z)).mul(dx).add(y.sub(v1.mul(z)).mul(dy));
                let (s1, s2) = (along(ax, ay, az), along(bx, by, bz));
                let starts_before_end = az.mul(length_sq).gt(s1).or(bz.mul(length_sq).gt(s2));
                let ends_after_start = s1.gt(zero).or(s2.gt(zero));
                let is_valid = gain
                    .gt(zero)
                    .and(az.gt(min_z))
                    .and(bz.gt(min_z))
                    .and(starts_before_end)
                    .and(ends_after_start);
                sum = sum.add(gain.and(is_valid));
            }
            let [a, b, c, d] = sum.to_array();
            (a + b) + (c + d)
        }
    };
}

kernels!(lanes, score_points, score_lines);
#[cfg(test)]
kernels!(portable, score_points_portable, score_lines_portable);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn simd_and_portable_kernels_give_the_same_bits() {
        let mut rng = Rng::from_seed(9);
        for _ in 0..200 {
            let mut block6: Vec<PointBlock> = Vec::new();
            let mut block11: Vec<LineBlock> = Vec::new();
            for _ in 0..5 {
                block6.push(core::array::from_fn(|k| {
                    core::array::from_fn(|_| match k {
                        3 | 4 => rng.range(-300.0, 300.0) as f32,
                        5 => rng.range(0.0, 12.0) as f32,
                        _ => rng.normal() as f32,
                    })
                }));
                block11.push(core::array::from_fn(|k| {
                    core::array::from_fn(|_| match k {
                        6..=9 => rng.range(-300.0, 300.0) as f32,
                        10 => rng.range(0.0, 12.0) as f32,
                        _ => rng.normal() as f32,
                    })
                }));
            }
            let p: Projection = core::array::from_fn(|r| {
                core::array::from_fn(|c| {
                    let size = if r < 2 { 500.0 } else { 1.0 };
                    (size * rng.normal()) as f32 + if (r, c) == (2, 3) { 2.0 } else { 0.0 }
                })
            });
            // A wide h so that many terms survive.
            let (a, b) = (
                score_points(&block6, &p, 1e-5, 0.01),
                score_points_portable(&block6, &p, 1e-5, 0.01),
            );
            assert_eq!(a.to_bits(), b.to_bits());
            let (a, b) = (
                score_lines(&block11, &p, 1e-5, 0.01),
                score_lines_portable(&block11, &p, 1e-5, 0.01),
            );
            assert_eq!(a.to_bits(), b.to_bits());
        }
    }

    #[test]
    fn behind_the_camera_and_non_overlapping_lines_gain_nothing() {
        let identity: Projection = [
            [500.0, 0.0, 0.0, 0.0],
            [0.0, 500.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ];
        let point =
            |z: f32| -> PointBlock { [[0.0; 4], [0.0; 4], [z; 4], [0.0; 4], [0.0; 4], [8.0; 4]] };
        assert_eq!(score_points(&[point(2.0)], &identity, 0.1, 0.01), 32.0);
        assert_eq!(score_points(&[point(-2.0)], &identity, 0.1, 0.01), 0.0);
        // Projects to pixels 0..250 on the x axis; observed at 300..400 on the same line, or at 100..400.
        let line = |u1: f32, z: f32| -> LineBlock {
            [
                [0.0; 4], [0.0; 4], [z; 4], [1.0; 4], [0.0; 4], [2.0; 4], [u1; 4], [0.0; 4],
                [400.0; 4], [0.0; 4], [8.0; 4],
            ]
        };
        assert_eq!(score_lines(&[line(100.0, 2.0)], &identity, 0.1, 0.01), 32.0);
        assert_eq!(score_lines(&[line(300.0, 2.0)], &identity, 0.1, 0.01), 0.0);
        assert_eq!(score_lines(&[line(100.0, -2.0)], &identity, 0.1, 0.01), 0.0);
    }
}
