// y = act(A W^T + bias + residual) in tiles of 32 x 32, four by four results a thread. The kernel that stands before this
// text says how many rows A has (`num_rows`) and what is in them (`row_number`). Row tiles are spread over y and z, because
// one axis holds at most 65535 workgroups; z also runs over the groups of a grouped layer.
var<workgroup> tile_a: array<f32, 512>; // [k 16][row 32]
var<workgroup> tile_b: array<f32, 512>; // [k 16][column 32]

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32,
        @builtin(local_invocation_id) local: vec3<u32>) {
    let layer_group = group.z % p.groups;
    let row0 = (group.z / p.groups * p.tiles_y + group.y) * 32u;
    let column0 = group.x * 32u;
    let first = layer_group * p.columns;
    // The number of rows is the same for the whole workgroup, yet not provably uniform: so no early return before a
    // barrier; tiles past the end compute on zeros and store nothing.
    let rows = num_rows();
    var sum: array<vec4<f32>, 4>;
    for (var k0 = 0u; k0 < p.depth; k0 += 16u) {
        for (var i = lane; i < 512u; i += 64u) {
            let k = k0 + i % 16u;
            let m = i / 16u;
            var a = 0.0;
            if k < p.depth && row0 + m < rows { a = row_number(layer_group, row0 + m, k); }
            tile_a[i % 16u * 32u + m] = a;
            var b = 0.0;
            if k < p.depth && column0 + m < p.columns {
                b = of_matrix(p.w_offset, (first + column0 + m) * p.depth + k, W_HALF);
            }
            tile_b[i % 16u * 32u + m] = b;
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
            let channel = first + column;
            var y = sum[i][j];
            if p.has_bias != 0u { y += weight(p.bias_offset + channel); }
            if p.has_residual != 0u { y += arena[p.r_offset + row * p.r_stride + channel]; }
            arena[p.y_offset + row * p.y_stride + channel] = activate(y, p.activation);
        }
    }
}
