// A linear layer: the rows of the product are those of x. The rest is tile_product.wgsl. Twin of cpu/kernels/linear.
fn num_rows() -> u32 { return rows_of(p.rows_count, p.rows_per); }

fn row_number(layer_group: u32, row: u32, k: u32) -> f32 {
    return arena[p.x_offset + row * p.x_stride + layer_group * p.depth + k];
}
