// Each channel minus its mean over all rows, divided by the root of variance + eps. One workgroup a channel; the mean
// first, then the variance about it, because the difference of squares loses the digits of flat pictures.
var<workgroup> partial: array<f32, 256>;

fn total(lane: u32, value: f32) -> f32 {
    partial[lane] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half { partial[lane] += partial[lane + half]; }
        workgroupBarrier();
    }
    let sum = partial[0];
    workgroupBarrier();
    return sum;
}

@compute @workgroup_size(256, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let channel = group.x;
    let rows = rows_of(p.rows_count, p.rows_per);
    var sum = 0.0;
    for (var row = lane; row < rows; row += 256u) {
        sum += arena[p.x_offset + row * p.x_stride + channel];
    }
    let mean = total(lane, sum) / f32(max(rows, 1u));
    var squares = 0.0;
    for (var row = lane; row < rows; row += 256u) {
        let d = arena[p.x_offset + row * p.x_stride + channel] - mean;
        squares += d * d;
    }
    let variance = total(lane, squares) / f32(max(rows, 1u));
    let inverse = 1.0 / sqrt(variance + p.eps);
    for (var row = lane; row < rows; row += 256u) {
        arena[p.y_offset + row * p.y_stride + channel] = (arena[p.x_offset + row * p.x_stride + channel] - mean) * inverse;
    }
}
