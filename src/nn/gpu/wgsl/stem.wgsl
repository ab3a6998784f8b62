// Two 3x3 convolutions with ReLU on a grey picture, each followed by an optional affine map per channel, then the maximum of
// 2x2: the full-resolution activations of SuperPoint's first two layers never reach memory.
// A workgroup makes 4x4 pooled pixels, thus 8x8 of the second convolution; the first one is made for 10x10 pixels in slices
// of 16 channels. At most 64 output channels.
var<workgroup> gray: array<f32, 144>;       // 12 x 12
var<workgroup> hidden: array<f32, 1600>;    // 10 x 10 pixels, 16 channels
var<workgroup> pooled: array<f32, 1024>;    // 8 x 8 pixels, 16 channels

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32,
        @builtin(local_invocation_id) local: vec3<u32>) {
    let left = i32(group.x * 8u) - 2;
    let top = i32(group.y * 8u) - 2;
    for (var i = lane; i < 144u; i += 64u) {
        let x = left + i32(i % 12u);
        let y = top + i32(i / 12u);
        var value = 0.0;
        if x >= 0 && y >= 0 && x < i32(p.in_width) && y < i32(p.in_height) {
            value = arena[p.x_offset + (u32(y) * p.in_width + u32(x)) * p.x_stride];
        }
        gray[i] = value;
    }
    workgroupBarrier();
    var sum: array<vec4<f32>, 16>;
    for (var c0 = 0u; c0 < p.hidden_channels; c0 += 16u) {
        for (var i = lane; i < 1600u; i += 64u) {
            let pixel = i / 16u;
            let c = c0 + i % 16u;
            let px = pixel % 10u;
            let py = pixel / 10u;
            let x = left + 1 + i32(px);
            let y = top + 1 + i32(py);
            var value = 0.0;
            // Outside the picture the second convolution sees its border of zeros, not the first one's response.
            if x >= 0 && y >= 0 && x < i32(p.in_width) && y < i32(p.in_height) {
                value = weight(p.a_bias + c);
                for (var tap = 0u; tap < 9u; tap += 1u) {
                    value = fma(gray[(py + tap / 3u) * 12u + px + tap % 3u], of_matrix(p.a_offset, c * 9u + tap, A_HALF), value);
                }
                value = max(value, 0.0);
                if p.a_post != 0u { value = value * weight(p.a_post_scale + c) + weight(p.a_post_bias + c); }
            }
            hidden[i] = value;
        }
        workgroupBarrier();
        for (var tap = 0u; tap < 9u; tap += 1u) {
            let h0 = ((local.y + tap / 3u) * 10u + local.x + tap % 3u) * 16u;
            for (var c = 0u; c < 16u; c += 1u) {
                let h = hidden[h0 + c];
                let w0 = tap * p.hidden_channels + c0 + c;
                let step = 9u * p.hidden_channels;
                for (var o = 0u; o < p.columns / 4u; o += 1u) {
                    let w = w0 + 4u * o * step;
                    let b = vec4<f32>(of_matrix(p.b_offset, w, B_HALF), of_matrix(p.b_offset, w + step, B_HALF),
                                      of_matrix(p.b_offset, w + 2u * step, B_HALF), of_matrix(p.b_offset, w + 3u * step, B_HALF));
                    sum[o] = fma(vec4<f32>(h), b, sum[o]);
                }
            }
        }
        workgroupBarrier();
    }
    let out_x = group.x * 4u + lane % 4u;
    let out_y = group.y * 4u + lane / 4u % 4u;
    for (var c0 = 0u; c0 < p.columns; c0 += 16u) {
        for (var c = 0u; c < min(16u, p.columns - c0); c += 1u) {
            let channel = c0 + c;
            var value = max(sum[channel / 4u][channel % 4u] + weight(p.b_bias + channel), 0.0);
            if p.b_post != 0u { value = value * weight(p.b_post_scale + channel) + weight(p.b_post_bias + channel); }
            pooled[lane * 16u + c] = value;
        }
        workgroupBarrier();
        if out_x < p.out_width && out_y < p.out_height {
            let corner = (lane / 4u % 4u * 2u * 8u + lane % 4u * 2u) * 16u;
            for (var c = lane / 16u; c < min(16u, p.columns - c0); c += 4u) {
                let value = max(max(pooled[corner + c], pooled[corner + 16u + c]),
                                max(pooled[corner + 128u + c], pooled[corner + 144u + c]));
                arena[p.y_offset + (out_y * p.out_width + out_x) * p.y_stride + c0 + c] = value;
            }
        }
        workgroupBarrier();
    }
}
