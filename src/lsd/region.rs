//! Growing regions of aligned level lines, and shrinking those that are not dense.
//!
//! Source: `[lsd2012]`, sections on region growing and on the aligned points density.

use super::field::{AVAILABLE, Field, Packed};
use super::params::{Tolerance, angle_distance};
use super::rectangle::Rectangle;

/// Pixels of one region in the order in which they joined; the first is the seed.
#[derive(Debug, Default)]
pub(super) struct Region {
    pub(super) pixels: Vec<Packed>,
    /// Sum of the level lines as the region grew; its angle is the region's.
    sum: [f64; 2],
}

impl Region {
    /// Angle of the region when growing ended.
    pub(super) fn angle(&self) -> f64 {
        libm::atan2(self.sum[1], self.sum[0])
    }

    /// Grows from an available pixel. The pixels taken are no longer available.
    pub(super) fn grow(&mut self, field: &mut Field, seed: Packed, tolerance: &Tolerance) {
        let start = field.index(seed);
        field.state[start] &= !AVAILABLE;
        self.pixels.clear();
        self.pixels.push(seed);
        let mut sum = field.direction[start];
        let mut square = sum[0] * sum[0] + sum[1] * sum[1];
        let (mut above, mut below) = (tolerance.above * square, tolerance.below * square);
        let mut next = 0;
        while let Some(&pixel) = self.pixels.get(next) {
            next += 1;
            let corner = field.index(pixel) - field.stride - 1;
            for column in 0..3 {
                let top = corner + column * field.stride;
                let Some(four) = field.state[top..].first_chunk::<4>() else {
                    break;
                };
                // Three neighbours of one column at once; the fourth byte is masked out.
                const THREE: u32 = u32::from_le_bytes([AVAILABLE, AVAILABLE, AVAILABLE, 0]);
                let mut flags = u32::from_le_bytes(*four) & THREE;
                while flags != 0 {
                    let row = (flags.trailing_zeros() / 8) as usize;
                    flags &= flags - 1;
                    let line = field.direction[top + row];
                    let dot = line[0] * sum[0] + line[1] * sum[1];
                    let signed_square = dot * dot.abs();
                    if signed_square > above
                        || (signed_square >= below && is_aligned(sum, line, tolerance.rad))
                    {
                        field.state[top + row] &= !AVAILABLE;
                        self.pixels
                            .push(Packed::new(pixel.x() + column - 1, pixel.y() + row - 1));
                        sum = [sum[0] + line[0], sum[1] + line[1]];
                        square = sum[0] * sum[0] + sum[1] * sum[1];
                        above = tolerance.above * square;
                        below = tolerance.below * square;
                    }
                }
            }
        }
        self.sum = sum;
    }

    /// Share of the rectangle's area that the pixels cover.
    fn density(&self, rectangle: &Rectangle) -> f64 {
        self.pixels.len() as f64 / (rectangle.length() * rectangle.width)
    }

    /// Makes the region dense enough: first by growing it again with a tolerance taken from the level lines near the
    /// seed, then by cutting its radius. Gives the rectangle, or nothing when too few pixels are left.
    pub(super) fn refined(
        &mut self,
        field: &mut Field,
        rectangle: Rectangle,
        min_density: f64,
        default_tolerance: &Tolerance,
    ) -> Option<Rectangle> {
        if self.density(&rectangle) >= min_density {
            return Some(rectangle);
        }
        let seed = self.pixels[0];
        let seed_line = field.direction[field.index(seed)];
        let (mut sum, mut square_sum, mut count) = (0.0, 0.0, 0.0);
        for &pixel in &self.pixels {
            let index = field.index(pixel);
            field.state[index] |= AVAILABLE;
            if distance(seed, pixel.x() as f64, pixel.y() as f64) < rectangle.width {
                let line = field.direction[index];
                let angle = libm::atan2(
                    seed_line[0] * line[1] - seed_line[1] * line[0],
                    seed_line[0] * line[0] + seed_line[1] * line[1],
                );
                sum += angle;
                square_sum += angle * angle;
                count += 1.0;
            }
        }
        let mean = sum / count;
        let variance = (square_sum - 2.0 * mean * sum) / count + mean * mean;
        if variance < 0.0 {
            // Rounding; the published program then finds nothing aligned and keeps only the seed used.
            let index = field.index(seed);
            field.state[index] &= !AVAILABLE;
            return None;
        }
        let tolerance = Tolerance::new(2.0 * variance.sqrt());
        self.grow(field, seed, &tolerance);
        if self.pixels.len() < 2 {
            return None;
        }
        let rectangle = Rectangle::of_region(self, field, default_tolerance)?;
        if self.density(&rectangle) >= min_density {
            return Some(rectangle);
        }
        self.cut_radius(field, rectangle, min_density, default_tolerance)
    }

    fn cut_radius(
        &mut self,
        field: &mut Field,
        mut rectangle: Rectangle,
        min_density: f64,
        default_tolerance: &Tolerance,
    ) -> Option<Rectangle> {
        let seed = self.pixels[0];
        let mut radius = distance(seed, rectangle.start[0], rectangle.start[1]).max(distance(
            seed,
            rectangle.end[0],
            rectangle.end[1],
        ));
        while self.density(&rectangle) < min_density {
            radius *= 0.75;
            let mut i = 0;
            while let Some(&pixel) = self.pixels.get(i) {
                if distance(seed, pixel.x() as f64, pixel.y() as f64) > radius {
                    let index = field.index(pixel);
                    field.state[index] |= AVAILABLE;
                    self.pixels.swap_remove(i);
                } else {
                    i += 1;
                }
            }
            if self.pixels.len() < 2 {
                return None;
            }
            rectangle = Rectangle::of_region(self, field, default_tolerance)?;
        }
        Some(rectangle)
    }
}

fn distance(from: Packed, x: f64, y: f64) -> f64 {
    let (dx, dy) = (x - from.x() as f64, y - from.y() as f64);
    (dx * dx + dy * dy).sqrt()
}

/// The comparison of angles itself, for the narrow band where the product of vectors does not decide.
#[cold]
fn is_aligned(sum: [f64; 2], line: [f64; 2], tolerance: f64) -> bool {
    let region = libm::atan2(sum[1], sum[0]);
    angle_distance(region, libm::atan2(line[1], line[0])) <= tolerance
}
