//! 3x3 convolutions of stride 1 by Winograd's minimal filtering F(4x4, 3x3), where there are channels enough.
//!
//! A patch of 6x6 pixels gives 4x4 results. Patches and filters are transformed so that a result takes one product for each of
//! 36 positions instead of nine for each of 16 pixels: a quarter of the multiplications, as 36 matrix products over patches.
//! Source: `[winograd2016]`, with its points 0, ±1, ±2. Sums round about five times as coarsely as the direct ones, fifteen times
//! at a patch's last pixel.

use super::{
    conv3x3::{Convolution, weight_index},
    gemm::{Packed, Tile, panel_width, run_panel},
};
use crate::simd::kernels::{Lanes, Level, entry};

/// Results along each side of a patch.
const OUT: usize = 4;
/// Pixels along each side of a patch.
const IN: usize = 6;
/// Products of a patch.
pub(in crate::nn::cpu) const POSITIONS: usize = IN * IN;
/// Patches that are transformed before they are multiplied, at most: with 64 channels they fill about half of the second cache.
const MAX_BLOCK: usize = 32;
/// Numbers of a block at each position.
const BLOCK_NUMBERS: usize = MAX_BLOCK * 2 * 64;
/// Fewer channels leave too little between the transforms.
const MIN_CHANNELS: usize = 16;
/// Numbers between the positions' blocks, so that these do not fall on the same lines of the cache.
const GAP: usize = 16;

/// Whether a convolution of stride 1 is computed this way: with whole vectors of channels, and where the filters, which grow to
/// four times their size, do not grow by more numbers than the pictures before and after have. Small pictures with many channels
/// would take megabytes for little time, and their patches are mostly border.
pub(in crate::nn::cpu) fn fits(level: Level, inner: usize, out: usize, pixels: usize) -> bool {
    let whole =
        |channels: usize| channels >= MIN_CHANNELS && channels.is_multiple_of(level.lanes());
    whole(inner) && whole(out) && (POSITIONS - 9) * inner * out <= pixels * (inner + out)
}

/// Patches that are transformed before they are multiplied.
fn block(inner: usize, out: usize) -> usize {
    (BLOCK_NUMBERS / (inner + out)).clamp(1, MAX_BLOCK)
}

