//! Every kernel on every level, beside its definition in plain sums.

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

/// Bilinear value at index coordinates, in double precision.
fn between(data: &[u8], stride: usize, [x, y]: [f64; 2]) -> f64 {
    let (left, top) = (x.floor(), y.floor());
    let pixel =
        |dx: usize, dy: usize| f64::from(data[(top as usize + dy) * stride + left as usize + dx]);
    let [u, v] = [x - left, y - top];
    (1.0 - v) * ((1.0 - u) * pixel(0, 0) + u * pixel(1, 0))
        + v * ((1.0 - u) * pixel(0, 1) + u * pixel(1, 1))
}

fn noise(seed: u64, count: usize) -> Vec<u8> {
    let mut rng = Rng::from_seed(seed);
    (0..count).map(|_| rng.range(0.0, 256.0) as u8).collect()
}

#[test]
fn squares_are_sampled_between_pixels() {
    let stride = 60;
    let data = noise(6, stride * 50);
    for level in Level::available() {
        for side in [RIM, 26] {
            let (shift, corner) = ([0.3_f32, 0.8_f32], [9_usize, 7_usize]);
            let mut out = vec![-1.0; side * side];
            let place = Place {
                data: &data,
                stride,
                first: corner[1] * stride + corner[0],
                shift,
            };
            let out_of = Straight {
                place,
                side,
                out: &mut out,
            };
            sample_straight(level, out_of);
            let half = 0.5 * (side as f32 - 1.0);
            let check = |out: &[f32], center: [f32; 2], map: [f32; 4]| {
                for (i, found) in out.iter().enumerate() {
                    let offset = [i % side, i / side].map(|i| f64::from(i as f32 - half));
                    let [xx, xy, yx, yy] = map.map(f64::from);
                    let at = [
                        f64::from(center[0]) + xx * offset[0] + xy * offset[1],
                        f64::from(center[1]) + yx * offset[0] + yy * offset[1],
                    ];
                    let expected = between(&data, stride, at);
                    assert!(
                        (f64::from(*found) - expected).abs() < 2e-3,
                        "{} {side} {i}: {found} instead of {expected}",
                        level.name()
                    );
                }
            };
            let center = [0, 1].map(|i| corner[i] as f32 + shift[i] + half);
            check(&out, center, [1.0, 0.0, 0.0, 1.0]);
            let (center, map) = ([27.3, 24.1], [1.1, -0.2, 0.15, 0.9]);
            let work = Warped {
                data: &data,
                stride,
                center,
                map,
                side,
                out: &mut out,
            };
            sample_warped(level, work);
            check(&out, center, map);
        }
    }
}

#[test]
fn positions_outside_a_picture_read_nothing_else() {
    let data = noise(7, 40 * 30);
    for center in [[-50.0, 3.0], [1e9, -1e9], [f32::NAN, f32::INFINITY]] {
        let mut out = [-1.0; RIM * RIM];
        let work = Warped {
            data: &data,
            stride: 40,
            center,
            map: [1.0, 0.3, -0.3, 1.0],
            side: RIM,
            out: &mut out,
        };
        // Whatever comes out: memory beyond the picture would be seen by the checkers of the tests' machines.
        sample_warped(Level::best(), work);
        assert_ne!(out[0], -1.0);
    }
}

#[test]
fn rows_know_nothing_of_light() {
    let stride = 26;
    let rim: Vec<f32> = noise(8, stride * RIM).into_iter().map(f32::from).collect();
    let at = |x: usize, y: usize| f64::from(rim[y * stride + x]);
    for level in Level::available() {
        let (mut across, mut down, mut gray) = ([0.0; AREA], [0.0; AREA], [0.0; AREA]);
        let mut moments = Moments::default();
        let work = Making {
            rim: &rim,
            stride,
            across: &mut across,
            down: &mut down,
            gray: &mut gray,
            moments: &mut moments,
        };
        make_rows(level, work);
        let [mut one, mut own, mut xx, mut xy, mut mean] = [0.0; 5];
        for i in 0..AREA {
            let (x, y) = (i % SIDE + 1, i / SIDE + 1);
            let slope = |dy: usize| at(x + 1, y + dy - 1) - at(x - 1, y + dy - 1);
            let plain = (3.0 * (slope(0) + slope(2)) + 10.0 * slope(1)) / 32.0;
            let [a, d, g] = [across[i], down[i], gray[i]].map(f64::from);
            // What was taken out is in the moments.
            let taken = f64::from(moments.mean[0]) + f64::from(moments.share[0]) * g;
            assert!((a + taken - plain).abs() < 1e-3);
            assert!((g + f64::from(moments.gray) - at(x, y)).abs() < 1e-3);
            (one, own) = (one + a, own + a * g);
            (xx, xy, mean) = (xx + a * a, xy + a * d, mean + plain * plain);
        }
        assert!(one.abs() < 1.0 && own.abs() < 50.0, "{one} {own}");
        for (found, expected) in [
            (moments.free[0], xx),
            (moments.free[1], xy),
            (moments.plain[0], mean),
        ] {
            let off = (f64::from(found) - expected).abs();
            assert!(off < 1e-4 * xx, "{}: {off} of {xx}", level.name());
        }
    }
}

#[test]
fn numbers_become_their_nearest_bytes() {
    let from = [0.0, 0.49, 0.51, 254.6, 255.0, 300.0, -4.0, f32::NAN];
    let mut to = [9; 8];
    for level in Level::available() {
        let work = Rounding {
            from: &from,
            to: &mut to,
        };
        round_to_bytes(level, work);
        assert_eq!(to, [0, 0, 1, 255, 255, 255, 0, 0]);
    }
}
