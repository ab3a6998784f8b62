//! Finds a patch of one picture in another: inverse compositional Lucas-Kanade (Baker and Matthews 2004), coarse to fine.
//!
//! Light that grows by a factor and an offset is taken out in closed form: the gradients of the template are made orthogonal to
//! its grey levels and to a constant once, so that an inner product with the picture sees neither (Bartoli 2008).
//! Positions are index coordinates of the lowest level of a pyramid.

use super::kernels::{
    AREA, MAX_WARPED, Making, Moments, Place, RIM, Rounding, Rows, SIDE, Straight, Sums, Warped,
    Work, make_rows, multiply, round_to_bytes, sample_straight, sample_warped,
};
use super::pyramid::{BORDER, Bordered, LEVELS, Pyramid};
use crate::image::GrayView;
use crate::simd::Level as Vectors;

/// Side of the part of the reference that is kept for the way back, with room for errors of [`WAY_BACK`] pixels; the template is
/// made of its middle.
const WINDOW: usize = RIM + 2 * WAY_BACK;
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
    moments: Moments,
    /// Inverses of the gradients' products, xx, xy and yy: with light taken out, and as they are.
    free: [f32; 3],
    plain: [f32; 3],
    is_usable: bool,
}

impl Default for Layer {
    fn default() -> Self {
        Self {
            across: [0.0; AREA],
            down: [0.0; AREA],
            gray: [0.0; AREA],
            moments: Moments::default(),
            free: [0.0; 3],
            plain: [0.0; 3],
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
    pub(super) fn make(
        &mut self,
        reference: &Pyramid,
        center: [f32; 2],
        affine: Affine,
        vectors: Vectors,
    ) -> bool {
        self.affine = affine;
        let mut window = [0.0; WINDOW * WINDOW];
        let image = reference.level(0);
        if !sample::<WINDOW>(image, center, &affine, &mut window, vectors) {
            return false;
        }
        let rim = &window[WAY_BACK * WINDOW + WAY_BACK..];
        if !self.layers[0].fill(rim, WINDOW, vectors) {
            return false;
        }
        let rounding = Rounding {
            from: &window,
            to: &mut self.window,
        };
        round_to_bytes(vectors, rounding);
        for level in 1..LEVELS {
            let mut rim = [0.0; RIM * RIM];
            let scale = 1.0 / (1 << level) as f32;
            let (image, at) = (reference.level(level), center.map(|x| x * scale));
            self.layers[level].is_usable = sample::<RIM>(image, at, &affine, &mut rim, vectors)
                && self.layers[level].fill(&rim, RIM, vectors);
        }
        true
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
            let image = Ground::of(picture.level(level));
            // A level that fails leaves the position to the next one.
            if let Some(found) = layer.align(image, from, LAST_STEP_ABOVE, vectors) {
                position = found.position.map(|x| x / scale);
            }
        }
        let image = Ground::of(picture.level(0));
        self.layers[0].align(image, position, LAST_STEP, vectors)
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
        let (image, at) = (picture.level(0), found.position);
        if !sample::<RIM>(image, at, &IDENTITY, &mut rim, vectors)
            || !back.layer.fill(&rim, RIM, vectors)
        {
            return f32::INFINITY;
        }
        let center = 0.5 * (WINDOW as f32 - 1.0);
        let window = Ground {
            gray: GrayView::tight(&self.window, WINDOW, WINDOW),
            border: 0.0,
        };
        let ended = back.layer.align(window, [center; 2], LAST_STEP, vectors);
        ended.map_or(f32::INFINITY, |ended| {
            let [x, y] = ended.position.map(|v| v - center);
            (x * x + y * y).sqrt()
        })
    }
}

/// A picture and how far its pixels go on beyond its index coordinates.
#[derive(Debug, Clone, Copy)]
struct Ground<'a> {
    gray: GrayView<'a>,
    border: f32,
}

impl<'a> Ground<'a> {
    fn of(level: &'a Bordered) -> Self {
        Self {
            gray: level.whole(),
            border: BORDER as f32,
        }
    }

    /// Where a square of samples around a position lies; `None` unless all of it and one pixel more are there.
    fn place(&self, [x, y]: [f32; 2], side: usize) -> Option<Place<'a>> {
        let half = 0.5 * (side as f32 - 1.0) - self.border;
        let (left, top) = (x - half, y - half);
        if !(left >= 0.0 && top >= 0.0) {
            return None;
        }
        let (column, row) = (left as usize, top as usize);
        let GrayView {
            data,
            width,
            height,
            stride,
        } = self.gray;
        if column + side >= width || row + side >= height {
            return None;
        }
        Some(Place {
            data,
            stride,
            first: row * stride + column,
            shift: [left - column as f32, top - row as f32],
        })
    }
}

impl Layer {
    /// Takes samples of the patch and a rim of one pixel, in rows of `stride`. False where there is too little structure.
    fn fill(&mut self, rim: &[f32], stride: usize, vectors: Vectors) -> bool {
        let work = Making {
            rim,
            stride,
            across: &mut self.across,
            down: &mut self.down,
            gray: &mut self.gray,
            moments: &mut self.moments,
        };
        make_rows(vectors, work);
        let n = AREA as f32;
        // A standard deviation of two grey levels is sensor noise.
        if !(self.moments.square > 4.0 * n) {
            return false;
        }
        let [xx, xy, yy] = self.moments.free;
        let half = 0.5 * (xx - yy);
        let smaller = 0.5 * (xx + yy) - (half * half + xy * xy).sqrt();
        let inverses = inverse(self.moments.free).zip(inverse(self.moments.plain));
        match inverses {
            Some((free, plain)) if smaller > MIN_CORNER * n => {
                (self.free, self.plain) = (free, plain);
                true
            }
            _ => false,
        }
    }

