// A grouped linear layer with one channel a group: y = act(x * weight + bias + residual) channel by channel.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let row = index / p.channels;
    let channel = index % p.channels;
    if row >= rows_of(p.rows_count, p.rows_per) { return; }
    var y = arena[p.x_offset + row * p.x_stride + channel] * weight(p.w_offset + channel);
    if p.has_bias != 0u { y += weight(p.bias_offset + channel); }
    if p.has_residual != 0u { y += arena[p.r_offset + row * p.r_stride + channel]; }
    arena[p.y_offset + row * p.y_stride + channel] = activate(y, p.activation);
}
