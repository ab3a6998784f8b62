// Soft choice among anchors, streaming: one row a thread, anchors in tiles of `TILE`; a second walk measures the spread about
// the mean, since the difference of squares would lose it. The host gives the descriptor's width `D`, the numbers per value
// `V`, and as many anchors a tile as workgroup memory holds. Twin of cpu/kernels/soft_choice.
const D4: u32 = (D + 3u) / 4u;
var<workgroup> keys: array<vec4<f32>, TILE * D4>;
var<workgroup> values: array<f32, TILE * V>;

// Number `c` of an anchor's key; zero past its end.
fn key_number(anchor: u32, c: u32) -> f32 {
    if c >= D { return 0.0; }
    return of_matrix(p.keys_offset, anchor * D + c, KEYS_HALF);
}

fn load_tile(k0: u32, lane: u32) {
    for (var i = lane; i < TILE * D4; i += 64u) {
        let anchor = k0 + i / D4;
        let c = 4u * (i % D4);
        var key = vec4<f32>(0.0);
        if anchor < p.anchors {
            key = vec4<f32>(key_number(anchor, c), key_number(anchor, c + 1u), key_number(anchor, c + 2u), key_number(anchor, c + 3u));
        }
        keys[i] = key;
    }
    for (var i = lane; i < TILE * V; i += 64u) {
        var value = 0.0;
        if k0 + i / V < p.anchors { value = of_matrix(p.values_offset, k0 * V + i, VALUES_HALF); }
        values[i] = value;
    }
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group.x * 64u + lane;
    let inside = row < rows_of(p.rows_count, p.rows_per);
    let sharpness = weight(p.sharpness_offset);
    var x: array<vec4<f32>, D4>;
    if inside {
        for (var c = 0u; c < D; c += 1u) { x[c / 4u][c % 4u] = arena[p.x_offset + row * p.x_stride + c]; }
    }
    var mean: array<f32, V>;
    var best = LOWEST;
    var second = LOWEST;
    var largest = LOWEST;
    var weight_sum = 0.0;
    var score_sum = 0.0;
    for (var k0 = 0u; k0 < p.anchors; k0 += TILE) {
        load_tile(k0, lane);
        workgroupBarrier();
        for (var j = 0u; j < min(TILE, p.anchors - k0); j += 1u) {
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
    for (var k0 = 0u; k0 < p.anchors; k0 += TILE) {
        load_tile(k0, lane);
        workgroupBarrier();
        for (var j = 0u; j < min(TILE, p.anchors - k0); j += 1u) {
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
