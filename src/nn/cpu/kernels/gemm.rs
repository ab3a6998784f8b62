//! Matrix products: the tile in registers, weights packed for it, and the loop over tiles.
//!
//! The right-hand matrix is packed once into panels `[k][width]`, two vectors wide (one for a narrow rest), so that the
//! inner loop reads it in order. The left-hand matrix is read in place, one broadcast per row and step. Bias, residual
//! and ReLU are applied while the tile is in registers. A 3x3 convolution is the same product with overlapping left-hand
//! rows (see `conv3x3`).

use crate::simd::kernels::{Lanes, Level, entry};

/// Most rows of the left-hand matrix that are used against all panels before the next ones.
const BLOCK_ROWS: usize = 96;

/// Numbers of these rows, 128 KB: with the panels they have to stay in the second cache.
const BLOCK_NUMBERS: usize = 1 << 15;

/// Rows of a block, a multiple of all tiles' rows.
#[inline(always)]
fn block_rows(depth: usize) -> usize {
    (BLOCK_NUMBERS / depth.max(1) / 12 * 12).clamp(24, BLOCK_ROWS)
}

/// A right-hand matrix `[depth, columns]` with its bias, in the order of the tiles of one level.
#[derive(Debug, Clone)]
pub(in crate::nn::cpu) struct Packed {
    pub(super) level: Level,
    pub(super) depth: usize,
    pub(super) columns: usize,
    pub(super) panels: Vec<f32>,
    pub(super) bias: Vec<f32>,
}

impl Packed {
    /// Packs a matrix given by its elements `at(row k, column n)`.
    pub(in crate::nn::cpu) fn new(
        level: Level,
        depth: usize,
        columns: usize,
        bias: Option<&[f32]>,
        at: impl Fn(usize, usize) -> f32,
    ) -> Self {
        let mut packed = Self {
            level,
            depth: 0,
            columns: 0,
            panels: Vec::new(),
            bias: Vec::new(),
        };
        packed.refill(depth, columns, at);
        if let Some(bias) = bias {
            packed.bias[..columns].copy_from_slice(&bias[..columns]);
        }
        packed
    }

    /// Packs another matrix in the same memory, without bias.
    pub(in crate::nn::cpu) fn refill(
        &mut self,
        depth: usize,
        columns: usize,
        at: impl Fn(usize, usize) -> f32,
    ) {
        let lanes = self.level.lanes();
        let padded = columns.next_multiple_of(lanes);
        (self.depth, self.columns) = (depth, columns);
        self.panels.clear();
        self.panels.reserve_exact(padded * depth);
        let mut first = 0;
        while first < columns {
            let width = panel_width(lanes, columns - first);
            for k in 0..depth {
                self.panels.extend(
                    (first..first + width).map(|n| if n < columns { at(k, n) } else { 0.0 }),
                );
            }
            first += width;
        }
        self.bias.clear();
        self.bias.resize(padded, 0.0);
    }

    /// Rows of the matrix.
    pub(in crate::nn::cpu) fn depth(&self) -> usize {
        self.depth
    }

    /// Columns of the matrix.
    pub(in crate::nn::cpu) fn columns(&self) -> usize {
        self.columns
    }

    /// Bytes held.
    pub(in crate::nn::cpu) fn bytes(&self) -> usize {
        (self.panels.len() + self.bias.len()) * size_of::<f32>()
    }
}

/// Width of the next panel when `rest` columns are left.
#[inline(always)]
pub(super) fn panel_width(lanes: usize, rest: usize) -> usize {
    if rest > lanes { 2 * lanes } else { lanes }
}

