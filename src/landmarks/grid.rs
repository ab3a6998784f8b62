//! Keypoints by place: which lie in a window.

use crate::features::Keypoint;

/// Side of a cell, pixels.
const CELL: f64 = 16.0;
/// Most cells along one side; pictures are no larger than 8192 pixels.
const MAX_CELLS: f64 = 512.0;

/// Buckets of square cells.
#[derive(Debug, Default)]
pub(super) struct PixelGrid {
    columns: usize,
    rows: usize,
    /// First member of each cell, and the end of the last.
    starts: Vec<u32>,
    /// Keypoints by cell, within a cell in their order.
    members: Vec<u32>,
}

fn cell(at: f64, num: usize) -> usize {
    ((at / CELL).max(0.0) as usize).min(num - 1)
}

impl PixelGrid {
    /// Sorts the keypoints of a picture of this size.
    pub(super) fn load(&mut self, keypoints: &[Keypoint], (width, height): (u32, u32)) {
        let cells = |side: u32| (f64::from(side) / CELL).ceil().clamp(1.0, MAX_CELLS) as usize;
        (self.columns, self.rows) = (cells(width), cells(height));
        let (columns, rows) = (self.columns, self.rows);
        let of = |k: &Keypoint| cell(k.pixel.y, rows) * columns + cell(k.pixel.x, columns);
        self.starts.clear();
        self.starts.resize(columns * rows + 1, 0);
        for k in keypoints {
            self.starts[of(k) + 1] += 1;
        }
        for i in 0..columns * rows {
            self.starts[i + 1] += self.starts[i];
        }
        self.members.clear();
        self.members.resize(keypoints.len(), 0);
        // The starts move to the ends while the cells are filled, and are moved back afterwards.
        for (i, k) in keypoints.iter().enumerate() {
            let at = &mut self.starts[of(k)];
            self.members[*at as usize] = i as u32;
            *at += 1;
        }
        self.starts.copy_within(0..columns * rows, 1);
        self.starts[0] = 0;
    }

    /// Calls `visit` for the keypoints of all cells that a window of this half side touches.
    pub(super) fn around(&self, x: f64, y: f64, half: f64, mut visit: impl FnMut(u32)) {
        let (left, right) = (cell(x - half, self.columns), cell(x + half, self.columns));
        let (top, bottom) = (cell(y - half, self.rows), cell(y + half, self.rows));
        for row in top..=bottom {
            let first = self.starts[row * self.columns + left] as usize;
            let end = self.starts[row * self.columns + right + 1] as usize;
            for member in &self.members[first..end] {
                visit(*member);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::math::Rng;

    #[test]
    fn a_window_holds_what_a_search_through_all_finds() {
        let mut rng = Rng::from_seed(8);
        let keypoints: Vec<Keypoint> = (0..500)
            .map(|_| Keypoint {
                // Some lie outside of the picture.
                pixel: Pixel::new(rng.range(-5.0, 110.0), rng.range(0.0, 75.0)),
                score: 1.0,
            })
            .collect();
        let mut grid = PixelGrid::default();
        for _ in 0..2 {
            grid.load(&keypoints, (100, 70));
            for (x, y, half) in [(50.0, 30.0, 5.0), (0.0, 0.0, 20.0), (104.0, 69.0, 9.0)] {
                let within = |i: &u32| {
                    let p = keypoints[*i as usize].pixel;
                    (p.x - x).abs() <= half && (p.y - y).abs() <= half
                };
                let mut found = Vec::new();
                grid.around(x, y, half, |i| found.push(i));
                found.retain(within);
                found.sort_unstable();
                let all: Vec<u32> = (0..500).filter(within).collect();
                assert_eq!(found, all);
            }
        }
    }
}
