// y = act(x W^T + bias + residual) in tiles of 32 x 32, four by four results a thread. Workgroup z is the group of a
// grouped layer. Twin of cpu/kernels/linear.
var<workgroup> tile_a: array<f32, 512>; // [k 16][row 32]
var<workgroup> tile_b: array<f32, 512>; // [k 16][column 32]

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32,
        @builtin(local_invocation_id) local: vec3<u32>) {
    let rows = rows_of(p.rows_count, p.rows_per);
    let row0 = group.y * 32u;
    let column0 = group.x * 32u;
    // The number of rows is the same for the whole workgroup, yet not provably uniform: so no early return before a
    // barrier; tiles past the end compute on zeros and store nothing.
    let x0 = p.x_offset + group.z * p.depth;
    let w0 = p.w_offset + group.z * p.columns * p.depth;
    var sum: array<vec4<f32>, 4>;
    for (var k0 = 0u; k0 < p.depth; k0 += 16u) {
        for (var i = lane; i < 512u; i += 64u) {
            let k = i % 16u;
            let m = i / 16u;
            var a = 0.0;
            if k0 + k < p.depth && row0 + m < rows {
                a = arena[x0 + (row0 + m) * p.x_stride + k0 + k];
            }
            tile_a[k * 32u + m] = a;
            var b = 0.0;
            if k0 + k < p.depth && column0 + m < p.columns {
                b = weights[w0 + (column0 + m) * p.depth + k0 + k];
            }
            tile_b[k * 32u + m] = b;
        }
        workgroupBarrier();
        for (var k = 0u; k < 16u; k += 1u) {
            let ai = k * 32u + local.y * 4u;
            let bi = k * 32u + local.x * 4u;
            let b = vec4<f32>(tile_b[bi], tile_b[bi + 1u], tile_b[bi + 2u], tile_b[bi + 3u]);
            sum[0] = fma(vec4<f32>(tile_a[ai]), b, sum[0]);
            sum[1] = fma(vec4<f32>(tile_a[ai + 1u]), b, sum[1]);
            sum[2] = fma(vec4<f32>(tile_a[ai + 2u]), b, sum[2]);
            sum[3] = fma(vec4<f32>(tile_a[ai + 3u]), b, sum[3]);
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < 4u; i += 1u) {
        let row = row0 + local.y * 4u + i;
        if row >= rows { break; }
        for (var j = 0u; j < 4u; j += 1u) {
            let column = column0 + local.x * 4u + j;
            if column >= p.columns { break; }
            let channel = group.z * p.columns + column;
            var y = sum[i][j];
            if p.has_bias != 0u { y += weights[p.bias_offset + channel]; }
            if p.has_residual != 0u { y += arena[p.r_offset + row * p.r_stride + channel]; }
            arena[p.y_offset + row * p.y_stride + channel] = activate(y, p.activation);
        }
    }
}
