//! How the camera has turned between two frames, from pictures of a few hundred pixels: the small blurry images of Klein and
//! Murray (2008), aligned as wholes by inverse compositional steps.
//!
//! What it says is coarse, a tenth of a degree to a degree, and takes a step to the side for a turn; it is where a search begins
//! when nothing else is known of the movement.

use super::pyramid::{LEVELS, Pyramid};
use crate::geometry::{Camera, Pixel, rotation_from_vector};
use nalgebra::{Matrix3, Vector3};

/// Pixels of the finer small picture that one step of the coarser one is.
const COARSER: usize = 2;
/// Steps at one size.
const MAX_STEPS: usize = 12;
/// A step that turns by less than this ends a size, in pixels of it.
const LAST_STEP_PX: f64 = 0.02;
/// A border that is not compared, because it has no gradient, in pixels.
const MARGIN: usize = 1;
/// Pictures that share less than this part are not aligned.
const MIN_OVERLAP: f64 = 0.4;
/// Nor are those that correlate less once they are.
const MIN_CORRELATION: f64 = 0.7;

/// A small grey picture.
#[derive(Debug, Clone, Default)]
struct Small {
    gray: Vec<f32>,
    width: usize,
    height: usize,
}

/// A picture at two small sizes, finer first.
#[derive(Debug, Clone, Default)]
pub(super) struct Thumbnail {
    sizes: [Small; 2],
}

impl Thumbnail {
    /// Takes the coarsest level of a pyramid, halved once and twice: about 40x30 and 20x15 pixels of a picture of 640x480. No
    /// allocation once a picture of the size was seen.
    pub(super) fn take(&mut self, pyramid: &Pyramid) {
        let level = pyramid.level(LEVELS - 1).view();
        let at = |x: usize, y: usize| f32::from(level.row(y)[x]);
        let [fine, coarse] = &mut self.sizes;
        fine.halve(level.width, level.height, at);
        let (width, at) = (fine.width, |x: usize, y: usize| {
            fine.gray[y * fine.width + x]
        });
        coarse.halve(width, fine.height, at);
    }
}

impl Small {
    /// Means of two by two pixels.
    fn halve(&mut self, width: usize, height: usize, at: impl Fn(usize, usize) -> f32) {
        (self.width, self.height) = (width / COARSER, height / COARSER);
        self.gray.clear();
        for y in 0..self.height {
            for x in 0..self.width {
                let (u, v) = (COARSER * x, COARSER * y);
                let sum = at(u, v) + at(u + 1, v) + at(u, v + 1) + at(u + 1, v + 1);
                self.gray.push(0.25 * sum);
            }
        }
    }

    /// Grey level at a position; `None` outside.
    fn at(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let inside = |v: f64, len: usize| v >= 0.0 && v < len as f64 - 1.0;
        if !(inside(x, self.width) && inside(y, self.height)) {
            return None;
        }
        let (left, top) = (x as usize, y as usize);
        let (right, down) = (x - left as f64, y - top as f64);
        let pixel = |x: usize, y: usize| f64::from(self.gray[y * self.width + x]);
        let across = |y: usize| pixel(left, y) + right * (pixel(left + 1, y) - pixel(left, y));
        Some(across(top) + down * (across(top + 1) - across(top)))
    }
}

/// Pixels of the working picture from those of a small one.
#[derive(Debug, Clone, Copy)]
struct Scale {
    factor: f64,
    offset: f64,
}

impl Scale {
    /// Sample `i` of the coarsest level lies over sample `i` times its factor of the lowest one; the mean of two lies between
    /// them.
    fn of(size: usize) -> Self {
        let level = f64::from(1_u32 << (LEVELS - 1));
        let block = COARSER.pow(size as u32 + 1) as f64;
        Self {
            factor: level * block,
            offset: level * 0.5 * (block - 1.0),
        }
    }

    fn pixel(&self, x: f64, y: f64) -> Pixel {
        let [x, y] = [x, y].map(|v| self.factor * v + self.offset);
        Pixel::from_index_coordinates(x, y)
    }

    fn index(&self, pixel: Pixel) -> [f64; 2] {
        [pixel.x, pixel.y].map(|v| (v - 0.5 - self.offset) / self.factor)
    }
}

/// Sums of one pass over the shared part.
#[derive(Debug, Clone, Copy, Default)]
struct Pass {
    num: f64,
    /// Of the first picture and of the second one, and of their products.
    gray: [f64; 2],
    square: [f64; 2],
    product: f64,
    /// Of the gradients by the turn, alone and with each picture.
    slope: Vector3<f64>,
    with: [Vector3<f64>; 2],
    slopes: Matrix3<f64>,
}

/// The turn `cam_to_from_cam_from` from one picture to another one of the same camera; `None` where they do not resemble each
/// other. `camera` is that of the pyramids' lowest level.
pub(super) fn turn_between(
    from: &Thumbnail,
    to: &Thumbnail,
    camera: &Camera,
) -> Option<Matrix3<f64>> {
    let mut turn = Matrix3::identity();
    let mut correlation = 0.0;
    for size in (0..2).rev() {
        let (from, to) = (&from.sizes[size], &to.sizes[size]);
        if (from.width, from.height) != (to.width, to.height) || from.width.min(from.height) < 6 {
            continue;
        }
        let scale = Scale::of(size);
        for _ in 0..MAX_STEPS {
            let pass = compare(from, to, camera, &scale, &turn);
            if pass.num < MIN_OVERLAP * (from.width * from.height) as f64 {
                return None;
            }
            let (step, like) = solve(&pass)?;
            correlation = like;
            // The step turns the first picture's rays; its inverse joins the turn.
            turn *= rotation_from_vector(&-step);
            if step.norm() * camera.focal_px().0 < LAST_STEP_PX * scale.factor {
                break;
            }
        }
    }
    (correlation >= MIN_CORRELATION).then_some(turn)
}

