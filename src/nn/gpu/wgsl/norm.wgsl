// Layer norm (centred, with gain and bias) or L2 norm of each row; one workgroup a row. Twin of cpu/kernels/norm.
var<workgroup> partial: array<f32, 64>;

fn total(lane: u32, value: f32) -> f32 {
    partial[lane] = value;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if lane < half { partial[lane] += partial[lane + half]; }
        workgroupBarrier();
    }
    let sum = partial[0];
    workgroupBarrier();
    return sum;
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group.y * p.tiles_x + group.x;
    let inside = row < rows_of(p.rows_count, p.rows_per);
    let x0 = p.x_offset + row * p.x_stride;
    var mean = 0.0;
    var sum = 0.0;
    if p.centred != 0u {
        if inside {
            for (var c = lane; c < p.channels; c += 64u) { sum += arena[x0 + c]; }
        }
        mean = total(lane, sum) / f32(p.channels);
    }
    var squares = 0.0;
    if inside {
        for (var c = lane; c < p.channels; c += 64u) {
            let d = arena[x0 + c] - mean;
            squares += d * d;
        }
    }
    squares = total(lane, squares);
    if !inside { return; }
    let y0 = p.y_offset + row * p.y_stride;
    if p.centred != 0u {
        let inverse = 1.0 / sqrt(squares / f32(p.channels) + p.eps);
        for (var c = lane; c < p.channels; c += 64u) {
            arena[y0 + c] = (arena[x0 + c] - mean) * inverse * weight(p.gain_offset + c) + weight(p.bias_offset + c);
        }
    } else {
        let inverse = 1.0 / max(sqrt(squares), p.eps);
        for (var c = lane; c < p.channels; c += 64u) { arena[y0 + c] = arena[x0 + c] * inverse; }
    }
}
