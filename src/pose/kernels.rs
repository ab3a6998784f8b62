//! Ranking kernels: the truncated score of one pose over all correspondences, four at a time in f32.
//!
//! Input: a 3x4 projection in pixels and blocks of four correspondences. Output: the sum of `max(0, w - h r^2)` over valid
//! correspondences, where r is the reprojection error of a point, or for a line the root of the summed squared distances of
//! its observed ends to the projected line. Valid means: in front of the camera (both ends of a line), and the projected
//! segment overlaps the observed one.
//! Every operation is a plain IEEE one in a fixed order, so x86, wasm and the portable version give the same bits. The result
//! only ranks candidates; whatever is kept is computed again in f64.
//! No allocation; one division for each correspondence.

#![expect(unsafe_code, reason = "vectors of `simd`")]

use crate::simd::kernels::{Lanes, Portable};

/// Correspondences in a block.
pub(super) const LANES: usize = 4;

/// Four points: X, Y, Z, u, v, w in groups of four.
pub(super) type PointBlock = [[f32; LANES]; 6];

/// Four lines: X1, Y1, Z1, X2, Y2, Z2, u1, v1, u2, v2, w in groups of four.
pub(super) type LineBlock = [[f32; LANES]; 11];

/// Rows of the projection from normalised world points to centred pixels times depth.
pub(super) type Projection = [[f32; 4]; 3];

/// Sum of the gains of the points of some blocks. `h` is 1 / (2 sigma^2).
#[inline]
pub(super) fn score_points(blocks: &[PointBlock], p: &Projection, h: f32, min_z: f32) -> f32 {
    points::<Portable>(blocks, p, h, min_z)
}

/// Sum of the gains of the lines of some blocks. `h` is 1 / (2 sigma^2).
#[inline]
pub(super) fn score_lines(blocks: &[LineBlock], p: &Projection, h: f32, min_z: f32) -> f32 {
    lines::<Portable>(blocks, p, h, min_z)
}

#[inline(always)]
fn load<L: Lanes>(group: &[f32; LANES]) -> L {
    const { assert!(L::LANES == LANES, "blocks hold four") };
    // SAFETY: a group has as many numbers as the vector.
    unsafe { L::load(group.as_ptr()) }
}

/// Sum of the lanes, neighbours first.
#[inline(always)]
fn total<L: Lanes>(sum: L) -> f32 {
    let mut lanes = [0.0; LANES];
    // SAFETY: `load` made sure that the vector has as many lanes.
    unsafe { sum.store(lanes.as_mut_ptr()) };
    let [a, b, c, d] = lanes;
    (a + b) + (c + d)
}

#[inline(always)]
fn points<L: Lanes>(blocks: &[PointBlock], p: &Projection, h: f32, min_z: f32) -> f32 {
    let m = p.map(|row| row.map(L::splat));
    let (h, min_z) = (L::splat(h), L::splat(min_z));
    let zero = L::splat(0.0);
    let mut sum = zero;
    for block in blocks {
        let [x, y, z, u, v, w] = block.each_ref().map(load::<L>);
        let row = |r: &[L; 4]| r[0].mul(x).add(r[1].mul(y)).add(r[2].mul(z)).add(r[3]);
        let (px, py, pz) = (row(&m[0]), row(&m[1]), row(&m[2]));
        let ex = px.sub(u.mul(pz));
        let ey = py.sub(v.mul(pz));
        let e = ex.mul(ex).add(ey.mul(ey));
        let gain = w.sub(h.mul(e).div(pz.mul(pz)));
        let valid = gain.where_greater(gain, zero).where_greater(pz, min_z);
        sum = sum.add(valid);
    }
    total(sum)
}

#[inline(always)]
fn lines<L: Lanes>(blocks: &[LineBlock], p: &Projection, h: f32, min_z: f32) -> f32 {
    let m = p.map(|row| row.map(L::splat));
    let (h, min_z) = (L::splat(h), L::splat(min_z));
    let zero = L::splat(0.0);
    let mut sum = zero;
    for block in blocks {
        let [x1, y1, z1, x2, y2, z2, u1, v1, u2, v2, w] = block.each_ref().map(load::<L>);
        let row =
            |r: &[L; 4], x: L, y: L, z: L| r[0].mul(x).add(r[1].mul(y)).add(r[2].mul(z)).add(r[3]);
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
        let along = |x: L, y: L, z: L| x.sub(u1.mul(z)).mul(dx).add(y.sub(v1.mul(z)).mul(dy));
        let (s1, s2) = (along(ax, ay, az), along(bx, by, bz));
        // What is left of the gain is positive or zero, so the larger of two conditions is their disjunction.
        let either = |gain: L, (a, b): (L, L), (c, d): (L, L)| {
            gain.where_greater(a, b).max(gain.where_greater(c, d))
        };
        let in_front = gain
            .where_greater(gain, zero)
            .where_greater(az, min_z)
            .where_greater(bz, min_z);
        let starts_before_end = either(in_front, (az.mul(length_sq), s1), (bz.mul(length_sq), s2));
        let ends_after_start = either(starts_before_end, (s1, zero), (s2, zero));
        sum = sum.add(ends_after_start);
    }
    total(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;
    use crate::simd::kernels::plain::Plain;

    #[test]
    fn vectors_and_plain_rust_give_the_same_bits() {
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
                points::<Plain>(&block6, &p, 1e-5, 0.01),
            );
            assert_eq!(a.to_bits(), b.to_bits());
            let (a, b) = (
                score_lines(&block11, &p, 1e-5, 0.01),
                lines::<Plain>(&block11, &p, 1e-5, 0.01),
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
