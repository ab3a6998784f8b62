//! For each row the largest product with any key, for each key the row with which its product is largest: products by the
//! matrix kernel, a block of rows at a time, then two passes while the block is in the cache.

use super::gemm::{Packed, Product, Rows, product};
use crate::simd::kernels::{Lanes, entry};

/// Rows per block.
const ROWS: usize = 24;

/// What a search reads and writes.
pub(in crate::nn::cpu) struct Nearest<'a> {
    /// `[n, channels]`
    pub(in crate::nn::cpu) x: Rows<'a>,
    /// Keys as a matrix `[channels, keys]`.
    pub(in crate::nn::cpu) keys: &'a Packed,
    /// Largest product of each row, `[n]`.
    pub(in crate::nn::cpu) best_of_row: &'a mut [f32],
    /// Largest product of each key, [`padded`] numbers.
    pub(in crate::nn::cpu) best_of_key: &'a mut [f32],
    /// The first row that has it, [`padded`] numbers; not written for a key without a product above minus infinity.
    pub(in crate::nn::cpu) row_of_key: &'a mut [u32],
    /// Room for [`scratch_len`] numbers.
    pub(in crate::nn::cpu) scratch: &'a mut [f32],
}

/// Keys rounded up to whole vectors of any level.
pub(in crate::nn::cpu) fn padded(keys: usize) -> usize {
    keys.next_multiple_of(16)
}

/// Numbers of scratch.
pub(in crate::nn::cpu) fn scratch_len(keys: usize) -> usize {
    ROWS * padded(keys)
}

/// Searches.
pub(in crate::nn::cpu) fn nearest(work: Nearest<'_>) {
    dispatch(work.keys.level, work);
}

entry! { fn dispatch(work: Nearest<'_>) => nearest_lanes }

#[inline(always)]
fn nearest_lanes<L: Lanes>(work: Nearest<'_>) {
    let Nearest {
        x,
        keys,
        best_of_row,
        best_of_key,
        row_of_key,
        scratch,
    } = work;
    let num_keys = keys.columns();
    let padded = padded(num_keys);
    let (best_of_key, row_of_key) = (&mut best_of_key[..padded], &mut row_of_key[..padded]);
    best_of_key.fill(f32::NEG_INFINITY);
    for first in (0..x.rows).step_by(ROWS) {
        let rows = (x.rows - first).min(ROWS);
        product(Product {
            x: x.part(first..first + rows),
            matrix: keys,
            residual: None,
            relu: false,
            out: scratch,
            out_stride: padded,
        });
        for row in 0..rows {
            let products = &mut scratch[row * padded..][..padded];
            products[num_keys..].fill(f32::NEG_INFINITY);
            let number = (first + row) as u32;
            // Without branches, so that the compiler makes vectors of it.
            for ((p, best), at) in products
                .iter()
                .zip(best_of_key.iter_mut())
                .zip(row_of_key.iter_mut())
            {
                let is_better = *p > *best;
                *best = if is_better { *p } else { *best };
                *at = if is_better { number } else { *at };
            }
            let mut best = L::splat(f32::NEG_INFINITY);
            for vector in products.chunks_exact(L::LANES) {
                // SAFETY: the chunk has as many numbers as the vector.
                best = best.max(unsafe { L::load(vector.as_ptr()) });
            }
            best_of_row[first + row] = best.largest();
        }
    }
}
