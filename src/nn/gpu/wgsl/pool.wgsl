// Mean or maximum of windows; windows of the mean never reach over the border. Twin of cpu/kernels/pool.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let pixel = index / p.channels;
    let channel = index % p.channels;
    if pixel >= p.out_width * p.out_height { return; }
    let left = i32(pixel % p.out_width * p.stride) - i32(p.pad);
    let top = i32(pixel / p.out_width * p.stride) - i32(p.pad);
    var sum = 0.0;
    var largest = LOWEST;
    for (var dy = 0; dy < i32(p.size); dy += 1) {
        for (var dx = 0; dx < i32(p.size); dx += 1) {
            let x = left + dx;
            let y = top + dy;
            if x < 0 || y < 0 || x >= i32(p.in_width) || y >= i32(p.in_height) { continue; }
            let value = arena[p.x_offset + (u32(y) * p.in_width + u32(x)) * p.x_stride + channel];
            sum += value;
            largest = max(largest, value);
        }
    }
    arena[p.y_offset + pixel * p.y_stride + channel] = select(sum / f32(p.size * p.size), largest, p.maximum != 0u);
}
