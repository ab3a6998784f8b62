// Moves the rows that keep_scan.wgsl chose.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let row = index / p.channels;
    let channel = index % p.channels;
    if row >= counts[p.kept_count] { return; }
    let source = u32(arena[p.i_offset + row * p.i_stride]);
    arena[p.y_offset + row * p.y_stride + channel] = arena[p.x_offset + source * p.x_stride + channel];
}
