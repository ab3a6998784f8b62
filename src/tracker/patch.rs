//! Finds a patch of one picture in another: inverse compositional Lucas-Kanade (Baker and Matthews 2004), coarse to fine.
//!
//! Light that grows by a factor and an offset is taken out in closed form: the gradients of the template are made orthogonal to
//! its grey levels and to a constant once, so that an inner product with the picture sees neither (Bartoli 2008).
//! Positions are index coordinates of the lowest level of a pyramid.

use super::kernels::{AREA, Place, Rows, SIDE, Sums, Work, multiply};
use super::pyramid::{LEVELS, Pyramid};
use crate::image::GrayImage;
use crate::simd::Level as Vectors;

/// From the first sample of a patch to its centre.
const HALF: f32 = 0.5 * (SIDE as f32 - 1.0);
/// Side of what a template is made of: the patch and a pixel on either side for the gradients.
const RIM: usize = SIDE + 2;
/// Side of the part of the reference that is kept for the way back, with room for errors of [`WAY_BACK`] pixels.
const WINDOW: usize = SIDE + 2 * WAY_BACK + 1;
const WAY_BACK: usize = 4;
/// Steps at one level.
const MAX_STEPS: usize = 12;
/// A step below this ends a level; in its pixels. The lowest level is the one that counts.
const LAST_STEP: f32 = 0.01;
const LAST_STEP_ABOVE: f32 = 0.04;
/// A patch that moves further at a level has lost its way; in pixels of that level.
const MAX_MOVE: f32 = 8.0;
/// Contrast between template and picture may change by this factor.
const MAX_GAIN: f32 = 4.0;

/// 2x2 map, row by row.
pub(super) type Affine = [f32; 4];
/// Leaves offsets as they are.
pub(super) const IDENTITY: Affine = [1.0, 0.0, 0.0, 1.0];

/// A patch at one level: the kernel's rows and what its sums are divided by.
#[derive(Debug, Clone)]
struct Layer {
    /// Gradients, orthogonal to constants and to `gray`.
    across: Rows,
    down: Rows,
    /// Grey levels less their mean.
    gray: Rows,
    /// Inverse of the gradients' products: xx, xy, yy.
    inverse: [f32; 3],
    /// Sum of the squares of `gray`.
    square: f32,
    is_usable: bool,
}

impl Default for Layer {
    fn default() -> Self {
        Self {
            across: [0.0; AREA],
            down: [0.0; AREA],
            gray: [0.0; AREA],
            inverse: [0.0; 3],
            square: 0.0,
            is_usable: false,
        }
    }
}

/// A point of the reference as it should look in the picture.
#[derive(Debug, Clone)]
pub(super) struct Template {
    layers: [Layer; LEVELS],
    window: [u8; WINDOW * WINDOW],
    /// Offsets in the reference from offsets in the picture, as the template was made.
    affine: Affine,
}

impl Default for Template {
    fn default() -> Self {
        Self {
            layers: core::array::from_fn(|_| Layer::default()),
            window: [0; WINDOW * WINDOW],
            affine: IDENTITY,
        }
    }
}

/// A patch that was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) position: [f32; 2],
    /// Correlation of grey levels, -1..1.
    pub(super) correlation: f32,
}

/// Buffers of the way back.
#[derive(Debug, Default)]
pub(super) struct Back {
    layer: Layer,
}

impl Template {
    /// Makes the template of a point: the reference around `center`, as it looks after the inverse of `affine`. False where
    /// the lowest level does not lie in the reference or has too little structure.
    pub(super) fn make(&mut self, reference: &Pyramid, center: [f32; 2], affine: Affine) -> bool {
        self.affine = affine;
        let mut scale = 1.0;
        for (level, layer) in self.layers.iter_mut().enumerate() {
            let mut rim = [0.0; RIM * RIM];
            let at = center.map(|x| x * scale);
            let image = reference.level(level);
            layer.is_usable = sample::<RIM>(image, at, &affine, &mut rim) && layer.fill(&rim);
            scale *= 0.5;
        }
        let mut window = [0.0; WINDOW * WINDOW];
        let has_window = sample::<WINDOW>(reference.level(0), center, &affine, &mut window);
        if has_window {
            self.window = window.map(|v| (v + 0.5) as u8);
        }
        has_window && self.layers[0].is_usable
    }

