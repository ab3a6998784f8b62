//! Activations, sums, resizing, pooling and sampling: everything that goes over the channels of one row at a time.

use super::{
    attention::{add_scaled, scale_row},
    gemm::Rows,
};
use crate::nn::op::{Activation, AxisMap, Filter};
use crate::simd::kernels::{Lanes, entry};

#[inline(always)]
fn activate_lanes<L: Lanes>(x: L, activation: Activation) -> L {
    match activation {
        Activation::None => x,
        Activation::Relu => x.max(L::splat(0.0)),
        Activation::Gelu => x.gelu(),
        Activation::Sigmoid => x.sigmoid(),
    }
}

/// Copies a short row; for these a call of the library's copy costs more than the copy.
#[inline(always)]
pub(super) fn copy_short<L: Lanes>(from: &[f32], to: &mut [f32]) {
    let (mut to_chunks, mut from_chunks) =
        (to.chunks_exact_mut(L::LANES), from.chunks_exact(L::LANES));
    for (to, from) in (&mut to_chunks).zip(&mut from_chunks) {
        // SAFETY: both chunks have `LANES` numbers.
        unsafe { L::load(from.as_ptr()).store(to.as_mut_ptr()) };
    }
    for (to, from) in to_chunks
        .into_remainder()
        .iter_mut()
        .zip(from_chunks.remainder())
    {
        *to = *from;
    }
}

/// Applies `f` to vectors of both rows; `to` may be as long as the shorter.
#[inline(always)]
fn zip_row<L: Lanes>(a: &[f32], b: Option<&[f32]>, to: &mut [f32], f: impl Fn(L, L) -> L) {
    let count = to.len();
    let whole = count - count % L::LANES;
    assert!(
        a.len() >= count && b.is_none_or(|b| b.len() >= count),
        "lengths of rows"
    );
    let zero = L::splat(0.0);
    // SAFETY: all accesses are to the first `count` numbers of slices that have as many.
    unsafe {
        for first in (0..whole).step_by(L::LANES) {
            let second = b.map_or(zero, |b| L::load(b.as_ptr().add(first)));
            f(L::load(a.as_ptr().add(first)), second).store(to.as_mut_ptr().add(first));
        }
        if whole < count {
            let rest = count - whole;
            let second = b.map_or(zero, |b| L::load_part(b.as_ptr().add(whole), rest, 0.0));
            let first = L::load_part(a.as_ptr().add(whole), rest, 0.0);
            f(first, second).store_part(to.as_mut_ptr().add(whole), rest);
        }
    }
}

entry! {
    /// `out = activation(a + b)`
    pub(in crate::nn::cpu) fn add(a: Rows<'_>, b: Option<Rows<'_>>, activation: Activation, out: &mut [f32]) => add_rows
}

#[inline(always)]
fn add_rows<L: Lanes>(a: Rows<'_>, b: Option<Rows<'_>>, activation: Activation, out: &mut [f32]) {
    for (row, to) in out.chunks_exact_mut(a.channels).take(a.rows).enumerate() {
        let b = b.map(|b| b.row(row));
        match activation {
            Activation::None => zip_row::<L>(a.row(row), b, to, |a, b| a.add(b)),
            Activation::Relu => zip_row::<L>(a.row(row), b, to, |a, b| a.add(b).max(L::splat(0.0))),
            Activation::Gelu => zip_row::<L>(a.row(row), b, to, |a, b| a.add(b).gelu()),
            Activation::Sigmoid => zip_row::<L>(a.row(row), b, to, |a, b| a.add(b).sigmoid()),
        }
    }
}

entry! {
    /// Applies an activation in place.
    pub(in crate::nn::cpu) fn activate(activation: Activation, numbers: &mut [f32]) => activate_numbers
}

#[inline(always)]
fn activate_numbers<L: Lanes>(activation: Activation, numbers: &mut [f32]) {
    let mut chunks = numbers.chunks_exact_mut(L::LANES);
    for chunk in &mut chunks {
        // SAFETY: the chunk has `LANES` numbers.
        unsafe { activate_lanes(L::load(chunk.as_ptr()), activation).store(chunk.as_mut_ptr()) };
    }
    let rest = chunks.into_remainder();
    // SAFETY: the accesses are to the rest only.
    unsafe {
        let x = L::load_part(rest.as_ptr(), rest.len(), 0.0);
        activate_lanes(x, activation).store_part(rest.as_mut_ptr(), rest.len());
    }
}

