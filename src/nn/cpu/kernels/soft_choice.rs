//! Soft choice among anchors: similarities by the matrix kernel, a block of rows at a time, then one pass per row.

use super::gemm::{Packed, Product, Rows, product};
use crate::simd::kernels::{Lanes, entry};

/// Rows per block.
const ROWS: usize = 24;

/// Scores that far below the best have no part in the choice: their weights are below 1e-13.
const NEGLIGIBLE: f32 = -30.0;

/// What a soft choice reads and writes.
pub(in crate::nn::cpu) struct SoftChoice<'a> {
    /// `[n, channels]`
    pub(in crate::nn::cpu) x: Rows<'a>,
    /// Keys as a matrix `[channels, anchors]`.
    pub(in crate::nn::cpu) keys: &'a Packed,
    /// One row of [`padded`] numbers per value channel.
    pub(in crate::nn::cpu) values: &'a [f32],
    /// Factor of the similarities.
    pub(in crate::nn::cpu) sharpness: f32,
    /// `[n, v]`
    pub(in crate::nn::cpu) chosen: &'a mut [f32],
    /// `[n, 5]`
    pub(in crate::nn::cpu) statistics: &'a mut [f32],
    /// Room for [`scratch_len`] numbers.
    pub(in crate::nn::cpu) scratch: &'a mut [f32],
}

/// Anchors rounded up to whole vectors of any level.
pub(in crate::nn::cpu) fn padded(anchors: usize) -> usize {
    anchors.next_multiple_of(16)
}

/// Numbers of scratch.
pub(in crate::nn::cpu) fn scratch_len(anchors: usize) -> usize {
    ROWS * padded(anchors)
}

/// Computes a soft choice.
pub(in crate::nn::cpu) fn soft_choice(work: SoftChoice<'_>) {
    dispatch(work.keys.level, work);
}

entry! { fn dispatch(work: SoftChoice<'_>) => soft_choice_lanes }

#[inline(always)]
fn soft_choice_lanes<L: Lanes>(work: SoftChoice<'_>) {
    let SoftChoice {
        x,
        keys,
        values,
        sharpness,
        chosen,
        statistics,
        scratch,
    } = work;
    let anchors = keys.columns();
    let padded = padded(anchors);
    let width = values.len() / padded;
    assert_eq!(values.len(), width * padded, "size of the anchors' values");
    for first in (0..x.rows).step_by(ROWS) {
        let rows = (x.rows - first).min(ROWS);
        product(Product {
            x: Rows {
                data: &x.data[first * x.stride..],
                rows,
                ..x
            },
            matrix: keys,
            residual: None,
            relu: false,
            out: scratch,
            out_stride: padded,
        });
        for row in 0..rows {
            let similarities = &mut scratch[row * padded..][..padded];
            similarities[anchors..].fill(f32::NEG_INFINITY);
            let chosen = &mut chosen[(first + row) * width..][..width];
            let statistics = &mut statistics[(first + row) * 5..][..5];
            one_row::<L>(similarities, values, sharpness, chosen, statistics);
        }
    }
}

#[inline(always)]
fn one_row<L: Lanes>(
    similarities: &mut [f32],
    values: &[f32],
    sharpness: f32,
    chosen: &mut [f32],
    statistics: &mut [f32],
) {
    let padded = similarities.len();
    let at = similarities.as_mut_ptr();
    // SAFETY: all accesses are to whole vectors within the padded rows of similarities and values.
    unsafe {
        // The best two of each lane, then of all lanes.
        let (mut best, mut second) = (L::splat(f32::NEG_INFINITY), L::splat(f32::NEG_INFINITY));
        for first in (0..padded).step_by(L::LANES) {
            let s = L::load(at.add(first));
            second = second.max(best.min(s));
            best = best.max(s);
        }
        let mut best_lanes = [f32::NEG_INFINITY; 16];
        let mut second_lanes = [f32::NEG_INFINITY; 16];
        best.store(best_lanes.as_mut_ptr());
        second.store(second_lanes.as_mut_ptr());
        let (mut best, mut second) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for s in best_lanes.into_iter().chain(second_lanes) {
            second = second.max(best.min(s));
            best = best.max(s);
        }
        if second == f32::NEG_INFINITY {
            second = best;
        }
        // Weights; with a negative sharpness the least similar anchor leads.
        let factor = L::splat(sharpness);
        let leading = if sharpness >= 0.0 {
            best * sharpness
        } else {
            let mut least = f32::INFINITY;
            for s in similarities.iter().filter(|s| s.is_finite()) {
                least = least.min(*s);
            }
            least * sharpness
        };
        let shift = L::splat(leading);
        let lowest = L::splat(NEGLIGIBLE);
        let (mut sum, mut score_sum) = (L::splat(0.0), L::splat(0.0));
        for first in (0..padded).step_by(L::LANES) {
            let s = L::load(at.add(first));
            // Padding is minus infinity and stays below any bound for either sign of the sharpness.
            let padding = s.largest() == f32::NEG_INFINITY;
            let z = s.mul(factor).sub(shift);
            if padding || z.largest() < NEGLIGIBLE {
                L::splat(0.0).store(at.add(first));
                continue;
            }
            let z = z.max(lowest);
            let e = z.exp();
            e.store(at.add(first));
            sum = sum.add(e);
            score_sum = score_sum.mul_add(e, z);
        }
        let (sum, score_sum) = (sum.sum(), score_sum.sum());
        for (channel, mean) in chosen.iter_mut().enumerate() {
            let values = values[channel * padded..][..padded].as_ptr();
            let mut total = L::splat(0.0);
            for first in (0..padded).step_by(L::LANES) {
                total = total.mul_add(L::load(at.add(first)), L::load(values.add(first)));
            }
            *mean = total.sum() / sum;
        }
        let mut spread = L::splat(0.0);
        for (channel, mean) in chosen.iter().enumerate() {
            let values = values[channel * padded..][..padded].as_ptr();
            let mean = L::splat(*mean);
            for first in (0..padded).step_by(L::LANES) {
                let offset = L::load(values.add(first)).sub(mean);
                spread = spread.mul_add(L::load(at.add(first)).mul(offset), offset);
            }
        }
        let entropy = (libm::logf(sum) - score_sum / sum).max(0.0);
        let spread = libm::sqrtf((spread.sum() / sum).max(0.0));
        statistics.copy_from_slice(&[best, second, best - second, entropy, spread]);
    }
}