    /// Largest difference between the map of the template and another one.
    pub(super) fn warped_by(&self, affine: &Affine) -> f32 {
        let pairs = self.affine.iter().zip(affine);
        pairs.fold(0.0, |most, (a, b)| most.max((a - b).abs()))
    }

    /// Finds the template in a picture from where it should be.
    pub(super) fn find(
        &self,
        picture: &Pyramid,
        start: [f32; 2],
        vectors: Vectors,
    ) -> Option<Found> {
        let mut position = start;
        for level in (1..LEVELS).rev() {
            let scale = 1.0 / (1 << level) as f32;
            let layer = &self.layers[level];
            if !layer.is_usable {
                continue;
            }
            let from = position.map(|x| x * scale);
            let image = picture.level(level);
            // A level that fails leaves the position to the next one.
            if let Some(found) = layer.align(image, from, LAST_STEP_ABOVE, vectors) {
                position = found.position.map(|x| x / scale);
            }
        }
        self.layers[0].align(picture.level(0), position, LAST_STEP, vectors)
    }

    /// How far from the template's centre the way back from the found place ends, in pixels; infinite where it ends nowhere.
    pub(super) fn way_back(
        &self,
        picture: &Pyramid,
        found: &Found,
        back: &mut Back,
        vectors: Vectors,
    ) -> f32 {
        let mut rim = [0.0; RIM * RIM];
        if !sample::<RIM>(picture.level(0), found.position, &IDENTITY, &mut rim)
            || !back.layer.fill(&rim)
        {
            return f32::INFINITY;
        }
        let center = 0.5 * (WINDOW as f32 - 1.0);
        let window = Gray {
            data: &self.window,
            width: WINDOW,
            height: WINDOW,
        };
        let from = [center; 2];
        let ended = back.layer.align_in(window, from, LAST_STEP, vectors);
        ended.map_or(f32::INFINITY, |ended| {
            let [x, y] = ended.position.map(|v| v - center);
            (x * x + y * y).sqrt()
        })
    }
}

/// A tight grey picture.
#[derive(Debug, Clone, Copy)]
struct Gray<'a> {
    data: &'a [u8],
    width: usize,
    height: usize,
}

impl Layer {
    /// Gradients by central differences, made orthogonal. False where there is too little structure.
    fn fill(&mut self, rim: &[f32; RIM * RIM]) -> bool {
        let n = AREA as f32;
        let (mut sum, mut sum_across, mut sum_down) = (0.0, 0.0, 0.0);
        for row in 0..SIDE {
            for column in 0..SIDE {
                let (at, in_rim) = (row * SIDE + column, (row + 1) * RIM + column + 1);
                let gray = rim[in_rim];
                let across = 0.5 * (rim[in_rim + 1] - rim[in_rim - 1]);
                let down = 0.5 * (rim[in_rim + RIM] - rim[in_rim - RIM]);
                (self.gray[at], self.across[at], self.down[at]) = (gray, across, down);
                sum += gray;
                sum_across += across;
                sum_down += down;
            }
        }
        let [mean, mean_across, mean_down] = [sum, sum_across, sum_down].map(|s| s / n);
        let (mut square, mut with_across, mut with_down) = (0.0, 0.0, 0.0);
        for at in 0..AREA {
            self.gray[at] -= mean;
            self.across[at] -= mean_across;
            self.down[at] -= mean_down;
            square += self.gray[at] * self.gray[at];
            with_across += self.gray[at] * self.across[at];
            with_down += self.gray[at] * self.down[at];
        }
        // A standard deviation of two grey levels is sensor noise.
        if !(square > 4.0 * n) {
            return false;
        }
        let (share_across, share_down) = (with_across / square, with_down / square);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for at in 0..AREA {
            self.across[at] -= share_across * self.gray[at];
            self.down[at] -= share_down * self.gray[at];
            xx += self.across[at] * self.across[at];
            xy += self.across[at] * self.down[at];
            yy += self.down[at] * self.down[at];
        }
        let determinant = xx * yy - xy * xy;
        let half = 0.5 * (xx - yy);
        let smaller = 0.5 * (xx + yy) - (half * half + xy * xy).sqrt();
        self.square = square;
        if !(smaller > MIN_CORNER * n && determinant > 0.0) {
            return false;
        }
        self.inverse = [yy / determinant, -xy / determinant, xx / determinant];
        true
    }