/// One tile's work. Pointers may be null where noted.
#[derive(Clone, Copy)]
pub(super) struct Tile {
    /// First number of the first left-hand row.
    pub(super) a: *const f32,
    /// Depth of the product.
    pub(super) depth: usize,
    /// Numbers from one left-hand row to the next.
    pub(super) a_stride: usize,
    /// First number of the right-hand panel, which has a row of the tile's width for each step.
    pub(super) b: *const f32,
    /// Start values of the columns, a whole panel; null for zero.
    pub(super) bias: *const f32,
    /// Where the result goes.
    pub(super) c: *mut f32,
    /// Numbers from one result row to the next.
    pub(super) c_stride: usize,
    /// Columns to write, at most the panel's width.
    pub(super) columns: usize,
    /// Added to the result; null for nothing. May be `c` itself.
    pub(super) residual: *const f32,
    /// Numbers from one residual row to the next.
    pub(super) residual_stride: usize,
    /// Whether negative results become zero.
    pub(super) relu: bool,
}

/// Adds the products of one step of the depth; `left` tells where the number of a row is.
///
/// # Safety
/// `left` and `b` point to numbers, `b` to `NV` vectors.
#[inline(always)]
unsafe fn step<L: Lanes, const MR: usize, const NV: usize>(
    acc: &mut [[L; NV]; MR],
    left: impl Fn(usize) -> *const f32,
    b: *const f32,
) {
    // SAFETY: the caller vouches for the pointers.
    unsafe {
        let right: [L; NV] = std::array::from_fn(|v| L::load(b.add(v * L::LANES)));
        for (row, sums) in acc.iter_mut().enumerate() {
            let left = L::splat(*left(row));
            for (sum, right) in sums.iter_mut().zip(right) {
                *sum = sum.mul_add(left, right);
            }
        }
    }
}

/// Computes a tile of `MR` rows and `NV` vectors.
///
/// # Safety
/// All pointers are valid for the sizes in the tile; `b` and `bias` for whole panels.
#[inline(always)]
unsafe fn micro<L: Lanes, const MR: usize, const NV: usize>(tile: &Tile) {
    // SAFETY: the caller vouches for the pointers; every access below is within the documented sizes.
    unsafe {
        let mut acc = [[L::splat(0.0); NV]; MR];
        if !tile.bias.is_null() {
            acc = [std::array::from_fn(|v| L::load(tile.bias.add(v * L::LANES))); MR];
        }
        let width = NV * L::LANES;
        let mut b = tile.b;
        let mut done = 0;
        if L::UNROLL {
            // Many rows' addresses do not fit the registers: four steps share what is loaded for them.
            let mut a = tile.a;
            while done + 4 <= tile.depth {
                step::<L, MR, NV>(&mut acc, |row| a.add(row * tile.a_stride), b);
                step::<L, MR, NV>(&mut acc, |row| a.add(row * tile.a_stride + 1), b.add(width));
                step::<L, MR, NV>(
                    &mut acc,
                    |row| a.add(row * tile.a_stride + 2),
                    b.add(2 * width),
                );
                step::<L, MR, NV>(
                    &mut acc,
                    |row| a.add(row * tile.a_stride + 3),
                    b.add(3 * width),
                );
                a = a.add(4);
                b = b.add(4 * width);
                done += 4;
            }
        }
        let rows: [*const f32; MR] = std::array::from_fn(|row| tile.a.add(row * tile.a_stride));
        for k in done..tile.depth {
            step::<L, MR, NV>(&mut acc, |row| rows[row].add(k), b);
            b = b.add(width);
        }
        // Written out, so that every index into the sums is a constant: with a single one that is not, they would live in
        // memory and be stored at every step of the depth.
        macro_rules! finish_rows {
            ($($row:literal)*) => {
                $(if let Some(sums) = acc.get($row) {
                    finish(tile, $row, 0, sums[0]);
                    if NV > 1 {
                        finish(tile, $row, 1, sums[1 % NV]);
                    }
                })*
            };
        }
        finish_rows!(0 1 2 3 4 5 6 7 8 9 10 11);
    }
}

