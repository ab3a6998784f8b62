// Multi-head attention with a streaming softmax: one query a thread, keys and values in tiles of 16. The host gives
// `D4` and `E4`, a quarter of the head's width of keys and values. Twin of cpu/kernels/attention.
var<workgroup> keys: array<vec4<f32>, 16 * D4>;
var<workgroup> values: array<vec4<f32>, 16 * E4>;
var<workgroup> takes_part: array<u32, 16>;

fn load4(index: u32) -> vec4<f32> {
    return vec4<f32>(arena[index], arena[index + 1u], arena[index + 2u], arena[index + 3u]);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let head = group.y;
    let row = group.x * 64u + lane;
    let num_queries = rows_of(p.rows_count, p.rows_per);
    // Uniform bound for the barriers: the capacity; tiles past the run-time number are skipped by every thread alike.
    let num_keys = rows_of(p.keys_count, p.keys_per);
    let d = 4u * D4;
    let e = 4u * E4;
    var query: array<vec4<f32>, D4>;
    if row < num_queries {
        for (var i = 0u; i < D4; i += 1u) {
            query[i] = load4(p.q_offset + row * p.q_stride + head * d + 4u * i) * p.scale;
        }
    }
    var sum: array<vec4<f32>, E4>;
    var largest = LOWEST;
    var weight_sum = 0.0;
    for (var k0 = 0u; k0 < p.keys_capacity; k0 += 16u) {
        for (var i = lane; i < 16u * D4; i += 64u) {
            let key = k0 + i / D4;
            var value = vec4<f32>(0.0);
            if key < num_keys { value = load4(p.k_offset + key * p.k_stride + head * d + 4u * (i % D4)); }
            keys[i] = value;
        }
        for (var i = lane; i < 16u * E4; i += 64u) {
            let key = k0 + i / E4;
            var value = vec4<f32>(0.0);
            if key < num_keys { value = load4(p.v_offset + key * p.v_stride + head * e + 4u * (i % E4)); }
            values[i] = value;
        }
        if lane < 16u {
            var part = select(0u, 1u, k0 + lane < num_keys);
            if p.masked != 0u && part != 0u {
                part = select(0u, 1u, arena[p.m_offset + (k0 + lane) * p.m_stride] > 0.0);
            }
            takes_part[lane] = part;
        }
        workgroupBarrier();
        if row < num_queries && k0 < num_keys {
            for (var j = 0u; j < 16u; j += 1u) {
                if takes_part[j] == 0u { continue; }
                var s = 0.0;
                for (var i = 0u; i < D4; i += 1u) { s += dot(query[i], keys[j * D4 + i]); }
                if s > largest {
                    let shrink = exp(largest - s);
                    largest = s;
                    weight_sum *= shrink;
                    for (var i = 0u; i < E4; i += 1u) { sum[i] *= shrink; }
                }
                let weight = exp(s - largest);
                weight_sum += weight;
                for (var i = 0u; i < E4; i += 1u) { sum[i] = fma(vec4<f32>(weight), values[j * E4 + i], sum[i]); }
            }
        }
        workgroupBarrier();
    }
    if row >= num_queries { return; }
    let inverse = select(0.0, 1.0 / weight_sum, weight_sum > 0.0);
    let y0 = p.y_offset + row * p.y_stride + head * e;
    for (var i = 0u; i < E4; i += 1u) {
        let y = sum[i] * inverse;
        arena[y0 + 4u * i] = y.x;
        arena[y0 + 4u * i + 1u] = y.y;
        arena[y0 + 4u * i + 2u] = y.z;
        arena[y0 + 4u * i + 3u] = y.w;
    }
}