    fn align(
        &self,
        image: &GrayImage,
        start: [f32; 2],
        last_step: f32,
        vectors: Vectors,
    ) -> Option<Found> {
        let gray = Gray {
            data: &image.data,
            width: image.width,
            height: image.height,
        };
        self.align_in(gray, start, last_step, vectors)
    }

    /// Gauss-Newton steps at one level.
    fn align_in(
        &self,
        image: Gray<'_>,
        start: [f32; 2],
        last_step: f32,
        vectors: Vectors,
    ) -> Option<Found> {
        let n = AREA as f32;
        let [mut x, mut y] = start;
        let mut correlation = -1.0;
        for _ in 0..MAX_STEPS {
            let place = place(image, [x, y])?;
            let mut sums = Sums::default();
            let work = Work {
                place,
                a: &self.across,
                b: &self.down,
                c: &self.gray,
                sums: &mut sums,
            };
            multiply(vectors, work);
            let gain = sums.c / self.square;
            if !(gain > 1.0 / MAX_GAIN && gain < MAX_GAIN) {
                return None;
            }
            let variance = sums.square - sums.one * sums.one / n;
            correlation = sums.c / (self.square * variance.max(1.0)).sqrt();
            let [xx, xy, yy] = self.inverse;
            let step = [
                (xx * sums.a + xy * sums.b) / gain,
                (xy * sums.a + yy * sums.b) / gain,
            ];
            x -= step[0];
            y -= step[1];
            if !((x - start[0]).abs() < MAX_MOVE && (y - start[1]).abs() < MAX_MOVE) {
                return None;
            }
            if step[0] * step[0] + step[1] * step[1] < last_step * last_step {
                break;
            }
        }
        Some(Found {
            position: [x, y],
            correlation,
        })
    }
}

/// Smallest mean product of gradients in the direction of least structure, grey levels squared: with noise of two levels a
/// shift along it is known to a fifth of a pixel over the patch.
const MIN_CORNER: f32 = 0.4;

/// Where a patch around a position lies; `None` unless all of it and one pixel more are in the picture.
fn place(image: Gray<'_>, [x, y]: [f32; 2]) -> Option<Place<'_>> {
    let (left, top) = (x - HALF, y - HALF);
    if !(left >= 0.0 && top >= 0.0) {
        return None;
    }
    let (column, row) = (left as usize, top as usize);
    if column + SIDE >= image.width || row + SIDE >= image.height {
        return None;
    }
    Some(Place {
        data: image.data,
        stride: image.width,
        first: row * image.width + column,
        shift: [left - column as f32, top - row as f32],
    })
}

/// Bilinear samples on a square grid around a position, after a map of the offsets. False unless all of them lie inside.
fn sample<const N: usize>(
    image: &GrayImage,
    [x, y]: [f32; 2],
    affine: &Affine,
    out: &mut [f32],
) -> bool {
    let half = 0.5 * (N as f32 - 1.0);
    let [xx, xy, yx, yy] = *affine;
    let reach = [half * (xx.abs() + xy.abs()), half * (yx.abs() + yy.abs())];
    let inside = |v: f32, reach: f32, len: usize| v - reach >= 0.0 && v + reach < len as f32 - 1.0;
    if !(inside(x, reach[0], image.width) && inside(y, reach[1], image.height)) {
        return false;
    }
    for (row, line) in out.chunks_exact_mut(N).enumerate() {
        let v = row as f32 - half;
        for (column, value) in line.iter_mut().enumerate() {
            let u = column as f32 - half;
            // Rounding may leave the picture by less than a hair's breadth.
            let at_x = (x + xx * u + xy * v).max(0.0);
            let at_y = (y + yx * u + yy * v).max(0.0);
            let (left, top) = (
                (at_x as usize).min(image.width - 2),
                (at_y as usize).min(image.height - 2),
            );
            *value = interpolate(image, [left, top], [at_x, at_y]);
        }
    }
    true
}

/// Grey value between four pixels, of which `left_top` is the first; the last row and column are none.
#[inline]
pub(super) fn interpolate(image: &GrayImage, [left, top]: [usize; 2], [x, y]: [f32; 2]) -> f32 {
    let (right, down) = (x - left as f32, y - top as f32);
    let first = top * image.width + left;
    let [a, b] = [image.data[first], image.data[first + 1]].map(f32::from);
    let below = first + image.width;
    let [c, d] = [image.data[below], image.data[below + 1]].map(f32::from);
    let upper = a + right * (b - a);
    upper + down * (c + right * (d - c) - upper)
}