fn compare(from: &Small, to: &Small, camera: &Camera, scale: &Scale, turn: &Matrix3<f64>) -> Pass {
    let mut pass = Pass::default();
    let (fx, fy) = camera.focal_px();
    for y in MARGIN..from.height - MARGIN {
        for x in MARGIN..from.width - MARGIN {
            let Some(ray) = camera.bearing_from_pixel(scale.pixel(x as f64, y as f64)) else {
                continue;
            };
            let there = camera.pixel_from_cam(&(turn * ray));
            let Some(second) = there.and_then(|pixel| to.at(scale.index(pixel))) else {
                continue;
            };
            let pixel = |x: usize, y: usize| f64::from(from.gray[y * from.width + x]);
            let first = pixel(x, y);
            let across = 0.5 * (pixel(x + 1, y) - pixel(x - 1, y)) * fx / scale.factor;
            let down = 0.5 * (pixel(x, y + 1) - pixel(x, y - 1)) * fy / scale.factor;
            // Gradient by a small turn of the ray (u, v, 1).
            let (u, v) = (ray.x / ray.z, ray.y / ray.z);
            let slope = Vector3::new(
                -across * u * v - down * (1.0 + v * v),
                across * (1.0 + u * u) + down * u * v,
                -across * v + down * u,
            );
            pass.num += 1.0;
            for (i, gray) in [first, second].into_iter().enumerate() {
                pass.gray[i] += gray;
                pass.square[i] += gray * gray;
                pass.with[i] += slope * gray;
            }
            pass.product += first * second;
            pass.slope += slope;
            pass.slopes += slope * slope.transpose();
        }
    }
    pass
}

/// The step, and how the pictures correlate before it. Light that grew by a factor and an offset is taken out.
fn solve(pass: &Pass) -> Option<(Vector3<f64>, f64)> {
    let n = pass.num;
    let [a, b] = pass.gray.map(|sum| sum / n);
    let variance = [pass.square[0] - n * a * a, pass.square[1] - n * b * b];
    // A standard deviation of two grey levels is a wall.
    if !(variance.iter().all(|v| *v > 4.0 * n)) {
        return None;
    }
    let covariance = pass.product - n * a * b;
    let correlation = covariance / (variance[0] * variance[1]).sqrt();
    let contrast = (variance[0] / variance[1]).sqrt();
    let with = |i: usize, mean: f64| pass.with[i] - pass.slope * mean;
    let off = with(1, b) * contrast - with(0, a);
    let slopes = pass.slopes - pass.slope * pass.slope.transpose() / n;
    // A little stiffness, so that what the pictures do not tell stays.
    let stiff = slopes + Matrix3::identity().scale(1e-3 * slopes.trace());
    let step = stiff.cholesky()?.solve(&off);
    step.iter()
        .all(|v| v.is_finite())
        .then_some((step, correlation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{CamFromWorld, vector_from_rotation};
    use crate::image::GrayView;
    use crate::simd::Level;
    use crate::tracker::tests::{HEIGHT, Scene, WIDTH};

    fn thumbnail(data: &[u8]) -> Thumbnail {
        let mut pyramid = Pyramid::default();
        pyramid.build(&GrayView::tight(data, WIDTH, HEIGHT), Level::Portable);
        let mut thumbnail = Thumbnail::default();
        thumbnail.take(&pyramid);
        thumbnail
    }

    #[test]
    fn turns_are_told_to_half_a_degree() {
        let scene = Scene::new();
        let at = |turn: Vector3<f64>, shift: f64| {
            let rotation = rotation_from_vector(&turn);
            let center = Vector3::new(shift, 0.0, 0.0);
            scene.render(&CamFromWorld::new(rotation, -(rotation * center)))
        };
        let first = thumbnail(&at(Vector3::zeros(), 0.0));
        for turn in [
            Vector3::new(0.0, 0.05, 0.0),
            Vector3::new(-0.04, -0.06, 0.02),
            Vector3::new(0.02, 0.01, 0.1),
            Vector3::new(0.1, 0.0, 0.0),
        ] {
            let second = thumbnail(&at(turn, 0.0));
            let found = turn_between(&first, &second, &scene.camera).expect("alike");
            let off = vector_from_rotation(&found) - turn;
            assert!(off.norm() < 0.009, "{off} at {turn}");
        }
        // A step of 4 cm before walls 2.5 and 4 m away looks like a turn of about a hundredth.
        let second = thumbnail(&at(Vector3::zeros(), 0.04));
        let found = turn_between(&first, &second, &scene.camera).expect("alike");
        assert!(vector_from_rotation(&found).norm() < 0.025);
    }

    #[test]
    fn pictures_that_are_not_alike_tell_nothing() {
        let scene = Scene::new();
        let first = thumbnail(&scene.render(&CamFromWorld::identity()));
        let wall = thumbnail(&vec![80; WIDTH * HEIGHT]);
        assert!(turn_between(&first, &wall, &scene.camera).is_none());
        assert!(turn_between(&wall, &first, &scene.camera).is_none());
        let none = Thumbnail::default();
        assert!(turn_between(&none, &none, &scene.camera).is_none());
    }
}