/// Packs filters `[out, in, 3, 3]`, transformed: depth in the order position, channel.
pub(in crate::nn::cpu) fn pack(
    level: Level,
    inner: usize,
    out: usize,
    bias: Option<&[f32]>,
    filters: &[f32],
) -> Packed {
    // G of the source, by rows.
    const G: [[f64; 3]; IN] = [
        [1.0 / 4.0, 0.0, 0.0],
        [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
        [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
        [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
        [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
        [0.0, 0.0, 1.0],
    ];
    Packed::new(level, POSITIONS * inner, out, bias, |k, n| {
        let (position, channel) = (k / inner, k % inner);
        let (row, column) = (position / IN, position % IN);
        let mut sum = 0.0;
        for (y, by_row) in G[row].iter().enumerate() {
            for (x, by_column) in G[column].iter().enumerate() {
                let tap = (3 * x + y) * inner + channel;
                sum += by_row * by_column * f64::from(filters[weight_index(inner, tap, n)]);
            }
        }
        sum as f32
    })
}

/// Numbers of scratch that a convolution needs: a block of patches before and after the products, and one patch as it is.
pub(in crate::nn::cpu) fn scratch_len(inner: usize, out: usize) -> usize {
    POSITIONS * (block(inner, out) * (inner + out) + 2 * GAP + inner)
}

/// Computes a convolution with filters of [`pack`]. The first row must be a multiple of four.
pub(in crate::nn::cpu) fn convolution(convolution: Convolution<'_>) {
    conv(convolution.matrix.level, convolution);
}

entry! { fn conv(convolution: Convolution<'_>) => conv_lanes }

#[inline(always)]
fn conv_lanes<L: Lanes>(convolution: Convolution<'_>) {
    let Convolution {
        x,
        in_size: [in_height, in_width],
        first_row,
        out_size: [out_height, out_width],
        step,
        matrix,
        residual,
        relu,
        out,
        band,
    } = convolution;
    let (inner, columns) = (x.channels, matrix.columns);
    x.check();
    assert_eq!(x.rows, in_height * in_width, "pixels of a picture");
    assert_eq!(POSITIONS * inner, matrix.depth, "depth of a convolution");
    assert!(
        step == 1 && out_width == in_width,
        "stride of a convolution"
    );
    assert!(first_row % OUT == 0, "first row of a part");
    assert!(
        inner % L::LANES == 0 && columns % L::LANES == 0,
        "whole vectors of channels"
    );
    assert!(
        out_height * out_width * columns <= out.len() && first_row + out_height <= in_height,
        "room for a convolution"
    );
    if let Some(residual) = residual {
        residual.check();
        assert!(
            residual.rows >= out_height * out_width && residual.channels >= columns,
            "size of a residual"
        );
    }
    assert!(band.len() >= scratch_len(inner, columns), "scratch");
    let (patch, rest) = band.split_at_mut(POSITIONS * inner);
    let block = block(inner, columns);
    let (before_stride, after_stride) = (block * inner + GAP, block * columns + GAP);
    let (before, rest) = rest.split_at_mut(POSITIONS * before_stride);
    let after = &mut rest[..POSITIONS * after_stride];
    let across = out_width.div_ceil(OUT);
    let patches = out_height.div_ceil(OUT) * across;
    let place = |index: usize| (index / across * OUT, index % across * OUT);
    let mut first = 0;
    while first < patches {
        let count = (patches - first).min(block);
        for index in 0..count {
            let (row, column) = place(first + index);
            let to = before[index * inner..].as_mut_ptr();
            // The patch begins one pixel before its results.
            let top = first_row + row;
            let inside = top >= 1 && top + 5 <= in_height && column >= 1 && column + 5 <= in_width;
            let (from, row_stride, stride) = if inside {
                let pixel = (top - 1) * in_width + column - 1;
                (
                    x.data[pixel * x.stride..].as_ptr(),
                    in_width * x.stride,
                    x.stride,
                )
            } else {
                for (at, place) in patch.chunks_exact_mut(inner).enumerate() {
                    let (y, x_at) = (top + at / IN, column + at % IN);
                    let outside = y < 1 || y > in_height || x_at < 1 || x_at > in_width;
                    if outside {
                        place.fill(0.0);
                    } else {
                        place.copy_from_slice(x.row((y - 1) * in_width + x_at - 1));
                    }
                }
                (patch.as_ptr(), IN * inner, inner)
            };
            // SAFETY: six rows of six pixels lie in the picture or in the copy, `inner` numbers each; `before` has room for
            // `inner` numbers of this patch at each of 36 positions.
            unsafe { to_products::<L>(from, row_stride, stride, inner, to, before_stride) };
        }
        for position in 0..POSITIONS {
            let mut column = 0;
            while column < columns {
                let width = panel_width(L::LANES, columns - column);
                let tile = Tile {
                    a: before[position * before_stride..].as_ptr(),
                    depth: inner,
                    a_stride: inner,
                    b: matrix.panels[column * matrix.depth + position * inner * width..].as_ptr(),
                    bias: std::ptr::null(),
                    c: after[position * after_stride + column..].as_mut_ptr(),
                    c_stride: columns,
                    columns: width,
                    residual: std::ptr::null(),
                    residual_stride: 0,
                    relu: false,
                };
                // SAFETY: `count` rows of `inner` and of `columns` numbers lie in the two blocks; all panels are whole.
                unsafe { run_panel::<L>(count, width == L::LANES, &tile) };
                column += width;
            }
        }
        for index in 0..count {
            let (row, column) = place(first + index);
            let pixel = row * out_width + column;
            let results = Results {
                from: after[index * columns..].as_ptr(),
                position_stride: after_stride,
                bias: matrix.bias.as_ptr(),
                residual: residual
                    .map_or(std::ptr::null(), |r| r.data[pixel * r.stride..].as_ptr()),
                residual_stride: residual.map_or(0, |r| r.stride),
                relu,
                to: out[pixel * columns..].as_mut_ptr(),
                columns,
                out_width,
                size: [(out_height - row).min(OUT), (out_width - column).min(OUT)],
            };
            // SAFETY: the sizes of all parts were checked above; `size` ends where the picture does.
            unsafe { from_products::<L>(&results) };
        }
        first += count;
    }
}

/// `Bᵀ d` of six vectors.
#[inline(always)]
fn patch_transform<L: Lanes>(d: [L; IN]) -> [L; IN] {
    let (minus_4, minus_5) = (L::splat(-4.0), L::splat(-5.0));
    let (two, four) = (L::splat(2.0), L::splat(4.0));
    let (even, odd) = (d[4].mul_add(minus_4, d[2]), d[3].mul_add(minus_4, d[1]));
    let (far_even, far_odd) = (d[4].sub(d[2]), two.mul(d[3].sub(d[1])));
    [
        d[4].mul_add(minus_5, d[2]).mul_add(four, d[0]),
        even.add(odd),
        even.sub(odd),
        far_even.add(far_odd),
        far_even.sub(far_odd),
        d[5].mul_add(minus_5, d[3]).mul_add(four, d[1]),
    ]
}

/// `Aᵀ m` of six vectors.
#[inline(always)]
fn result_transform<L: Lanes>(m: [L; IN]) -> [L; OUT] {
    let (near_sum, near) = (m[1].add(m[2]), m[1].sub(m[2]));
    let (far_sum, far) = (m[3].add(m[4]), m[3].sub(m[4]));
    [
        m[0].add(near_sum).add(far_sum),
        near.mul_add(L::splat(2.0), far),
        near_sum.mul_add(L::splat(4.0), far_sum),
        near.add(m[5]).mul_add(L::splat(8.0), far),
    ]
}

/// Transforms a patch of `channels` numbers a pixel and puts position `p` at `to + p * position_stride`. A function of its own,
/// as `run_panel`.
///
/// # Safety
/// Six rows of six pixels can be read, 36 times `channels` numbers written; `channels` is a multiple of the lanes.
#[cfg_attr(target_arch = "wasm32", inline(never))]
#[cfg_attr(not(target_arch = "wasm32"), inline(always))]
#[cfg_attr(
    all(target_arch = "wasm32", feature = "relaxed-simd"),
    target_feature(enable = "relaxed-simd")
)]
unsafe fn to_products<L: Lanes>(
    from: *const f32,
    row_stride: usize,
    stride: usize,
    channels: usize,
    to: *mut f32,
    position_stride: usize,
) {
    let mut columns = [[L::splat(0.0); IN]; IN];
    for first in (0..channels).step_by(L::LANES) {
        // SAFETY: the caller vouches for the places.
        unsafe {
            for (x, column) in columns.iter_mut().enumerate() {
                let from = from.add(x * stride + first);
                let pixels = std::array::from_fn(|y| L::load(from.add(y * row_stride)));
                *column = patch_transform(pixels);
            }
            #[allow(
                clippy::needless_range_loop,
                reason = "rows of columns: y is the inner index"
            )]
            for y in 0..IN {
                let row = patch_transform(std::array::from_fn(|x| columns[x][y]));
                for (x, number) in row.into_iter().enumerate() {
                    number.store(to.add((IN * y + x) * position_stride + first));
                }
            }
        }
    }
}

/// Where a patch's products are and where its results go.
struct Results {
    /// The products of the first position.
    from: *const f32,
    /// Numbers from one position to the next.
    position_stride: usize,
    /// Of all columns.
    bias: *const f32,
    /// Added to the results, from the patch's first pixel on; null for nothing.
    residual: *const f32,
    residual_stride: usize,
    relu: bool,
    to: *mut f32,
    /// Numbers of a pixel.
    columns: usize,
    out_width: usize,
    /// Rows and columns of the patch that lie in the picture.
    size: [usize; 2],
}

/// Transforms a patch's products into its results. A function of its own, as `run_panel`.
///
/// # Safety
/// All pointers are valid for the sizes; `columns` is a multiple of the lanes.
#[cfg_attr(target_arch = "wasm32", inline(never))]
#[cfg_attr(not(target_arch = "wasm32"), inline(always))]
#[cfg_attr(
    all(target_arch = "wasm32", feature = "relaxed-simd"),
    target_feature(enable = "relaxed-simd")
)]
unsafe fn from_products<L: Lanes>(results: &Results) {
    let zero = L::splat(0.0);
    let mut columns = [[zero; OUT]; IN];
    for first in (0..results.columns).step_by(L::LANES) {
        // SAFETY: the caller vouches for the places.
        unsafe {
            for (x, column) in columns.iter_mut().enumerate() {
                let from = results.from.add(x * results.position_stride + first);
                let row = IN * results.position_stride;
                *column = result_transform(std::array::from_fn(|y| L::load(from.add(y * row))));
            }
            let bias = L::load(results.bias.add(first));
            #[allow(
                clippy::needless_range_loop,
                reason = "rows of columns: y is the inner index"
            )]
            for y in 0..results.size[0] {
                let row = result_transform(std::array::from_fn(|x| columns[x][y]));
                for (x, number) in row.into_iter().enumerate().take(results.size[1]) {
                    let pixel = y * results.out_width + x;
                    let mut number = number.add(bias);
                    if !results.residual.is_null() {
                        let residual = results.residual.add(pixel * results.residual_stride);
                        number = number.add(L::load(residual.add(first)));
                    }
                    if results.relu {
                        number = number.max(zero);
                    }
                    number.store(results.to.add(pixel * results.columns + first));
                }
            }
        }
    }
}
