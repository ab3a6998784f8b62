//! Multi-head attention with a streaming softmax: keys in tiles, the running maximum and sum per query.
//!
//! Exponentials are powers of two: the factor is part of the scores.
//! The memory is independent of the square of the number of rows; within a tile both products use the matrix kernel.

use super::gemm::{Rows, Tile, panel_width, run_panel};
use crate::simd::kernels::{Lanes, Level, entry};

/// Keys per tile.
const KEYS: usize = 128;
/// Queries per block.
const QUERIES: usize = 48;
/// A score that no key has; its exponential beside any real score is zero.
const NO_SCORE: f32 = -1e30;

/// What an attention reads and writes.
pub(in crate::nn::cpu) struct Attention<'a> {
    /// Queries `[n, heads * depth]`.
    pub(in crate::nn::cpu) q: Rows<'a>,
    /// Keys `[m, heads * depth]`.
    pub(in crate::nn::cpu) k: Rows<'a>,
    /// Values `[m, heads * width]`.
    pub(in crate::nn::cpu) v: Rows<'a>,
    /// Keys take part where this is > 0.
    pub(in crate::nn::cpu) keep: Option<Rows<'a>>,
    /// Number of heads.
    pub(in crate::nn::cpu) heads: usize,
    /// Factor of the scores.
    pub(in crate::nn::cpu) scale: f32,
    /// Result `[n, heads * width]`.
    pub(in crate::nn::cpu) out: &'a mut [f32],
    /// Room for [`scratch_len`] numbers.
    pub(in crate::nn::cpu) scratch: &'a mut [f32],
}

/// Numbers of scratch for up to `queries` queries.
pub(in crate::nn::cpu) fn scratch_len(queries: usize, depth: usize, width: usize) -> usize {
    KEYS * (depth + width.next_multiple_of(16)) + QUERIES * KEYS + 2 * queries
}

/// Computes an attention.
pub(in crate::nn::cpu) fn attention(level: Level, work: Attention<'_>) {
    dispatch(level, work);
}

