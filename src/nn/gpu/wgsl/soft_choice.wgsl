// Soft choice among anchors, streaming: one row a thread, anchors in tiles of 16; a second walk measures the spread about
// the mean, since the difference of squares would lose it. The host gives `D4` (a quarter of the descriptor) and `V`
// (numbers per value). Twin of cpu/kernels/soft_choice.
var<workgroup> keys: array<vec4<f32>, 16 * D4>;
var<workgroup> values: array<f32, 16 * V>;

fn load_tile(k0: u32, lane: u32) {
    for (var i = lane; i < 16u * D4; i += 64u) {
        var key = vec4<f32>(0.0);
        if k0 + i / D4 < p.anchors {
            let at = p.keys_offset + k0 * 4u * D4 + 4u * i;
            key = vec4<f32>(weights[at], weights[at + 1u], weights[at + 2u], weights[at + 3u]);
        }
        keys[i] = key;
    }
    for (var i = lane; i < 16u * V; i += 64u) {
        var value = 0.0;
        if k0 + i / V < p.anchors { value = weights[p.values_offset + k0 * V + i]; }
        values[i] = value;
    }
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group.x * 64u + lane;
    let inside = row < rows_of(p.rows_count, p.rows_per);
    let sharpness = weights[p.sharpness_offset];
    var x: array<vec4<f32>, D4>;
    if inside {
        for (var i = 0u; i < D4; i += 1u) {
            let at = p.x_offset + row * p.x_stride + 4u * i;
            x[i] = vec4<f32>(arena[at], arena[at + 1u], arena[at + 2u], arena[at + 3u]);
        }
    }
    var mean: array<f32, V>;
    var best = LOWEST;
    var second = LOWEST;
    var largest = LOWEST;
    var weight_sum = 0.0;
    var score_sum = 0.0;
    for (var k0 = 0u; k0 < p.anchors; k0 += 16u) {
        load_tile(k0, lane);
        workgroupBarrier();
        for (var j = 0u; j < min(16u, p.anchors - k0); j += 1u) {
            var s = 0.0;
            for (var i = 0u; i < D4; i += 1u) { s += dot(x[i], keys[j * D4 + i]); }
            if s > best { second = best; best = s; } else { second = max(second, s); }
            let z = s * sharpness;
            if z > largest {
                // The entropy needs the mean of (z - largest), so that sum moves along with the reference.
                let shrink = exp(max(largest - z, -80.0));
                score_sum = select(shrink * (score_sum + weight_sum * (largest - z)), 0.0, weight_sum == 0.0);
                weight_sum *= shrink;
                for (var i = 0u; i < V; i += 1u) { mean[i] *= shrink; }
                largest = z;
            }
            let weight = exp(z - largest);
            weight_sum += weight;
            score_sum += weight * (z - largest);
            for (var i = 0u; i < V; i += 1u) { mean[i] = fma(weight, values[j * V + i], mean[i]); }
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < V; i += 1u) { mean[i] /= weight_sum; }
    var spread = 0.0;
    for (var k0 = 0u; k0 < p.anchors; k0 += 16u) {
        load_tile(k0, lane);
        workgroupBarrier();
        for (var j = 0u; j < min(16u, p.anchors - k0); j += 1u) {
            var s = 0.0;
            for (var i = 0u; i < D4; i += 1u) { s += dot(x[i], keys[j * D4 + i]); }
            var distance = 0.0;
            for (var i = 0u; i < V; i += 1u) {
                let d = values[j * V + i] - mean[i];
                distance = fma(d, d, distance);
            }
            spread = fma(exp(s * sharpness - largest), distance, spread);
        }
        workgroupBarrier();
    }
    if !inside { return; }
    for (var i = 0u; i < V; i += 1u) { arena[p.y_offset + row * p.y_stride + i] = mean[i]; }
    if p.anchors == 1u { second = best; }
    let s0 = p.s_offset + row * p.s_stride;
    arena[s0] = best;
    arena[s0 + 1u] = second;
    arena[s0 + 2u] = best - second;
    arena[s0 + 3u] = max(log(weight_sum) - score_sum / weight_sum, 0.0);
    arena[s0 + 4u] = sqrt(max(spread / weight_sum, 0.0));
}
