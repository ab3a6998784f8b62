//! 3x3 convolutions as matrix products whose left-hand rows overlap.

use super::{
    gemm::{Packed, Rows, Tile, panel_width, run_panel},
    lanes::{Lanes, entry},
};

/// A 3x3 convolution: `relu?(conv + bias + residual)`.
pub(in crate::nn::cpu) struct Convolution<'a> {
    /// Input pixels.
    pub(in crate::nn::cpu) x: Rows<'a>,
    /// Height and width of the input.
    pub(in crate::nn::cpu) in_size: [usize; 2],
    /// Height and width of the output.
    pub(in crate::nn::cpu) out_size: [usize; 2],
    /// 1 or 2.
    pub(in crate::nn::cpu) step: usize,
    /// Weights, depth in the order tap row, tap column, channel.
    pub(in crate::nn::cpu) matrix: &'a Packed,
    /// Added to the result.
    pub(in crate::nn::cpu) residual: Option<Rows<'a>>,
    /// Whether negative results become zero.
    pub(in crate::nn::cpu) relu: bool,
    /// Result pixels.
    pub(in crate::nn::cpu) out: &'a mut [f32],
    /// Room for [`band_len`] numbers.
    pub(in crate::nn::cpu) band: &'a mut [f32],
}

/// Numbers of scratch that a convolution needs: three input rows and an empty one, each with a border of one pixel.
pub(in crate::nn::cpu) fn band_len(width: usize, channels: usize) -> usize {
    4 * (width + 2) * channels
}

/// Computes a 3x3 convolution.
pub(in crate::nn::cpu) fn convolution(convolution: Convolution<'_>) {
    conv(convolution.matrix.level, convolution);
}

entry! { fn conv(convolution: Convolution<'_>) => conv_lanes }

/// With channels last the three taps of one tap row are neighbours in memory, so an output pixel's input is three pieces
/// of `3 * channels` numbers, and the next pixel's pieces start `step * channels` further on: a matrix product whose
/// left-hand rows overlap. Only the border needs care: input rows are copied into a band with an empty pixel at each end.
#[inline(always)]
fn conv_lanes<L: Lanes>(convolution: Convolution<'_>) {
    let Convolution {
        x,
        in_size: [in_height, in_width],
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
    let row_len = (in_width + 2) * channels;
    let band = &mut band[..4 * row_len];
    for row in 0..3 {
        band[row * row_len..][..channels].fill(0.0);
        band[(row + 1) * row_len - channels..][..channels].fill(0.0);
    }
    band[3 * row_len..].fill(0.0);
    // Input rows below this one are in the band, row `r` at place `r % 3`.
    let mut loaded = 0;
    for out_y in 0..out_height {
        let last = (out_y * step + 1).min(in_height - 1);
        loaded = loaded.max((out_y * step).saturating_sub(1));
        while loaded <= last {
            let place = &mut band[(loaded % 3) * row_len + channels..][..in_width * channels];
            for (pixel, to) in place.chunks_exact_mut(channels).enumerate() {
                to.copy_from_slice(x.row(loaded * in_width + pixel));
            }
            loaded += 1;
        }
        let mut a = [std::ptr::null(); 3];
        for (tap, a) in a.iter_mut().enumerate() {
            let row = (out_y * step + tap).wrapping_sub(1);
            let place = if row < in_height { row % 3 } else { 3 };
            *a = band[place * row_len..][..row_len].as_ptr();
        }
        let pixel = out_y * out_width;
        let mut first = 0;
        while first < matrix.columns {
            let width = panel_width(L::LANES, matrix.columns - first);
            let tile = Tile {
                a,
                pieces: 3,
                depth: 3 * channels,
                a_stride: step * channels,
                b: matrix.panels[first * matrix.depth..].as_ptr(),
                b_stride: width,
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
            // SAFETY: sizes were checked above; a piece of the last pixel ends at `(out_width - 1) * step + 3` pixels, which
            // is within the band's row; panels and bias are padded to whole vectors by `Packed`.
            unsafe { run_panel::<L>(out_width, width == L::LANES, &tile) };
            first += width;
        }
    }
}
