//! Inner loops over pixels, written so that the compiler turns them into vector instructions.
//!
//! Every kernel fixes the order of its operations, so that all targets give the same bits.

/// Taps of the Gaussian at the default scale.
pub(super) const TAPS: usize = 7;

/// Gaussian weights of the default scale 0.8 (sigma 0.75), one row for each of the four positions that output pixels
/// take between input pixels: `exp(-((i - 3 - d) / sigma)^2 / 2)`, d = 0, 1/4, -1/2, -1/4, divided by their sum.
/// Written out so that no platform's `exp` can change the working image.
pub(super) const DEFAULT_WEIGHTS: [[f64; TAPS]; 4] = [
    [
        0.0001784350521142698,
        0.015194201073994835,
        0.21867366698977017,
        0.5319073937682415,
        0.21867366698977017,
        0.015194201073994835,
        0.0001784350521142698,
    ],
    [
        4.4494573961658886e-05,
        0.005909143270376185,
        0.13263645563102622,
        0.5031786633919941,
        0.3226282908433441,
        0.03496259011415208,
        0.0006403621751456356,
    ],
    [
        0.0020564543955111296,
        0.071990839965367,
        0.42594774140962877,
        0.42594774140962877,
        0.071990839965367,
        0.0020564543955111296,
        9.928458986122591e-06,
    ],
    [
        0.0006403621751456356,
        0.03496259011415208,
        0.3226282908433441,
        0.5031786633919941,
        0.13263645563102622,
        0.005909143270376185,
        4.4494573961658886e-05,
    ],
];
/// First input pixel of the window of output `4k + r`, relative to `5k - 3`.
pub(super) const DEFAULT_STARTS: [usize; 4] = [0, 1, 3, 4];

/// Samples one row at the default scale. `padded` is the row with three mirrored pixels in front and enough behind
/// (at least four, and eleven from the start of each group of four outputs).
pub(super) fn sample_row_default(padded: &[f64], out: &mut [f64]) {
    let groups = out.len() / 4;
    let (whole, rest) = out.as_chunks_mut::<4>();
    for (k, four) in whole.iter_mut().enumerate() {
        let Some(w) = padded[5 * k..].first_chunk::<11>() else {
            return;
        };
        // Lanes (0, 1) and (2, 3) read neighbouring inputs, so that each pair is one vector.
        let [mut a, mut b, mut c, mut d] = [0.0f64; 4];
        for i in 0..TAPS {
            a += DEFAULT_WEIGHTS[0][i] * w[i];
            b += DEFAULT_WEIGHTS[1][i] * w[i + 1];
            c += DEFAULT_WEIGHTS[2][i] * w[i + 3];
            d += DEFAULT_WEIGHTS[3][i] * w[i + 4];
        }
        *four = [a, b, c, d];
    }
    for (r, out) in rest.iter_mut().enumerate() {
        *out = DEFAULT_WEIGHTS[r]
            .iter()
            .zip(&padded[5 * groups + DEFAULT_STARTS[r]..])
            .fold(0.0, |sum, (w, v)| sum + w * v);
    }
}

/// Weighted sum of seven rows, in their order.
pub(super) fn combine_rows_default(rows: [&[f64]; TAPS], weights: &[f64; TAPS], out: &mut [f64]) {
    let n = out.len();
    let rows = rows.map(|row| &row[..n]);
    for x in 0..n {
        let mut sum = weights[0] * rows[0][x];
        for i in 1..TAPS {
            sum += weights[i] * rows[i][x];
        }
        out[x] = sum;
    }
}

/// Level-line vectors of one row of 2x2 blocks: `dx = -gy`, `dy = gx` and the squared length of twice the gradient.
pub(super) fn level_lines(
    upper: &[f64],
    lower: &[f64],
    dx: &mut [f64],
    dy: &mut [f64],
    square: &mut [f64],
) {
    let n = square.len();
    let (upper, lower) = (&upper[..n + 1], &lower[..n + 1]);
    let (dx, dy) = (&mut dx[..n], &mut dy[..n]);
    for x in 0..n {
        let (falling, rising) = (lower[x + 1] - upper[x], upper[x + 1] - lower[x]);
        let (gx, gy) = (falling + rising, falling - rising);
        dx[x] = -gy;
        dy[x] = gx;
        square[x] = gx * gx + gy * gy;
    }
}

/// Positions where `square` is above `threshold` and finite, in order; returns how many. `found` is as long as `square`.
pub(super) fn select_above(square: &[f64], threshold: f64, found: &mut [u16]) -> usize {
    let mut count = 0;
    for (x, &value) in square.iter().enumerate() {
        found[count] = x as u16;
        count += usize::from(value > threshold && value < f64::INFINITY);
    }
    count
}
