// 3x3 convolution for few input channels: one thread makes up to eight output channels of one pixel straight from the
// picture. Same weights and meaning as conv3x3.wgsl.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let pixels = p.out_width * p.out_height;
    let pixel = (group.z * p.tiles_y + group.y) * 64u + lane;
    if pixel >= pixels { return; }
    let column0 = group.x * 8u;
    let columns = min(8u, p.columns - column0);
    let depth = 9u * p.in_channels;
    var sum: array<f32, 8>;
    for (var tap = 0u; tap < 9u; tap += 1u) {
        let iy = i32(pixel / p.out_width * p.stride + tap / 3u) - 1;
        let ix = i32(pixel % p.out_width * p.stride + tap % 3u) - 1;
        if iy < 0 || iy >= i32(p.in_height) || ix < 0 || ix >= i32(p.in_width) { continue; }
        let x0 = p.x_offset + (u32(iy) * p.in_width + u32(ix)) * p.x_stride;
        for (var c = 0u; c < p.in_channels; c += 1u) {
            let a = arena[x0 + c];
            let w0 = column0 * depth + tap * p.in_channels + c;
            for (var j = 0u; j < columns; j += 1u) {
                sum[j] = fma(a, of_matrix(p.w_offset, w0 + j * depth, W_HALF), sum[j]);
            }
        }
    }
    for (var j = 0u; j < columns; j += 1u) {
        let channel = column0 + j;
        var y = sum[j];
        if p.has_bias != 0u { y += weight(p.bias_offset + channel); }
        if p.has_residual != 0u { y += arena[p.r_offset + pixel * p.r_stride + channel]; }
        arena[p.y_offset + pixel * p.y_stride + channel] = activate(y, p.activation);
    }
}
