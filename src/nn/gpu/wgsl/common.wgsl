// Bindings and helpers that every kernel shares. One bind group layout serves all kernels: activations live in one
// arena that is read and written, so that no dispatch binds a buffer twice; offsets come from `p`.
// A host prepends `struct Params {..}` of the kernel and its constants, and `fn activate(x: f32, kind: u32) -> f32`.

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read_write> arena: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

const FIXED: u32 = 0xffffffffu;
// Stands in for minus infinity, which WGSL lets implementations assume away.
const LOWEST: f32 = -3.0e38;

// Rows of a tensor in this run: `per` where the number is fixed, else `per` for each element of a count.
fn rows_of(count: u32, per: u32) -> u32 {
    if count == FIXED { return per; }
    return counts[count] * per;
}

// A weight that is stored in 32 bits.
fn weight(index: u32) -> f32 { return bitcast<f32>(weights[index]); }

// Number `index` of a matrix that starts at word `first`, stored in 32 bits, or two to a word in 16 (widening is exact).
fn of_matrix(first: u32, index: u32, is_half: bool) -> f32 {
    if is_half {
        let pair = unpack2x16float(weights[first + index / 2u]);
        return select(pair.x, pair.y, index % 2u == 1u);
    }
    return bitcast<f32>(weights[first + index]);
}

// Error function by a Chebyshev fit of erfc, fractional error below 1.2e-7 (Numerical Recipes, section 6.2).
fn erf_of(x: f32) -> f32 {
    let z = abs(x);
    let t = 1.0 / (1.0 + 0.5 * z);
    let poly = -1.26551223 + t * (1.00002368 + t * (0.37409196 + t * (0.09678418 + t * (-0.18628806
        + t * (0.27886807 + t * (-1.13520398 + t * (1.48851587 + t * (-0.82215223 + t * 0.17087277))))))));
    let tail = t * exp(-z * z + poly);
    return select(tail - 1.0, 1.0 - tail, x >= 0.0);
}
