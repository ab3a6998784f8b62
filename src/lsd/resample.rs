//! Gaussian resampling: filter and interpolation in one step, rows streamed through a ring buffer.
//!
//! Source: `[lsd2012]`, section on the Gaussian sub-sampling. The grids of input and output share their origin: output
//! pixel `u` lies at input position `u / scale`. Borders mirror (the border pixel is repeated once).

use super::kernels::{self, DEFAULT_WEIGHTS, TAPS};

/// A sample type of input images.
pub(super) trait Sample: Copy {
    fn level(self) -> f64;
}

impl Sample for u8 {
    fn level(self) -> f64 {
        f64::from(self)
    }
}

impl Sample for f64 {
    fn level(self) -> f64 {
        self
    }
}

/// Rows of the input image.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a, T> {
    pub(super) data: &'a [T],
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) stride: usize,
}

impl<'a, T: Sample> Rows<'a, T> {
    fn row(&self, y: usize) -> &'a [T] {
        &self.data[y * self.stride..][..self.width]
    }
}

/// Where along one axis an output pixel takes its input, and its weights.
#[derive(Debug, Default)]
struct AxisTable {
    /// First input index of the window, may be negative.
    starts: Vec<i64>,
    /// `taps` weights for each output pixel.
    weights: Vec<f64>,
}

/// The filter of one pair of scale and blur, with the buffers that streaming needs.
#[derive(Debug, Default)]
pub(super) struct Resampler {
    scale: f64,
    sigma_scale: f64,
    size_in: (usize, usize),
    half: usize,
    /// Empty at the default scale and blur, which have a kernel of their own.
    columns: AxisTable,
    rows: AxisTable,
    padded: Vec<f64>,
    ring: Vec<f64>,
    /// Input rows that have gone into the ring.
    num_filtered: usize,
    width_out: usize,
}

const DEFAULT_SCALE: f64 = 0.8;
const DEFAULT_SIGMA_SCALE: f64 = 0.6;

impl Resampler {
    /// Prepares for a picture. `size_out` is not checked here; both sides are at least 2.
    pub(super) fn prepare(
        &mut self,
        size_in: (usize, usize),
        size_out: (usize, usize),
        scale: f64,
        sigma_scale: f64,
    ) {
        self.num_filtered = 0;
        if (self.scale, self.sigma_scale, self.size_in) == (scale, sigma_scale, size_in) {
            return;
        }
        (self.scale, self.sigma_scale, self.size_in) = (scale, sigma_scale, size_in);
        self.width_out = size_out.0;
        self.columns = AxisTable::default();
        self.rows = AxisTable::default();
        if scale == 1.0 {
            self.half = 0;
        } else if self.is_default() {
            self.half = TAPS / 2;
        } else {
            let sigma = if scale < 1.0 {
                sigma_scale / scale
            } else {
                sigma_scale
            };
            // Beyond this the weights are below 1/1000 of the largest.
            let reach = sigma * libm::sqrt(2.0 * 3.0 * core::f64::consts::LN_10);
            self.half = libm::ceil(reach) as usize;
            self.columns = axis_table(size_out.0, scale, sigma, self.half);
            self.rows = axis_table(size_out.1, scale, sigma, self.half);
        }
        // The default kernel reads groups of eleven.
        self.padded.clear();
        self.padded.resize(size_in.0 + 2 * self.half + 16, 0.0);
        self.ring.clear();
        self.ring.resize(self.taps() * self.width_out, 0.0);
    }

    fn is_default(&self) -> bool {
        (self.scale, self.sigma_scale) == (DEFAULT_SCALE, DEFAULT_SIGMA_SCALE)
    }

    fn taps(&self) -> usize {
        2 * self.half + 1
    }

    /// Writes row `v` of the working image; rows must be asked for in ascending order from 0.
    pub(super) fn row<T: Sample>(&mut self, image: &Rows<'_, T>, v: usize, out: &mut [f64]) {
        if self.scale == 1.0 {
            for (out, value) in out.iter_mut().zip(image.row(v)) {
                *out = value.level();
            }
            return;
        }
        let taps = self.taps();
        let start = if self.is_default() {
            (5 * (v / 4) + kernels::DEFAULT_STARTS[v % 4]) as i64 - 3
        } else {
            self.rows.starts[v]
        };
        let last = (start + taps as i64 - 1).clamp(0, image.height as i64 - 1) as usize;
        while self.num_filtered <= last {
            self.filter_row(image.row(self.num_filtered));
        }
        let n = self.width_out;
        let ring_row = |i: usize| {
            let y = mirror(start + i as i64, image.height);
            &self.ring[y % taps * n..][..n]
        };
        if self.is_default() {
            let rows: [&[f64]; TAPS] = core::array::from_fn(ring_row);
            kernels::combine_rows_default(rows, &DEFAULT_WEIGHTS[v % 4], out);
        } else {
            out.fill(0.0);
            let weights = &self.rows.weights[v * taps..][..taps];
            for (i, &weight) in weights.iter().enumerate() {
                for (sum, &value) in out.iter_mut().zip(ring_row(i)) {
                    *sum += weight * value;
                }
            }
        }
    }

