// One query per element and head over the element's own tokens (at most 64): mean of the tokens weighted by a softmax.
// One workgroup an element and head. Twin of cpu/kernels/token_pool.
var<workgroup> partial: array<f32, 64>;
var<workgroup> scores: array<f32, 64>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let element = group.x;
    let head = group.y;
    let inside = element < rows_of(p.rows_count, p.rows_per);
    let u0 = p.u_offset + element * p.u_stride + head * p.channels;
    let t0 = p.t_offset + element * p.tokens * p.t_stride;
    for (var token = 0u; token < p.tokens; token += 1u) {
        var s = 0.0;
        if inside {
            for (var c = lane; c < p.channels; c += 64u) { s += arena[u0 + c] * arena[t0 + token * p.t_stride + c]; }
        }
        partial[lane] = s;
        workgroupBarrier();
        for (var half = 32u; half > 0u; half /= 2u) {
            if lane < half { partial[lane] += partial[lane + half]; }
            workgroupBarrier();
        }
        if lane == 0u { scores[token] = partial[0] * p.scale; }
        workgroupBarrier();
    }
    if !inside { return; }
    var largest = LOWEST;
    for (var token = 0u; token < p.tokens; token += 1u) { largest = max(largest, scores[token]); }
    var weight_sum = 0.0;
    for (var token = 0u; token < p.tokens; token += 1u) { weight_sum += exp(scores[token] - largest); }
    for (var c = lane; c < p.channels; c += 64u) {
        var y = 0.0;
        for (var token = 0u; token < p.tokens; token += 1u) {
            y += exp(scores[token] - largest) * arena[t0 + token * p.t_stride + c];
        }
        arena[p.y_offset + element * p.y_stride + head * p.channels + c] = y / weight_sum;
    }
}
