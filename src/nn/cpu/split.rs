//! Work split by rows of the result, over threads where the feature `parallel` is on.
//!
//! Every row is computed alone and in the same order wherever it lies, so results do not depend on the number of parts.

use std::ops::Range;

/// Multiply-adds below which a part is not worth a thread: about 20 microseconds.
const MIN_MACS: u64 = 1 << 20;

/// Parts are split at multiples of this many rows, a multiple of all tiles' rows.
#[cfg(all(feature = "parallel", not(target_arch = "wasm32")))]
const ROWS: usize = 12;

/// A part of an operation.
pub(super) struct Part<'a> {
    /// Rows of the result.
    pub(super) rows: Range<usize>,
    /// The numbers of these rows, for each output.
    pub(super) outs: [&'a mut [f32]; 2],
    /// Working room of this part alone.
    pub(super) scratch: &'a mut [f32],
}

/// Threads that an executor may use.
pub(super) fn threads() -> usize {
    #[cfg(all(feature = "parallel", not(target_arch = "wasm32")))]
    return rayon::current_num_threads();
    #[cfg(not(all(feature = "parallel", not(target_arch = "wasm32"))))]
    1
}

/// Parts for an operation of so many multiply-adds.
pub(super) fn parts(threads: usize, macs: u64) -> usize {
    usize::try_from(macs / MIN_MACS).map_or(threads, |most| most.clamp(1, threads))
}

/// Runs `work` on up to `parts` parts of `rows` rows. The outputs have `strides` numbers a row; the scratch is divided.
pub(super) fn by_rows(
    parts: usize,
    rows: usize,
    strides: [usize; 2],
    outs: [&mut [f32]; 2],
    scratch: &mut [f32],
    work: &(dyn Fn(Part<'_>) + Sync),
) {
    let part = Part {
        rows: 0..rows,
        outs,
        scratch,
    };
    divide(parts, strides, part, work);
}

#[cfg(all(feature = "parallel", not(target_arch = "wasm32")))]
fn divide(parts: usize, strides: [usize; 2], part: Part<'_>, work: &(dyn Fn(Part<'_>) + Sync)) {
    let len = part.rows.len();
    let first_parts = parts / 2;
    let first_rows = (len * first_parts / parts.max(1)).next_multiple_of(ROWS);
    if parts < 2 || first_rows >= len {
        return work(part);
    }
    let middle = part.rows.start + first_rows;
    let [a, b] = part.outs;
    let split = |out: &mut [f32], stride: usize| (first_rows * stride).min(out.len());
    let (at_a, at_b) = (split(a, strides[0]), split(b, strides[1]));
    let (first_a, second_a) = a.split_at_mut(at_a);
    let (first_b, second_b) = b.split_at_mut(at_b);
    let scratch_len = part.scratch.len() / parts * first_parts;
    let (first_scratch, second_scratch) = part.scratch.split_at_mut(scratch_len);
    let first = Part {
        rows: part.rows.start..middle,
        outs: [first_a, first_b],
        scratch: first_scratch,
    };
    let second = Part {
        rows: middle..part.rows.end,
        outs: [second_a, second_b],
        scratch: second_scratch,
    };
    rayon::join(
        || divide(first_parts, strides, first, work),
        || divide(parts - first_parts, strides, second, work),
    );
}

#[cfg(not(all(feature = "parallel", not(target_arch = "wasm32"))))]
fn divide(_parts: usize, _strides: [usize; 2], part: Part<'_>, work: &(dyn Fn(Part<'_>) + Sync)) {
    work(part);
}