    fn filter_row<T: Sample>(&mut self, row: &[T]) {
        let (n, taps, half) = (self.width_out, self.taps(), self.half);
        for (padded, value) in self.padded[half..].iter_mut().zip(row) {
            *padded = value.level();
        }
        let width = row.len();
        for i in 0..half {
            let left = mirror(-1 - i as i64, width);
            self.padded[half - 1 - i] = row[left].level();
        }
        for i in 0..self.padded.len() - half - width {
            let right = mirror((width + i) as i64, width);
            self.padded[half + width + i] = row[right].level();
        }
        let slot = self.num_filtered % taps;
        let out = &mut self.ring[slot * n..][..n];
        if (self.scale, self.sigma_scale) == (DEFAULT_SCALE, DEFAULT_SIGMA_SCALE) {
            kernels::sample_row_default(&self.padded, out);
        } else {
            let table = &self.columns;
            let weights = table.weights.chunks_exact(taps);
            for ((out, &start), weights) in out.iter_mut().zip(&table.starts).zip(weights) {
                let window = &self.padded[(start + half as i64) as usize..][..taps];
                *out = weights
                    .iter()
                    .zip(window)
                    .fold(0.0, |sum, (w, v)| sum + w * v);
            }
        }
        self.num_filtered += 1;
    }
}

fn axis_table(len_out: usize, scale: f64, sigma: f64, half: usize) -> AxisTable {
    let taps = 2 * half + 1;
    let mut table = AxisTable {
        starts: Vec::with_capacity(len_out),
        weights: Vec::with_capacity(len_out * taps),
    };
    for u in 0..len_out {
        let position = u as f64 / scale;
        let nearest = libm::floor(position + 0.5);
        table.starts.push(nearest as i64 - half as i64);
        let mean = half as f64 + position - nearest;
        let first = table.weights.len();
        let mut sum = 0.0;
        for i in 0..taps {
            let z = (i as f64 - mean) / sigma;
            let weight = libm::exp(-0.5 * z * z);
            sum += weight;
            table.weights.push(weight);
        }
        for weight in &mut table.weights[first..] {
            *weight /= sum;
        }
    }
    table
}

/// Index into a signal of `len` samples that continues as its mirror image, border samples repeated.
fn mirror(index: i64, len: usize) -> usize {
    let len = len as i64;
    if (0..len).contains(&index) {
        return index as usize;
    }
    let folded = index.rem_euclid(2 * len);
    (if folded < len {
        folded
    } else {
        2 * len - 1 - folded
    }) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resample(data: &[f64], w: usize, h: usize, scale: f64, sigma_scale: f64) -> Vec<f64> {
        let (n, m) = (
            libm::ceil(w as f64 * scale) as usize,
            libm::ceil(h as f64 * scale) as usize,
        );
        let rows = Rows {
            data,
            width: w,
            height: h,
            stride: w,
        };
        let mut r = Resampler::default();
        r.prepare((w, h), (n, m), scale, sigma_scale);
        let mut out = vec![0.0; n * m];
        for (v, row) in out.chunks_exact_mut(n).enumerate() {
            r.row(&rows, v, row);
        }
        out
    }

    #[test]
    fn mirror_repeats_the_border() {
        let got: Vec<usize> = (-5..8).map(|i| mirror(i, 3)).collect();
        assert_eq!(got, [1, 2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1]);
        assert_eq!(mirror(-7, 1), 0);
    }

    #[test]
    fn default_positions_are_exact() {
        // What the default kernel builds on.
        for u in 0..65_535u32 {
            assert_eq!(f64::from(u) / 0.8, 1.25 * f64::from(u));
        }
        let table = axis_table(16, 0.8, 0.6 / 0.8, 3);
        for u in 0..16 {
            let start = (5 * (u / 4) + kernels::DEFAULT_STARTS[u % 4]) as i64 - 3;
            assert_eq!(table.starts[u], start, "{u}");
            for (i, b) in DEFAULT_WEIGHTS[u % 4].into_iter().enumerate() {
                let a = table.weights[u * TAPS + i];
                assert!((a - b).abs() <= 1e-15 * b, "{u} {i}: {a} {b}");
            }
        }
    }

    #[test]
    fn default_kernel_equals_the_general_one_at_every_size() {
        for (w, h) in [(2, 2), (3, 9), (5, 4), (9, 3), (17, 23), (64, 48)] {
            let data: Vec<f64> = (0..w * h).map(|i| (i * 37 % 256) as f64).collect();
            let fast = resample(&data, w, h, 0.8, 0.6);
            let general = resample(&data, w, h, 0.8, 0.6 + 1e-13);
            assert_eq!(fast.len(), general.len());
            for (a, b) in fast.iter().zip(&general) {
                assert!((a - b).abs() < 1e-9, "{w}x{h}: {a} {b}");
            }
        }
    }

    #[test]
    fn constant_images_stay_constant_and_ramps_stay_linear() {
        for scale in [0.3, 0.5, 0.8, 0.9, 1.0, 1.5] {
            let flat = resample(&[7.0; 30 * 20], 30, 20, scale, 0.6);
            assert!(flat.iter().all(|v| (v - 7.0).abs() < 1e-12));
            let data: Vec<f64> = (0..60 * 60).map(|i| (i % 60) as f64).collect();
            let out = resample(&data, 60, 60, scale, 0.6);
            let n = libm::ceil(60.0 * scale) as usize;
            for u in n / 3..n / 2 {
                let want = u as f64 / scale;
                assert!((out[n * (n / 2) + u] - want).abs() < 0.02, "{scale} {u}");
            }
        }
    }
}