/// Adds the residual to a finished vector of a tile, and writes it.
///
/// # Safety
/// As for [`micro`].
#[inline(always)]
unsafe fn finish<L: Lanes>(tile: &Tile, row: usize, vector: usize, sum: L) {
    let first = vector * L::LANES;
    let count = tile.columns.saturating_sub(first);
    let mut x = sum;
    // SAFETY: passed on to the caller.
    unsafe {
        let c = tile.c.add(row * tile.c_stride + first);
        if !tile.residual.is_null() {
            let residual = tile.residual.add(row * tile.residual_stride + first);
            let residual = if count >= L::LANES {
                L::load(residual)
            } else {
                L::load_part(residual, count, 0.0)
            };
            x = x.add(residual);
        }
        if tile.relu {
            x = x.max(L::splat(0.0));
        }
        if count >= L::LANES {
            x.store(c);
        } else {
            x.store_part(c, count);
        }
    }
}

/// Computes a tile of up to `TILE_ROWS` (or `NARROW_TILE_ROWS`) rows.
///
/// # Safety
/// As for [`micro`]; `rows` is at most the level's number for this width.
#[inline(always)]
pub(super) unsafe fn run_tile<L: Lanes>(rows: usize, narrow: bool, tile: &Tile) {
    macro_rules! choose {
        ($vectors:literal: $($count:literal)*) => {
            match rows {
                // SAFETY: passed on to the caller.
                $($count => unsafe { micro::<L, $count, $vectors>(tile) },)*
                _ => unreachable!("a tile of {rows} rows"),
            }
        };
    }
    if narrow {
        if L::NARROW_TILE_ROWS > 8 {
            choose!(1: 1 2 3 4 5 6 7 8 9 10 11 12)
        } else {
            choose!(1: 1 2 3 4 5 6 7 8)
        }
    } else if L::TILE_ROWS > 6 {
        choose!(2: 1 2 3 4 5 6 7 8 9 10 11 12)
    } else if L::TILE_ROWS > 4 {
        choose!(2: 1 2 3 4 5 6)
    } else {
        choose!(2: 1 2 3 4)
    }
}

/// Runs `rows` rows of one panel, tile after tile; `tile` describes the first row.
///
/// A function of its own in wasm: V8 gives registers function by function, and inside a convolution it would spill the sums,
/// at half the speed. Smaller pieces (a tile, a call each) are slower again.
///
/// # Safety
/// As for [`micro`], for all rows.
#[cfg_attr(target_arch = "wasm32", inline(never))]
#[cfg_attr(not(target_arch = "wasm32"), inline(always))]
#[cfg_attr(
    all(target_arch = "wasm32", feature = "relaxed-simd"),
    target_feature(enable = "relaxed-simd")
)]
pub(super) unsafe fn run_panel<L: Lanes>(rows: usize, narrow: bool, tile: &Tile) {
    let most = if narrow {
        L::NARROW_TILE_ROWS
    } else {
        L::TILE_ROWS
    };
    let mut first = 0;
    while first < rows {
        // A rest of one or two rows would waste a tile: share it with the last full one.
        let rest = rows - first;
        let count = if rest > most && rest < 2 * most {
            rest.div_ceil(2)
        } else {
            rest.min(most)
        };
        let mut tile = *tile;
        // SAFETY: the caller vouches for all rows.
        unsafe {
            tile.a = tile.a.add(first * tile.a_stride);
            tile.c = tile.c.add(first * tile.c_stride);
            if !tile.residual.is_null() {
                tile.residual = tile.residual.add(first * tile.residual_stride);
            }
            run_tile::<L>(count, narrow, &tile);
        }
        first += count;
    }
}

/// Rows of numbers with a distance: a matrix or a window of one.
#[derive(Debug, Clone, Copy)]
pub(in crate::nn::cpu) struct Rows<'a> {
    /// The numbers from the first row on.
    pub(in crate::nn::cpu) data: &'a [f32],
    /// Number of rows.
    pub(in crate::nn::cpu) rows: usize,
    /// Numbers per row.
    pub(in crate::nn::cpu) channels: usize,
    /// Numbers from the start of a row to the start of the next.
    pub(in crate::nn::cpu) stride: usize,
}