/// A picture's pixels with its height and width.
#[derive(Debug, Clone, Copy)]
pub(in crate::nn::cpu) struct Picture<'a> {
    /// The pixels.
    pub(in crate::nn::cpu) pixels: Rows<'a>,
    /// Pixel rows.
    pub(in crate::nn::cpu) height: usize,
    /// Pixel columns.
    pub(in crate::nn::cpu) width: usize,
}

impl<'a> Picture<'a> {
    #[inline(always)]
    fn pixel(&self, y: usize, x: usize) -> &'a [f32] {
        self.pixels.row(y * self.width + x)
    }
}

/// The two neighbours of an output position and the weight of the second one.
#[inline(always)]
fn neighbours(out_index: usize, out_size: usize, in_size: usize) -> (usize, usize, f32) {
    let position = (out_index as f64 + 0.5) * in_size as f64 / out_size as f64 - 0.5;
    let position = position.clamp(0.0, (in_size - 1) as f64);
    let low = position as usize;
    (
        low,
        (low + 1).min(in_size - 1),
        (position - low as f64) as f32,
    )
}

entry! {
    /// Bilinear resize, plus an addend.
    pub(in crate::nn::cpu) fn resize(
        x: Picture<'_>, addend: Option<Rows<'_>>, out_height: usize, out_width: usize, out: &mut [f32]
    ) => resize_lanes
}

#[inline(always)]
fn resize_lanes<L: Lanes>(
    x: Picture<'_>,
    addend: Option<Rows<'_>>,
    out_height: usize,
    out_width: usize,
    out: &mut [f32],
) {
    let channels = x.pixels.channels;
    for out_y in 0..out_height {
        let (y0, y1, fy) = neighbours(out_y, out_height, x.height);
        for out_x in 0..out_width {
            let (x0, x1, fx) = neighbours(out_x, out_width, x.width);
            let pixel = out_y * out_width + out_x;
            let to = &mut out[pixel * channels..][..channels];
            let corners = [
                x.pixel(y0, x0),
                x.pixel(y0, x1),
                x.pixel(y1, x0),
                x.pixel(y1, x1),
            ];
            let weights = [
                (1.0 - fy) * (1.0 - fx),
                (1.0 - fy) * fx,
                fy * (1.0 - fx),
                fy * fx,
            ];
            weighted_sum::<L>(corners, weights, addend.map(|addend| addend.row(pixel)), to);
        }
    }
}

/// `to = sum of weight * row + addend`
#[inline(always)]
fn weighted_sum<L: Lanes>(
    rows: [&[f32]; 4],
    weights: [f32; 4],
    addend: Option<&[f32]>,
    to: &mut [f32],
) {
    let count = to.len();
    let whole = count - count % L::LANES;
    assert!(
        rows.iter().chain(&addend).all(|row| row.len() >= count),
        "lengths of rows"
    );
    let lanes = weights.map(L::splat);
    // SAFETY: all accesses are to the first `count` numbers of slices that have as many.
    unsafe {
        for first in (0..whole).step_by(L::LANES) {
            let mut sum =
                addend.map_or(L::splat(0.0), |addend| L::load(addend.as_ptr().add(first)));
            for (row, weight) in rows.iter().zip(lanes) {
                sum = sum.mul_add(L::load(row.as_ptr().add(first)), weight);
            }
            sum.store(to.as_mut_ptr().add(first));
        }
    }
    for index in whole..count {
        let sum: f32 = rows
            .iter()
            .zip(weights)
            .map(|(row, weight)| row[index] * weight)
            .sum();
        to[index] = sum + addend.map_or(0.0, |addend| addend[index]);
    }
}

entry! {
    /// Mean of blocks.
    pub(in crate::nn::cpu) fn avg_pool(
        x: Picture<'_>, size: usize, out_height: usize, out_width: usize, out: &mut [f32]
    ) => avg_pool_lanes
}

