// Softmax over block * block + 1 channels of a cell; the last is dropped, the others become a patch of the heat map.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let cell = (group.y * p.tiles_x + group.x) * 64u + lane;
    if cell >= p.in_width * p.in_height { return; }
    let channels = p.block * p.block;
    let x0 = p.x_offset + cell * p.x_stride;
    var largest = arena[x0];
    for (var c = 1u; c <= channels; c += 1u) { largest = max(largest, arena[x0 + c]); }
    var sum = 0.0;
    for (var c = 0u; c <= channels; c += 1u) { sum += exp(arena[x0 + c] - largest); }
    let width = p.in_width * p.block;
    let corner = cell / p.in_width * p.block * width + cell % p.in_width * p.block;
    for (var c = 0u; c < channels; c += 1u) {
        let pixel = corner + c / p.block * width + c % p.block;
        arena[p.y_offset + pixel * p.y_stride] = exp(arena[x0 + c] - largest) / sum;
    }
}
