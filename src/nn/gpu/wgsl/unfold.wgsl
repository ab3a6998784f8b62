// Space to depth: the channels of a cell are its pixels row by row, each with all its input channels.
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = (group.y * p.tiles_x + group.x) * 64u + lane;
    let cell = index / p.channels;
    let channel = index % p.channels;
    if cell >= p.out_width * p.out_height { return; }
    let inner = channel / p.in_channels;
    let y = cell / p.out_width * p.block + inner / p.block;
    let x = cell % p.out_width * p.block + inner % p.block;
    arena[p.y_offset + cell * p.y_stride + channel] = arena[p.x_offset + (y * p.in_width + x) * p.x_stride + channel % p.in_channels];
}