#[inline(always)]
fn avg_pool_lanes<L: Lanes>(
    x: Picture<'_>,
    size: usize,
    out_height: usize,
    out_width: usize,
    out: &mut [f32],
) {
    let channels = x.pixels.channels;
    let factor = 1.0 / (size * size) as f32;
    for out_y in 0..out_height {
        for out_x in 0..out_width {
            let to = &mut out[(out_y * out_width + out_x) * channels..][..channels];
            if channels == 1 {
                let mut sum = 0.0;
                for dy in 0..size {
                    for dx in 0..size {
                        sum += x.pixel(out_y * size + dy, out_x * size + dx)[0];
                    }
                }
                to[0] = sum * factor;
                continue;
            }
            to.fill(0.0);
            for dy in 0..size {
                for dx in 0..size {
                    add_scaled::<L>(to, x.pixel(out_y * size + dy, out_x * size + dx), factor);
                }
            }
        }
    }
}

/// Windows of a maximum.
#[derive(Debug, Clone, Copy)]
pub(in crate::nn::cpu) struct Windows {
    /// Side.
    pub(in crate::nn::cpu) size: usize,
    /// Step.
    pub(in crate::nn::cpu) stride: usize,
    /// Border.
    pub(in crate::nn::cpu) pad: usize,
}

entry! {
    /// Maximum of windows.
    pub(in crate::nn::cpu) fn max_pool(
        x: Picture<'_>, windows: Windows, out_height: usize, out_width: usize, out: &mut [f32]
    ) => max_pool_lanes
}

#[inline(always)]
fn max_pool_lanes<L: Lanes>(
    x: Picture<'_>,
    windows: Windows,
    out_height: usize,
    out_width: usize,
    out: &mut [f32],
) {
    let channels = x.pixels.channels;
    // The part of a window that lies in the picture.
    let part = |out_index: usize, in_size: usize| {
        let start = out_index * windows.stride;
        start.saturating_sub(windows.pad)
            ..(start + windows.size)
                .saturating_sub(windows.pad)
                .min(in_size)
    };
    for out_y in 0..out_height {
        for out_x in 0..out_width {
            let to = &mut out[(out_y * out_width + out_x) * channels..][..channels];
            to.fill(f32::NEG_INFINITY);
            for in_y in part(out_y, x.height) {
                for in_x in part(out_x, x.width) {
                    let pixel = x.pixel(in_y, in_x);
                    let mut to_chunks = to.chunks_exact_mut(L::LANES);
                    let mut pixel_chunks = pixel.chunks_exact(L::LANES);
                    for (to, pixel) in (&mut to_chunks).zip(&mut pixel_chunks) {
                        // SAFETY: both chunks have `LANES` numbers.
                        unsafe {
                            L::load(to.as_ptr())
                                .max(L::load(pixel.as_ptr()))
                                .store(to.as_mut_ptr());
                        }
                    }
                    for (to, pixel) in to_chunks
                        .into_remainder()
                        .iter_mut()
                        .zip(pixel_chunks.remainder())
                    {
                        *to = to.max(*pixel);
                    }
                }
            }
        }
    }
}

/// Parameter of the cubic convolution kernel.
const CUBIC: f32 = -0.75;

/// First cell and the weights of four cells from there on; bilinear interpolation uses two.
#[inline(always)]
fn taps(filter: Filter, map: AxisMap, coordinate: f32) -> (i32, [f32; 4], i32) {
    // Far outside every cell is zero; the bound only keeps the conversion in range. In `f64`, because the difference
    // to the cell below would lose digits.
    let index =
        (f64::from(map.scale) * f64::from(coordinate) + f64::from(map.offset)).clamp(-1e6, 1e6);
    let low = index.floor();
    let t = (index - low) as f32;
    match filter {
        Filter::Bilinear => (low as i32, [1.0 - t, t, 0.0, 0.0], 2),
        Filter::Bicubic => {
            let inner = |d: f32| ((CUBIC + 2.0) * d - (CUBIC + 3.0)) * d * d + 1.0;
            let outer = |d: f32| ((d - 5.0) * d + 8.0) * d * CUBIC - 4.0 * CUBIC;
            (
                low as i32 - 1,
                [outer(1.0 + t), inner(t), inner(1.0 - t), outer(2.0 - t)],
                4,
            )
        }
    }
}

