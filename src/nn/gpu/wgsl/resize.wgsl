// Bilinear resize with half-pixel centres and clamped borders; adds a second picture of the output's size if there is one.
// Twin of cpu/kernels/resize.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let pixel = index / p.channels;
    let channel = index % p.channels;
    if pixel >= p.out_width * p.out_height { return; }
    let scale_x = f32(p.in_width) / f32(p.out_width);
    let scale_y = f32(p.in_height) / f32(p.out_height);
    let sx = max((f32(pixel % p.out_width) + 0.5) * scale_x - 0.5, 0.0);
    let sy = max((f32(pixel / p.out_width) + 0.5) * scale_y - 0.5, 0.0);
    let x0 = min(u32(sx), p.in_width - 1u);
    let y0 = min(u32(sy), p.in_height - 1u);
    let x1 = min(x0 + 1u, p.in_width - 1u);
    let y1 = min(y0 + 1u, p.in_height - 1u);
    let fx = sx - f32(x0);
    let fy = sy - f32(y0);
    let base = p.x_offset + channel;
    let top = mix(arena[base + (y0 * p.in_width + x0) * p.x_stride], arena[base + (y0 * p.in_width + x1) * p.x_stride], fx);
    let bottom = mix(arena[base + (y1 * p.in_width + x0) * p.x_stride], arena[base + (y1 * p.in_width + x1) * p.x_stride], fx);
    var y = mix(top, bottom, fy);
    if p.has_residual != 0u { y += arena[p.r_offset + pixel * p.r_stride + channel]; }
    arena[p.y_offset + pixel * p.y_stride + channel] = y;
}