entry! { fn dispatch(work: Attention<'_>) => attention_lanes }

#[inline(always)]
fn attention_lanes<L: Lanes>(work: Attention<'_>) {
    let Attention {
        q,
        k,
        v,
        keep,
        heads,
        scale,
        out,
        scratch,
    } = work;
    let (depth, width) = (q.channels / heads, v.channels / heads);
    let out_stride = v.channels;
    for rows in [q, k, v].iter().chain(&keep) {
        rows.check();
    }
    assert!(
        k.channels == q.channels && v.rows == k.rows,
        "sizes of keys and values"
    );
    assert!(
        keep.is_none_or(|keep| keep.rows == k.rows),
        "size of a key mask"
    );
    assert!(q.rows * out_stride <= out.len(), "room for an attention");
    if q.rows == 0 {
        return;
    }
    if k.rows == 0 {
        out[..q.rows * out_stride].fill(0.0);
        return;
    }
    let (packed_keys, scratch) = scratch.split_at_mut(KEYS * depth);
    let (packed_values, scratch) = scratch.split_at_mut(KEYS * width.next_multiple_of(16));
    let (scores, scratch) = scratch.split_at_mut(QUERIES * KEYS);
    let (maxima, scratch) = scratch.split_at_mut(q.rows);
    let sums = &mut scratch[..q.rows];
    for head in 0..heads {
        for first_key in (0..k.rows).step_by(KEYS) {
            let keys = (k.rows - first_key).min(KEYS);
            let scale = scale * std::f32::consts::LOG2_E;
            pack_keys::<L>(k, first_key, keys, head * depth, depth, scale, packed_keys);
            pack_values::<L>(v, first_key, keys, head * width, width, packed_values);
            for first_query in (0..q.rows).step_by(QUERIES) {
                let queries = (q.rows - first_query).min(QUERIES);
                let mut column = 0;
                while column < keys {
                    let panel = panel_width(L::LANES, keys - column);
                    let a = q.data[first_query * q.stride + head * depth..].as_ptr();
                    let tile = Tile {
                        a,
                        depth,
                        a_stride: q.stride,
                        b: packed_keys[column * depth..].as_ptr(),
                        bias: std::ptr::null(),
                        c: scores[column..].as_mut_ptr(),
                        c_stride: KEYS,
                        columns: panel,
                        residual: std::ptr::null(),
                        residual_stride: 0,
                        relu: false,
                    };
                    // SAFETY: queries were checked; packed keys hold whole panels; a row of scores has room for `KEYS`
                    // numbers, a multiple of every panel's width.
                    unsafe { run_panel::<L>(queries, panel == L::LANES, &tile) };
                    column += panel;
                }
                for query in 0..queries {
                    let row = first_query + query;
                    let scores = &mut scores[query * KEYS..][..keys];
                    let keep = keep.map(|keep| Rows {
                        data: &keep.data[first_key * keep.stride..],
                        ..keep
                    });
                    let before = if first_key == 0 {
                        NO_SCORE
                    } else {
                        maxima[row]
                    };
                    let (largest, sum) = powers::<L>(scores, before, keep);
                    let faded = L::splat(before - largest).exp2_of_score().largest();
                    let so_far = &mut out[row * out_stride + head * width..][..width];
                    if first_key == 0 {
                        sums[row] = sum;
                        so_far.fill(0.0);
                    } else {
                        sums[row] = sums[row] * faded + sum;
                        scale_row::<L>(so_far, faded);
                    }
                    maxima[row] = largest;
                }
                let mut column = 0;
                while column < width {
                    let panel = panel_width(L::LANES, width - column);
                    let c = out[first_query * out_stride + head * width + column..].as_mut_ptr();
                    let tile = Tile {
                        a: scores.as_ptr(),
                        depth: keys,
                        a_stride: KEYS,
                        b: packed_values[column * keys..].as_ptr(),
                        bias: std::ptr::null(),
                        c,
                        c_stride: out_stride,
                        columns: panel.min(width - column),
                        residual: c,
                        residual_stride: out_stride,
                        relu: false,
                    };
                    // SAFETY: scores were written above for these queries and keys; packed values hold whole panels; the
                    // output was checked.
                    unsafe { run_panel::<L>(queries, panel == L::LANES, &tile) };
                    column += panel;
                }
            }
        }
        for (row, &sum) in sums.iter().enumerate() {
            let factor = if sum > 0.0 { 1.0 / sum } else { 0.0 };
            scale_row::<L>(&mut out[row * out_stride + head * width..][..width], factor);
        }
    }
}

/// Writes keys as panels `[depth][width]`, times the scale; missing columns are zero.
#[inline(always)]
fn pack_keys<L: Lanes>(
    k: Rows<'_>,
    first_key: usize,
    keys: usize,
    channel: usize,
    depth: usize,
    scale: f32,
    to: &mut [f32],
) {
    let mut column = 0;
    while column < keys {
        let panel = panel_width(L::LANES, keys - column);
        let to = &mut to[column * depth..][..panel * depth];
        for lane in 0..panel {
            if column + lane < keys {
                let key = &k.row(first_key + column + lane)[channel..][..depth];
                for (step, &number) in key.iter().enumerate() {
                    to[step * panel + lane] = number * scale;
                }
            } else {
                to.iter_mut()
                    .skip(lane)
                    .step_by(panel)
                    .for_each(|number| *number = 0.0);
            }
        }
        column += panel;
    }
}

/// Writes values as panels `[keys][width]`; missing columns are zero.
#[inline(always)]
fn pack_values<L: Lanes>(
    v: Rows<'_>,
    first_key: usize,
    keys: usize,
    channel: usize,
    width: usize,
    to: &mut [f32],
) {
    let mut column = 0;
    while column < width {
        let panel = panel_width(L::LANES, width - column);
        let filled = panel.min(width - column);
        let rows = to[column * keys..][..panel * keys].chunks_exact_mut(panel);
        for (key, to) in rows.enumerate() {
            let from = &v.row(first_key + key)[channel + column..][..filled];
            to[..filled].copy_from_slice(from);
            to[filled..].fill(0.0);
        }
        column += panel;
    }
}

/// Replaces scores by `2^(score - m)`, zero for keys that take no part; `m` is the largest of the scores and `before`.
/// Returns `m` and the sum.
#[inline(always)]
pub(super) fn powers<L: Lanes>(
    scores: &mut [f32],
    before: f32,
    keep: Option<Rows<'_>>,
) -> (f32, f32) {
    let count = scores.len();
    let whole = count - count % L::LANES;
    if let Some(keep) = keep {
        for (key, score) in scores.iter_mut().enumerate() {
            *score = if keep.row(key)[0] > 0.0 {
                *score
            } else {
                NO_SCORE
            };
        }
    }
    let from = scores.as_mut_ptr();
    // SAFETY: all accesses are to the first `count` scores.
    let (largest, sum) = unsafe {
        let (mut even, mut odd) = (L::splat(before), L::splat(before));
        let mut first = 0;
        while first + 2 * L::LANES <= count {
            even = even.max(L::load(from.add(first)));
            odd = odd.max(L::load(from.add(first + L::LANES)));
            first += 2 * L::LANES;
        }
        if first + L::LANES <= count {
            even = even.max(L::load(from.add(first)));
        }
        if whole < count {
            odd = odd.max(L::load_part(from.add(whole), count - whole, NO_SCORE));
        }
        let largest = even.max(odd).largest();
        let shift = L::splat(largest);
        let mut sum = L::splat(0.0);
        for first in (0..whole).step_by(L::LANES) {
            let e = L::load(from.add(first)).sub(shift).exp2_of_score();
            e.store(from.add(first));
            sum = sum.add(e);
        }
        let mut total = sum.sum();
        if whole < count {
            let e = L::load_part(from.add(whole), count - whole, NO_SCORE)
                .sub(shift)
                .exp2_of_score();
            e.store_part(from.add(whole), count - whole);
            total += scores[whole..].iter().sum::<f32>();
        }
        (largest, total)
    };
    let Some(keep) = keep else {
        return (largest, sum);
    };
    let mut sum = 0.0;
    for (key, score) in scores.iter_mut().enumerate() {
        *score = if keep.row(key)[0] > 0.0 { *score } else { 0.0 };
        sum += *score;
    }
    (largest, sum)
}

/// Multiplies a row by a factor.
#[inline(always)]
pub(super) fn scale_row<L: Lanes>(row: &mut [f32], factor: f32) {
    let factor_lanes = L::splat(factor);
    let mut chunks = row.chunks_exact_mut(L::LANES);
    for chunk in &mut chunks {
        // SAFETY: the chunk has `LANES` numbers.
        unsafe {
            L::load(chunk.as_ptr())
                .mul(factor_lanes)
                .store(chunk.as_mut_ptr())
        };
    }
    for number in chunks.into_remainder() {
        *number *= factor;
    }
}

/// What a token pooling reads and writes.
pub(in crate::nn::cpu) struct TokenPool<'a> {
    /// Queries `[n, heads * c]`.
    pub(in crate::nn::cpu) u: Rows<'a>,
    /// Tokens `[n * tokens, c]`.
    pub(in crate::nn::cpu) tokens_of: Rows<'a>,
    /// Number of heads.
    pub(in crate::nn::cpu) heads: usize,
    /// Tokens per element.
    pub(in crate::nn::cpu) tokens: usize,
    /// Factor of the scores.
    pub(in crate::nn::cpu) scale: f32,
    /// Result `[n, heads * c]`.
    pub(in crate::nn::cpu) out: &'a mut [f32],
    /// Room for `tokens` numbers.
    pub(in crate::nn::cpu) scratch: &'a mut [f32],
}

/// Computes a token pooling.
pub(in crate::nn::cpu) fn token_pool(level: Level, work: TokenPool<'_>) {
    dispatch_pool(level, work);
}

entry! { fn dispatch_pool(work: TokenPool<'_>) => token_pool_lanes }

#[inline(always)]
fn token_pool_lanes<L: Lanes>(work: TokenPool<'_>) {
    let TokenPool {
        u,
        tokens_of,
        heads,
        tokens,
        scale,
        out,
        scratch,
    } = work;
    let depth = tokens_of.channels;
    let scores = &mut scratch[..tokens];
    let scale = scale * std::f32::consts::LOG2_E;
    for row in 0..u.rows {
        for head in 0..heads {
            let query = &u.row(row)[head * depth..][..depth];
            for (token, score) in scores.iter_mut().enumerate() {
                *score = scale * dot::<L>(query, tokens_of.row(row * tokens + token));
            }
            let (_, sum) = powers::<L>(scores, NO_SCORE, None);
            let y = &mut out[row * u.channels + head * depth..][..depth];
            y.fill(0.0);
            for (token, score) in scores.iter().enumerate() {
                add_scaled::<L>(y, tokens_of.row(row * tokens + token), score / sum);
            }
        }
    }
}

/// Scalar product.
#[inline(always)]
pub(super) fn dot<L: Lanes>(a: &[f32], b: &[f32]) -> f32 {
    let (a_chunks, b_chunks) = (a.chunks_exact(L::LANES), b.chunks_exact(L::LANES));
    let rest: f32 = a_chunks
        .remainder()
        .iter()
        .zip(b_chunks.remainder())
        .map(|(x, y)| x * y)
        .sum();
    let mut sum = L::splat(0.0);
    for (x, y) in a_chunks.zip(b_chunks) {
        // SAFETY: both chunks have `LANES` numbers.
        sum = unsafe { sum.mul_add(L::load(x.as_ptr()), L::load(y.as_ptr())) };
    }
    sum.sum() + rest
}

/// `y += x * factor`
#[inline(always)]
pub(super) fn add_scaled<L: Lanes>(y: &mut [f32], x: &[f32], factor: f32) {
    let factor_lanes = L::splat(factor);
    let mut y_chunks = y.chunks_exact_mut(L::LANES);
    let mut x_chunks = x.chunks_exact(L::LANES);
    for (y, x) in (&mut y_chunks).zip(&mut x_chunks) {
        // SAFETY: both chunks have `LANES` numbers.
        unsafe {
            L::load(y.as_ptr())
                .mul_add(L::load(x.as_ptr()), factor_lanes)
                .store(y.as_mut_ptr());
        }
    }
    for (y, x) in y_chunks
        .into_remainder()
        .iter_mut()
        .zip(x_chunks.remainder())
    {
        *y += x * factor;
    }
}
