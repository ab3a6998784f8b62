// 3x3 convolution with a border of one zero as an implicit matrix product: rows are output pixels, the inner index runs
// over taps and input channels (tap major; the weights are packed so at load). Same tiles as linear.wgsl.
// Twin of cpu/kernels/conv3x3.
var<workgroup> tile_a: array<f32, 512>; // [k 16][pixel 32]
var<workgroup> tile_b: array<f32, 512>; // [k 16][channel 32]

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32,
        @builtin(local_invocation_id) local: vec3<u32>) {
    let pixels = p.out_width * p.out_height;
    // Pixel tiles are spread over y and z, because one axis holds at most 65535 workgroups.
    let row0 = (group.z * p.tiles_y + group.y) * 32u;
    let column0 = group.x * 32u;
    let depth = 9u * p.in_channels;
    var sum: array<vec4<f32>, 4>;
    for (var k0 = 0u; k0 < depth; k0 += 16u) {
        for (var i = lane; i < 512u; i += 64u) {
            let k = k0 + i % 16u;
            let m = i / 16u;
            var a = 0.0;
            let pixel = row0 + m;
            if k < depth && pixel < pixels {
                let tap = k / p.in_channels;
                let iy = i32(pixel / p.out_width * p.stride + tap / 3u) - 1;
                let ix = i32(pixel % p.out_width * p.stride + tap % 3u) - 1;
                if iy >= 0 && iy < i32(p.in_height) && ix >= 0 && ix < i32(p.in_width) {
                    a = arena[p.x_offset + (u32(iy) * p.in_width + u32(ix)) * p.x_stride + k % p.in_channels];
                }
            }
            tile_a[i % 16u * 32u + m] = a;
            var b = 0.0;
            if k < depth && column0 + m < p.columns {
                b = weights[p.w_offset + (column0 + m) * depth + k];
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
        let pixel = row0 + local.y * 4u + i;
        if pixel >= pixels { break; }
        for (var j = 0u; j < 4u; j += 1u) {
            let channel = column0 + local.x * 4u + j;
            if channel >= p.columns { break; }
            var y = sum[i][j];
            if p.has_bias != 0u { y += weights[p.bias_offset + channel]; }
            if p.has_residual != 0u { y += arena[p.r_offset + pixel * p.r_stride + channel]; }
            arena[p.y_offset + pixel * p.y_stride + channel] = activate(y, p.activation);
        }
    }
}
