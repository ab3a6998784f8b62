// y = act(a [+ b]), number by number. Serves `activate` and `add`.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let row = index / p.channels;
    let channel = index % p.channels;
    if row >= rows_of(p.rows_count, p.rows_per) { return; }
    var y = arena[p.a_offset + row * p.a_stride + channel];
    if p.has_b != 0u { y += arena[p.b_offset + row * p.b_stride + channel]; }
    arena[p.y_offset + row * p.y_stride + channel] = activate(y, p.activation);
}
