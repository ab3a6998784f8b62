//! 3x3 convolutions as matrix products whose left-hand rows overlap.

use super::{
    elementwise::copy_short,
    gemm::{Packed, Rows, Tile, panel_width, run_panel},
};
use crate::simd::kernels::{Lanes, entry};

/// A 3x3 convolution: `relu?(conv + bias + residual)`.
pub(in crate::nn::cpu) struct Convolution<'a> {
    /// Input pixels.
    pub(in crate::nn::cpu) x: Rows<'a>,
    /// Height and width of the input.
    pub(in crate::nn::cpu) in_size: [usize; 2],
    /// The first row of the output that is computed.
    pub(in crate::nn::cpu) first_row: usize,
    /// Rows to compute and width of the output.
    pub(in crate::nn::cpu) out_size: [usize; 2],
    /// 1 or 2.
    pub(in crate::nn::cpu) step: usize,
    /// Weights, depth in the order tap row, tap column, channel.
    pub(in crate::nn::cpu) matrix: &'a Packed,
    /// Added to the result, from the first row computed on.
    pub(in crate::nn::cpu) residual: Option<Rows<'a>>,
    /// Whether negative results become zero.
    pub(in crate::nn::cpu) relu: bool,
    /// Result pixels, from the first row computed on.
    pub(in crate::nn::cpu) out: &'a mut [f32],
    /// Room for [`band_len`] numbers.
    pub(in crate::nn::cpu) band: &'a mut [f32],
}

/// Numbers of scratch that a convolution needs: three input rows with a border of one pixel.
pub(in crate::nn::cpu) fn band_len(width: usize, channels: usize) -> usize {
    3 * (width + 2) * channels
}

/// Where a weight `[out, in, 3, 3]` has the number that belongs to step `k` of the depth and column `n`.
pub(in crate::nn::cpu) fn weight_index(channels: usize, k: usize, n: usize) -> usize {
    let (tap, channel) = (k / channels, k % channels);
    let (tap_x, tap_y) = (tap / 3, tap % 3);
    (n * channels + channel) * 9 + tap_y * 3 + tap_x
}

/// Computes a 3x3 convolution.
pub(in crate::nn::cpu) fn convolution(convolution: Convolution<'_>) {
    conv(convolution.matrix.level, convolution);
}

entry! { fn conv(convolution: Convolution<'_>) => conv_lanes }

/// For each output row, three input rows are copied into a band `[column][row][channel]` with an empty pixel at each end.
/// There the nine taps of an output pixel are one run of `9 * channels` numbers, and the next pixel's run starts
/// `3 * step * channels` further on: a matrix product whose left-hand rows overlap.
#[inline(always)]
fn conv_lanes<L: Lanes>(convolution: Convolution<'_>) {
    let Convolution {
        x,
        in_size: [in_height, in_width],
        first_row,
        out_size,
        step,
        matrix,
        residual,
        relu,
        out,
        band,
    } = convolution;
    let [out_height, out_width] = out_size;
    let channels = x.channels;
    x.check();
    assert_eq!(x.rows, in_height * in_width, "pixels of a picture");
    assert_eq!(9 * channels, matrix.depth, "depth of a convolution");
    assert!(
        out_height * out_width * matrix.columns <= out.len(),
        "room for a convolution"
    );
    assert!(
        (out_width - 1) * step + 3 <= in_width + 2,
        "width of a convolution"
    );
    if let Some(residual) = residual {
        residual.check();
        assert!(
            residual.rows >= out_height * out_width && residual.channels >= matrix.columns,
            "size of a residual"
        );
    }
    let column_len = 3 * channels;
    let band = &mut band[..(in_width + 2) * column_len];
    band[..column_len].fill(0.0);
    band[(in_width + 1) * column_len..].fill(0.0);
    for out_y in 0..out_height {
        let inside = &mut band[column_len..(in_width + 1) * column_len];
        for tap in 0..3 {
            let row = ((first_row + out_y) * step + tap).wrapping_sub(1);
            let places = inside
                .chunks_exact_mut(column_len)
                .map(|column| &mut column[tap * channels..][..channels]);
            if row >= in_height {
                places.for_each(|place| place.fill(0.0));
            } else if channels == 1 {
                let pixels = x.data[row * in_width * x.stride..].iter().step_by(x.stride);
                places
                    .zip(pixels)
                    .for_each(|(place, pixel)| place[0] = *pixel);
            } else {
                let pixels = x.data[row * in_width * x.stride..].chunks(x.stride);
                places
                    .zip(pixels)
                    .for_each(|(place, pixel)| copy_short::<L>(&pixel[..channels], place));
            }
        }
        let pixel = out_y * out_width;
        let mut first = 0;
        while first < matrix.columns {
            let width = panel_width(L::LANES, matrix.columns - first);
            let tile = Tile {
                a: band.as_ptr(),
                depth: matrix.depth,
                a_stride: step * column_len,
                b: matrix.panels[first * matrix.depth..].as_ptr(),
                bias: matrix.bias[first..].as_ptr(),
                c: out[pixel * matrix.columns + first..].as_mut_ptr(),
                c_stride: matrix.columns,
                columns: width.min(matrix.columns - first),
                residual: residual.map_or(std::ptr::null(), |r| {
                    r.data[pixel * r.stride + first..].as_ptr()
                }),
                residual_stride: residual.map_or(0, |r| r.stride),
                relu,
            };
            // SAFETY: sizes were checked above; the run of the last pixel ends at `(out_width - 1) * step + 3` columns, which
            // is within the band; panels and bias are padded to whole vectors by `Packed`.
            unsafe { run_panel::<L>(out_width, width == L::LANES, &tile) };
            first += width;
        }
    }
}