    /// Gauss-Newton steps at one level.
    fn align(
        &self,
        image: Ground<'_>,
        start: [f32; 2],
        last_step: f32,
        vectors: Vectors,
    ) -> Option<Found> {
        let n = AREA as f32;
        let Moments {
            gray,
            square,
            mean,
            share,
            ..
        } = self.moments;
        let [mut x, mut y] = start;
        let (mut correlation, mut is_alike) = (-1.0, false);
        for _ in 0..MAX_STEPS {
            let place = image.place([x, y], SIDE)?;
            let mut sums = Sums::default();
            let work = Work {
                place,
                a: &self.across,
                b: &self.down,
                c: &self.gray,
                sums: &mut sums,
            };
            multiply(vectors, work);
            // Far off, contrast says nothing of the light.
            let contrast = sums.c / square;
            is_alike = contrast > 1.0 / MAX_GAIN && contrast < MAX_GAIN;
            let gain = if is_alike { contrast } else { 1.0 };
            let variance = sums.square - sums.one * sums.one / n;
            correlation = sums.c / (square * variance.max(1.0)).sqrt();
            // What of the difference is light, and what is left when it is taken out.
            let (brighter, stronger) = (sums.one - n * gray, sums.c - square);
            let of_light = brighter * brighter / n + stronger * stronger / square;
            let rest = variance - sums.c * contrast;
            let ([xx, xy, yy], a, b) = if of_light < MAX_SAME_LIGHT * rest {
                // Light as in the template: the gradients' parts of constants and grey levels tell of the shift too.
                let whole = |free: f32, i: usize| free + mean[i] * brighter + share[i] * stronger;
                (self.plain, whole(sums.a, 0), whole(sums.b, 1))
            } else {
                (self.free, sums.a / gain, sums.b / gain)
            };
            let step = [xx * a + xy * b, xy * a + yy * b];
            x -= step[0];
            y -= step[1];
            if !((x - start[0]).abs() < MAX_MOVE && (y - start[1]).abs() < MAX_MOVE) {
                return None;
            }
            let moved_sq = step[0] * step[0] + step[1] * step[1];
            if moved_sq < last_step * last_step {
                break;
            }
        }
        is_alike.then_some(Found {
            position: [x, y],
            correlation,
        })
    }
}

/// Of a symmetric 2x2 matrix, xx, xy and yy.
fn inverse([xx, xy, yy]: [f32; 3]) -> Option<[f32; 3]> {
    let determinant = xx * yy - xy * xy;
    (determinant > 0.0).then(|| [yy / determinant, -xy / determinant, xx / determinant])
}

/// Smallest mean product of gradients in the direction of least structure, grey levels squared: with noise of two levels a
/// shift along it is known to a fifth of a pixel over the patch.
const MIN_CORNER: f32 = 0.4;
/// Light has not changed where taking it out explains less than this of what differs besides: an offset then is below a tenth
/// of the noise of a pixel, which a slope of the grey levels would take for a shift of a hundredth.
const MAX_SAME_LIGHT: f32 = 0.25;

/// Bilinear samples on a square grid around a position, after a map of the offsets. False unless all of them lie inside.
fn sample<const N: usize>(
    image: &Bordered,
    [x, y]: [f32; 2],
    affine: &Affine,
    out: &mut [f32],
    vectors: Vectors,
) -> bool {
    const { assert!(N <= MAX_WARPED) };
    let ground = Ground::of(image);
    if *affine == IDENTITY {
        let Some(place) = ground.place([x, y], N) else {
            return false;
        };
        let work = Straight {
            place,
            side: N,
            out,
        };
        sample_straight(vectors, work);
        return true;
    }
    let half = 0.5 * (N as f32 - 1.0);
    let [xx, xy, yx, yy] = *affine;
    let reach = [half * (xx.abs() + xy.abs()), half * (yx.abs() + yy.abs())];
    let center = [x, y].map(|v| v + ground.border);
    let inside = |v: f32, reach: f32, len: usize| v - reach >= 0.0 && v + reach < len as f32 - 1.0;
    let GrayView {
        data,
        width,
        height,
        stride,
    } = ground.gray;
    if !(inside(center[0], reach[0], width) && inside(center[1], reach[1], height)) {
        return false;
    }
    let work = Warped {
        data,
        stride,
        center,
        map: *affine,
        side: N,
        out,
    };
    sample_warped(vectors, work);
    true
}

/// Grey value between four pixels, of which `left_top` is the first; the last row and column are none.
#[inline]
pub(super) fn interpolate(image: &GrayView<'_>, [left, top]: [usize; 2], [x, y]: [f32; 2]) -> f32 {
    let (right, down) = (x - left as f32, y - top as f32);
    let first = top * image.stride + left;
    let [a, b] = [image.data[first], image.data[first + 1]].map(f32::from);
    let below = first + image.stride;
    let [c, d] = [image.data[below], image.data[below + 1]].map(f32::from);
    let upper = a + right * (b - a);
    upper + down * (c + right * (d - c) - upper)
}
