//! Normalisation over the picture, over the channels, and to unit length.

use super::{
    attention::{dot, scale_row},
    gemm::Rows,
};
use crate::simd::kernels::{Lanes, entry};

/// Numbers that are summed in `f32` before they go to a `f64` sum.
const CHUNK: usize = 256;

/// Sum of `(x - shift)^power`, power 1 or 2.
#[inline(always)]
fn power_sum<L: Lanes>(numbers: &[f32], shift: f32, squared: bool) -> f64 {
    let shift_lanes = L::splat(shift);
    let mut total = 0.0;
    for chunk in numbers.chunks(CHUNK) {
        let vectors = chunk.chunks_exact(L::LANES);
        let mut rest: f32 = 0.0;
        for &x in vectors.remainder() {
            let d = x - shift;
            rest += if squared { d * d } else { d };
        }
        let mut sum = L::splat(0.0);
        for vector in vectors {
            // SAFETY: the chunk has `LANES` numbers.
            let d = unsafe { L::load(vector.as_ptr()) }.sub(shift_lanes);
            sum = if squared {
                sum.mul_add(d, d)
            } else {
                sum.add(d)
            };
        }
        total += f64::from(sum.sum()) + f64::from(rest);
    }
    total
}

entry! {
    /// Each channel minus its mean, over its standard deviation.
    pub(in crate::nn::cpu) fn instance_norm(x: Rows<'_>, eps: f32, out: &mut [f32]) => instance_norm_lanes
}

#[inline(always)]
fn instance_norm_lanes<L: Lanes>(x: Rows<'_>, eps: f32, out: &mut [f32]) {
    let count = x.rows as f64;
    if x.channels == 1 && x.stride == 1 {
        let numbers = &x.data[..x.rows];
        // A first guess of the mean makes the second pass exact.
        let guess = (power_sum::<L>(numbers, 0.0, false) / count) as f32;
        let rest = power_sum::<L>(numbers, guess, false) / count;
        let variance = power_sum::<L>(numbers, guess, true) / count - rest * rest;
        let factor = (1.0 / (variance.max(0.0) + f64::from(eps)).sqrt()) as f32;
        let mean = (f64::from(guess) + rest) as f32;
        for (to, &x) in out.iter_mut().zip(numbers) {
            *to = (x - mean) * factor;
        }
        return;
    }
    for channel in 0..x.channels {
        let numbers = || (0..x.rows).map(|row| f64::from(x.row(row)[channel]));
        let mean = numbers().sum::<f64>() / count;
        let variance = numbers().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count;
        let factor = 1.0 / (variance + f64::from(eps)).sqrt();
        for (row, number) in numbers().enumerate() {
            out[row * x.channels + channel] = ((number - mean) * factor) as f32;
        }
    }
}

entry! {
    /// Layer norm.
    pub(in crate::nn::cpu) fn layer_norm(
        x: Rows<'_>, gain: &[f32], bias: &[f32], eps: f32, out: &mut [f32]
    ) => layer_norm_lanes
}

#[inline(always)]
fn layer_norm_lanes<L: Lanes>(x: Rows<'_>, gain: &[f32], bias: &[f32], eps: f32, out: &mut [f32]) {
    let channels = x.channels;
    let whole = channels - channels % L::LANES;
    assert!(
        gain.len() >= channels && bias.len() >= channels,
        "size of a layer norm"
    );
    for row in 0..x.rows {
        let from = x.row(row);
        let to = &mut out[row * channels..][..channels];
        let mean = (power_sum::<L>(from, 0.0, false) / channels as f64) as f32;
        let variance = power_sum::<L>(from, mean, true) / channels as f64;
        let factor = (1.0 / (variance + f64::from(eps)).sqrt()) as f32;
        let (mean_lanes, factor_lanes) = (L::splat(mean), L::splat(factor));
        // SAFETY: all accesses are to the first `channels` numbers of slices that have as many.
        unsafe {
            for first in (0..whole).step_by(L::LANES) {
                let centred = L::load(from.as_ptr().add(first))
                    .sub(mean_lanes)
                    .mul(factor_lanes);
                let y = L::load(bias.as_ptr().add(first))
                    .mul_add(centred, L::load(gain.as_ptr().add(first)));
                y.store(to.as_mut_ptr().add(first));
            }
        }
        for index in whole..channels {
            to[index] = (from[index] - mean) * factor * gain[index] + bias[index];
        }
    }
}

entry! {
    /// Unit rows.
    pub(in crate::nn::cpu) fn l2_norm(x: Rows<'_>, eps: f32, out: &mut [f32]) => l2_norm_lanes
}

#[inline(always)]
fn l2_norm_lanes<L: Lanes>(x: Rows<'_>, eps: f32, out: &mut [f32]) {
    for row in 0..x.rows {
        let to = &mut out[row * x.channels..][..x.channels];
        to.copy_from_slice(x.row(row));
        let norm = dot::<L>(to, to).sqrt();
        scale_row::<L>(to, 1.0 / norm.max(eps));
    }
}
