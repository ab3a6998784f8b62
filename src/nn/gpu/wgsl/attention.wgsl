// Multi-head attention with a streaming softmax: one query a thread, keys and values in tiles of `TILE`. The host gives the
// head's width of keys `D` and of values `E`, and as many keys a tile as workgroup memory holds.
// Twin of cpu/kernels/attention.
const D4: u32 = (D + 3u) / 4u;
const E4: u32 = (E + 3u) / 4u;
var<workgroup> keys: array<vec4<f32>, TILE * D4>;
var<workgroup> values: array<vec4<f32>, TILE * E4>;
var<workgroup> takes_part: array<u32, TILE>;

// Four numbers from `at`; those past the first `left` are zero, and not read.
fn load4(at: u32, left: u32) -> vec4<f32> {
    if left >= 4u { return vec4<f32>(arena[at], arena[at + 1u], arena[at + 2u], arena[at + 3u]); }
    var some = vec4<f32>(arena[at], 0.0, 0.0, 0.0);
    if left > 1u { some.y = arena[at + 1u]; }
    if left > 2u { some.z = arena[at + 2u]; }
    return some;
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let head = group.y;
    let row = group.x * 64u + lane;
    let num_queries = rows_of(p.rows_count, p.rows_per);
    // Uniform bound for the barriers: the capacity; tiles past the run-time number are skipped by every thread alike.
    let num_keys = rows_of(p.keys_count, p.keys_per);
    var query: array<vec4<f32>, D4>;
    if row < num_queries {
        for (var i = 0u; i < D4; i += 1u) {
            query[i] = load4(p.q_offset + row * p.q_stride + head * D + 4u * i, D - 4u * i) * p.scale;
        }
    }
    var sum: array<vec4<f32>, E4>;
    var largest = LOWEST;
    var weight_sum = 0.0;
    for (var k0 = 0u; k0 < p.keys_capacity; k0 += TILE) {
        for (var i = lane; i < TILE * D4; i += 64u) {
            let key = k0 + i / D4;
            let c = 4u * (i % D4);
            var value = vec4<f32>(0.0);
            if key < num_keys { value = load4(p.k_offset + key * p.k_stride + head * D + c, D - c); }
            keys[i] = value;
        }
        for (var i = lane; i < TILE * E4; i += 64u) {
            let key = k0 + i / E4;
            let c = 4u * (i % E4);
            var value = vec4<f32>(0.0);
            if key < num_keys { value = load4(p.v_offset + key * p.v_stride + head * E + c, E - c); }
            values[i] = value;
        }
        if lane < TILE {
            var part = select(0u, 1u, k0 + lane < num_keys);
            if p.masked != 0u && part != 0u {
                part = select(0u, 1u, arena[p.m_offset + (k0 + lane) * p.m_stride] > 0.0);
            }
            takes_part[lane] = part;
        }
        workgroupBarrier();
        if row < num_queries && k0 < num_keys {
            for (var j = 0u; j < TILE; j += 1u) {
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
    let y0 = p.y_offset + row * p.y_stride + head * E;
    for (var c = 0u; c < E; c += 1u) { arena[y0 + c] = sum[c / 4u][c % 4u] * inverse; }
}