/// The maps of both axes and the interpolation.
#[derive(Debug, Clone, Copy)]
pub(in crate::nn::cpu) struct Sampling {
    /// Interpolation.
    pub(in crate::nn::cpu) filter: Filter,
    /// Horizontal map.
    pub(in crate::nn::cpu) x: AxisMap,
    /// Vertical map.
    pub(in crate::nn::cpu) y: AxisMap,
}

entry! {
    /// Reads a picture at positions.
    pub(in crate::nn::cpu) fn sample(
        picture: Picture<'_>, positions: Rows<'_>, sampling: Sampling, out: &mut [f32]
    ) => sample_lanes
}

#[inline(always)]
fn sample_lanes<L: Lanes>(
    picture: Picture<'_>,
    positions: Rows<'_>,
    sampling: Sampling,
    out: &mut [f32],
) {
    let channels = picture.pixels.channels;
    for row in 0..positions.rows {
        let to = &mut out[row * channels..][..channels];
        to.fill(0.0);
        let (first_x, weights_x, count) = taps(sampling.filter, sampling.x, positions.row(row)[0]);
        let (first_y, weights_y, _) = taps(sampling.filter, sampling.y, positions.row(row)[1]);
        for dy in 0..count {
            let y = first_y + dy;
            if y < 0 || y as usize >= picture.height {
                continue;
            }
            for dx in 0..count {
                let x = first_x + dx;
                if x < 0 || x as usize >= picture.width {
                    continue;
                }
                let weight = weights_y[dy as usize] * weights_x[dx as usize];
                add_scaled::<L>(to, picture.pixel(y as usize, x as usize), weight);
            }
        }
    }
}

entry! {
    /// Softmax over cells, dustbin dropped, cells laid out.
    pub(in crate::nn::cpu) fn detector_heat(x: Picture<'_>, block: usize, out: &mut [f32], scratch: &mut [f32]) => heat_lanes
}

#[inline(always)]
fn heat_lanes<L: Lanes>(x: Picture<'_>, block: usize, out: &mut [f32], scratch: &mut [f32]) {
    let places = block * block;
    let scores = &mut scratch[..places + 1];
    for cell_y in 0..x.height {
        for cell_x in 0..x.width {
            for (score, logit) in scores.iter_mut().zip(x.pixel(cell_y, cell_x)) {
                *score = logit * std::f32::consts::LOG2_E;
            }
            let (_, sum) = super::attention::powers::<L>(scores, f32::MIN, None);
            scale_row::<L>(scores, 1.0 / sum);
            for (dy, line) in scores[..places].chunks_exact(block).enumerate() {
                let start = (cell_y * block + dy) * x.width * block + cell_x * block;
                copy_short::<L>(line, &mut out[start..start + block]);
            }
        }
    }
}

/// Space to depth.
pub(in crate::nn::cpu) fn unfold(x: Picture<'_>, block: usize, out: &mut [f32]) {
    let channels = x.pixels.channels;
    let mut to = out.chunks_exact_mut(block * channels);
    for cell_y in 0..x.height / block {
        for cell_x in 0..x.width / block {
            for dy in 0..block {
                let first = (cell_y * block + dy) * x.width + cell_x * block;
                let Some(to) = to.next() else { return };
                if x.pixels.stride == channels {
                    to.copy_from_slice(&x.pixels.data[first * channels..][..block * channels]);
                } else {
                    for (dx, to) in to.chunks_exact_mut(channels).enumerate() {
                        to.copy_from_slice(x.pixels.row(first + dx));
                    }
                }
            }
        }
    }
}

/// Copies the rows whose logit is greater than the bound; returns how many.
pub(in crate::nn::cpu) fn keep(
    x: Rows<'_>,
    logit: Rows<'_>,
    min_logit: f32,
    kept: &mut [f32],
    index: &mut [f32],
) -> usize {
    let mut count = 0;
    for row in 0..x.rows {
        if logit.row(row)[0] > min_logit {
            kept[count * x.channels..][..x.channels].copy_from_slice(x.row(row));
            index[count] = row as f32;
            count += 1;
        }
    }
    count
}
