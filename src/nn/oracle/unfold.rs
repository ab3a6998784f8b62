//! Space to depth.

use super::View;

pub(super) fn unfold(x: View<'_>, block: usize) -> Vec<f32> {
    let mut y = Vec::with_capacity(x.rows * x.channels);
    for cell_y in 0..x.grid.height / block {
        for cell_x in 0..x.grid.width / block {
            for dy in 0..block {
                for dx in 0..block {
                    let pixel = (cell_y * block + dy) * x.grid.width + cell_x * block + dx;
                    y.extend_from_slice(x.row(pixel));
                }
            }
        }
    }
    y
}
