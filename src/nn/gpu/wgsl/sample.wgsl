// Reads a picture at given positions, bilinearly or bicubically (a = -0.75); cells outside count as zero.
// Twin of cpu/kernels/sample.
fn cell(x: i32, y: i32, channel: u32) -> f32 {
    if x < 0 || y < 0 || x >= i32(p.in_width) || y >= i32(p.in_height) { return 0.0; }
    return arena[p.x_offset + (u32(y) * p.in_width + u32(x)) * p.x_stride + channel];
}

fn near(t: f32) -> f32 { return (1.25 * t - 2.25) * t * t + 1.0; }
fn far(t: f32) -> f32 { return ((-0.75 * t + 3.75) * t - 6.0) * t + 3.0; }

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let row = index / p.channels;
    let channel = index % p.channels;
    if row >= rows_of(p.rows_count, p.rows_per) { return; }
    let at = p.at_offset + row * p.at_stride;
    // Positions far outside would overflow the conversion to integers; they read zeros wherever they are.
    let gx = clamp(fma(arena[at], p.scale_x, p.offset_x), -8.0, f32(p.in_width) + 8.0);
    let gy = clamp(fma(arena[at + 1u], p.scale_y, p.offset_y), -8.0, f32(p.in_height) + 8.0);
    let x0 = i32(floor(gx));
    let y0 = i32(floor(gy));
    let fx = gx - floor(gx);
    let fy = gy - floor(gy);
    var y = 0.0;
    if p.bicubic == 0u {
        let top = cell(x0, y0, channel) * (1.0 - fx) + cell(x0 + 1, y0, channel) * fx;
        let bottom = cell(x0, y0 + 1, channel) * (1.0 - fx) + cell(x0 + 1, y0 + 1, channel) * fx;
        y = top * (1.0 - fy) + bottom * fy;
    } else {
        let wx = vec4<f32>(far(1.0 + fx), near(fx), near(1.0 - fx), far(2.0 - fx));
        let wy = vec4<f32>(far(1.0 + fy), near(fy), near(1.0 - fy), far(2.0 - fy));
        for (var j = 0; j < 4; j += 1) {
            let yy = y0 + j - 1;
            let line = vec4<f32>(cell(x0 - 1, yy, channel), cell(x0, yy, channel), cell(x0 + 1, yy, channel), cell(x0 + 2, yy, channel));
            y += wy[j] * dot(wx, line);
        }
    }
    arena[p.y_offset + row * p.y_stride + channel] = y;
}
