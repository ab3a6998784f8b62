// 3x3 convolution with a border of one zero as an implicit matrix product: the rows are output pixels, the inner index runs
// over taps and input channels (tap major; the weights are packed so at load). The rest is tile_product.wgsl.
// Twin of cpu/kernels/conv3x3.
fn num_rows() -> u32 { return p.out_width * p.out_height; }

fn row_number(layer_group: u32, row: u32, k: u32) -> f32 {
    let tap = k / p.in_channels;
    let iy = i32(row / p.out_width * p.stride + tap / 3u) - 1;
    let ix = i32(row % p.out_width * p.stride + tap % 3u) - 1;
    if iy < 0 || iy >= i32(p.in_height) || ix < 0 || ix >= i32(p.in_width) { return 0.0; }
    return arena[p.x_offset + (u32(iy) * p.in_width + u32(ix)) * p.x_stride + k % p.in_channels];
}