impl<'a> Rows<'a> {
    /// One row.
    #[inline(always)]
    pub(in crate::nn::cpu) fn row(&self, row: usize) -> &'a [f32] {
        &self.data[row * self.stride..][..self.channels]
    }

    /// Some of the rows.
    pub(in crate::nn::cpu) fn part(self, rows: std::ops::Range<usize>) -> Self {
        Self {
            data: self.data.get(rows.start * self.stride..).unwrap_or(&[]),
            rows: rows.len(),
            ..self
        }
    }

    /// Some of the channels of all rows.
    pub(in crate::nn::cpu) fn window(self, first: usize, channels: usize) -> Self {
        Self {
            data: self.data.get(first..).unwrap_or(&[]),
            channels,
            ..self
        }
    }

    /// Asserts that all rows lie within the data.
    pub(in crate::nn::cpu) fn check(&self) {
        let needed = if self.rows == 0 {
            0
        } else {
            (self.rows - 1) * self.stride + self.channels
        };
        assert!(
            needed <= self.data.len(),
            "{} rows need {needed} numbers of {}",
            self.rows,
            self.data.len()
        );
    }
}

/// Writes `relu?(x * matrix + bias + residual)` to columns of `out`.
pub(in crate::nn::cpu) struct Product<'a> {
    /// Left-hand matrix.
    pub(in crate::nn::cpu) x: Rows<'a>,
    /// Right-hand matrix.
    pub(in crate::nn::cpu) matrix: &'a Packed,
    /// Added to the result.
    pub(in crate::nn::cpu) residual: Option<Rows<'a>>,
    /// Whether negative results become zero.
    pub(in crate::nn::cpu) relu: bool,
    /// Result, from its first column on.
    pub(in crate::nn::cpu) out: &'a mut [f32],
    /// Numbers from one row of the result to the next.
    pub(in crate::nn::cpu) out_stride: usize,
}

/// Computes a matrix product.
pub(in crate::nn::cpu) fn product(product: Product<'_>) {
    gemm(product.matrix.level, product);
}

entry! { fn gemm(product: Product<'_>) => gemm_lanes }

#[inline(always)]
fn gemm_lanes<L: Lanes>(product: Product<'_>) {
    let Product {
        x,
        matrix,
        residual,
        relu,
        out,
        out_stride,
    } = product;
    if x.rows == 0 {
        return;
    }
    x.check();
    assert_eq!(x.channels, matrix.depth, "depth of a matrix product");
    assert!(
        (x.rows - 1) * out_stride + matrix.columns <= out.len(),
        "room for a matrix product"
    );
    if let Some(residual) = residual {
        residual.check();
        assert!(
            residual.rows >= x.rows && residual.channels >= matrix.columns,
            "size of a residual"
        );
    }
    let block_rows = block_rows(matrix.depth);
    let mut block = 0;
    while block < x.rows {
        let rows = (x.rows - block).min(block_rows);
        let mut first = 0;
        while first < matrix.columns {
            let width = panel_width(L::LANES, matrix.columns - first);
            let a = x.data[block * x.stride..].as_ptr();
            let tile = Tile {
                a,
                depth: matrix.depth,
                a_stride: x.stride,
                b: matrix.panels[first * matrix.depth..].as_ptr(),
                bias: matrix.bias[first..].as_ptr(),
                c: out[block * out_stride + first..].as_mut_ptr(),
                c_stride: out_stride,
                columns: width.min(matrix.columns - first),
                residual: residual.map_or(std::ptr::null(), |r| {
                    r.data[block * r.stride + first..].as_ptr()
                }),
                residual_stride: residual.map_or(0, |r| r.stride),
                relu,
            };
            // SAFETY: the sizes of all parts were checked above; panels and bias are padded to whole vectors by `Packed`.
            unsafe { run_panel::<L>(rows, width == L::LANES, &tile) };
            first += width;
        }
        block += rows;
    }
}
