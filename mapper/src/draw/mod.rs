//! Lines and marks on a colour picture, anti-aliased, for overlays that people look at.

mod legend;

pub use legend::{Entry, Legend, Mark};

use image::{Rgb, RgbImage};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::Vector3;

/// Agrees with the pose.
pub const GREEN: Rgb<u8> = Rgb([40, 220, 90]);
/// Does not agree.
pub const RED: Rgb<u8> = Rgb([235, 60, 50]);
/// Does not agree, where there are many of them.
pub const DIM_RED: Rgb<u8> = Rgb([165, 62, 55]);
/// The map's lines.
pub const CYAN: Rgb<u8> = Rgb([30, 200, 255]);
/// Truth.
pub const YELLOW: Rgb<u8> = Rgb([255, 210, 40]);
/// What was detected in the picture.
pub const WHITE: Rgb<u8> = Rgb([245, 245, 245]);
/// Edges and grounds.
pub const BLACK: Rgb<u8> = Rgb([10, 10, 12]);

/// Colours of the confidence ramp, from 0 to 1; all stand out against a darkened picture.
const RAMP: [[u8; 3]; 5] = [
    [226, 70, 160],
    [250, 130, 60],
    [250, 220, 70],
    [90, 220, 110],
    [60, 205, 255],
];

/// The colour of a confidence.
pub fn confidence_color(confidence: f32) -> Rgb<u8> {
    // `clamp` would keep NaN.
    let known = if confidence.is_nan() { 0.0 } else { confidence };
    let place = f64::from(known.clamp(0.0, 1.0)) * (RAMP.len() - 1) as f64;
    let below = (place as usize).min(RAMP.len() - 2);
    let share = place - below as f64;
    let mut color = [0; 3];
    for ((out, a), b) in color.iter_mut().zip(RAMP[below]).zip(RAMP[below + 1]) {
        *out = (f64::from(a) * (1.0 - share) + f64::from(b) * share).round() as u8;
    }
    Rgb(color)
}

/// Blends a colour into a pixel of index coordinates; outside the picture nothing happens.
fn blend(picture: &mut RgbImage, x: i64, y: i64, color: Rgb<u8>, share: f64) {
    let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) else {
        return;
    };
    if let Some(pixel) = picture.get_pixel_mut_checked(x, y) {
        for (old, new) in pixel.0.iter_mut().zip(color.0) {
            *old = (f64::from(*old) * (1.0 - share) + f64::from(new) * share).round() as u8;
        }
    }
}

/// A line of a width between two corner-based pixels. Lines that leave the picture are cut first.
fn line(picture: &mut RgbImage, from: Pixel, to: Pixel, width_px: f64, color: Rgb<u8>) {
    let Some((from, to)) = cut(picture, from, to, width_px) else {
        return;
    };
    let length = from.distance(to);
    let half = 0.5 * width_px;
    let reach = half + 1.0;
    let (dx, dy) = if length > 0.0 {
        ((to.x - from.x) / length, (to.y - from.y) / length)
    } else {
        (1.0, 0.0)
    };
    let x_range =
        (from.x.min(to.x) - reach).floor() as i64..=(from.x.max(to.x) + reach).ceil() as i64;
    let y_range =
        (from.y.min(to.y) - reach).floor() as i64..=(from.y.max(to.y) + reach).ceil() as i64;
    for y in y_range {
        // Only the part of the row that is near the line.
        let py = y as f64 + 0.5;
        let (low, high) = if dy.abs() > 1e-9 {
            let at = |offset: f64| from.x + (py - from.y) * dx / dy + offset / dy.abs();
            (at(-reach).floor() as i64, at(reach).ceil() as i64)
        } else {
            (*x_range.start(), *x_range.end())
        };
        for x in low.max(*x_range.start())..=high.min(*x_range.end()) {
            let (rx, ry) = (x as f64 + 0.5 - from.x, py - from.y);
            let along = (rx * dx + ry * dy).clamp(0.0, length);
            let distance = (rx - along * dx).hypot(ry - along * dy);
            let share = (half + 0.5 - distance).clamp(0.0, 1.0);
            if share > 0.0 {
                blend(picture, x, y, color, share);
            }
        }
    }
}

/// The part of a line that can touch the picture.
fn cut(picture: &RgbImage, from: Pixel, to: Pixel, width_px: f64) -> Option<(Pixel, Pixel)> {
    let margin = width_px + 2.0;
    let (w, h) = (f64::from(picture.width()), f64::from(picture.height()));
    let (dx, dy) = (to.x - from.x, to.y - from.y);
    let (mut low, mut high) = (0.0f64, 1.0f64);
    for (start, step, min, max) in [
        (from.x, dx, -margin, w + margin),
        (from.y, dy, -margin, h + margin),
    ] {
        if !(start.is_finite() && step.is_finite()) {
            return None;
        }
        if step == 0.0 {
            if start < min || start > max {
                return None;
            }
            continue;
        }
        let (a, b) = ((min - start) / step, (max - start) / step);
        low = low.max(a.min(b));
        high = high.min(a.max(b));
    }
    (low <= high).then(|| {
        let at = |s: f64| Pixel::new(from.x + s * dx, from.y + s * dy);
        (at(low), at(high))
    })
}

/// A ring around a corner-based pixel.
fn ring(picture: &mut RgbImage, center: Pixel, radius_px: f64, color: Rgb<u8>) {
    let reach = radius_px + 1.5;
    for y in (center.y - reach).floor() as i64..=(center.y + reach).ceil() as i64 {
        for x in (center.x - reach).floor() as i64..=(center.x + reach).ceil() as i64 {
            let distance = (x as f64 + 0.5 - center.x).hypot(y as f64 + 0.5 - center.y);
            let share = (1.1 - (distance - radius_px).abs()).clamp(0.0, 1.0);
            if share > 0.0 {
                blend(picture, x, y, color, share);
            }
        }
    }
}

/// The picture positions along a 3D segment as a camera sees it: cut at the near plane, in pieces, so that lens distortion
/// bends it. Empty behind the camera.
fn project_segment(
    camera: &Camera,
    cam_from_world: &CamFromWorld,
    ends_in_world: [&Vector3<f64>; 2],
) -> Vec<[Pixel; 2]> {
    const NEAR: f64 = 1e-2;
    const PIECES: usize = 8;
    let [mut a, mut b] = ends_in_world.map(|p| cam_from_world.transform_point(p));
    if a.z < NEAR && b.z < NEAR {
        return Vec::new();
    }
    if a.z < NEAR {
        a += (b - a) * ((NEAR - a.z) / (b.z - a.z));
    } else if b.z < NEAR {
        b += (a - b) * ((NEAR - b.z) / (a.z - b.z));
    }
    let at = |i: usize| camera.pixel_from_cam(&(a + (b - a) * (i as f64 / PIECES as f64)));
    (0..PIECES)
        .filter_map(|i| Some([at(i)?, at(i + 1)?]))
        .collect()
}

/// How a stroke looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Width on the canvas.
    pub width_px: f64,
    /// Colour.
    pub color: Rgb<u8>,
    /// Width of a dark edge on both sides, which keeps the stroke apart from any ground; 0 for none.
    pub edge_px: f64,
}

/// A picture to draw on. Small pictures are enlarged, so that strokes and text are fine against them; positions are those
/// of the picture, widths those of the canvas.
#[derive(Debug, Clone)]
pub struct Canvas {
    pixels: RgbImage,
    scale: u32,
}

/// Pictures whose longer side is shorter are enlarged.
const MIN_LONG_SIDE: u32 = 1200;

impl Canvas {
    /// Of a picture, darkened to a share of its brightness.
    pub fn new(picture: &RgbImage, brightness: f64) -> Self {
        let (w, h) = picture.dimensions();
        let scale = MIN_LONG_SIDE.div_ceil(w.max(h).max(1)).clamp(1, 4);
        let mut pixels = image::imageops::resize(
            picture,
            w * scale,
            h * scale,
            image::imageops::FilterType::CatmullRom,
        );
        for value in pixels.iter_mut() {
            *value = (f64::from(*value) * brightness).round() as u8;
        }
        Self { pixels, scale }
    }

    fn place(&self, p: Pixel) -> Pixel {
        let s = f64::from(self.scale);
        Pixel::new(p.x * s, p.y * s)
    }

    /// A stroke through places of the picture that follow each other.
    fn strokes(&mut self, pieces: &[[Pixel; 2]], stroke: Stroke) {
        let width = stroke.width_px + 2.0 * stroke.edge_px;
        for (width, color, is_wanted) in [
            (width, BLACK, stroke.edge_px > 0.0),
            (stroke.width_px, stroke.color, true),
        ] {
            if is_wanted {
                for [from, to] in pieces {
                    let (from, to) = (self.place(*from), self.place(*to));
                    line(&mut self.pixels, from, to, width, color);
                }
            }
        }
    }

    /// A line between two places.
    pub fn line(&mut self, from: Pixel, to: Pixel, stroke: Stroke) {
        self.strokes(&[[from, to]], stroke);
    }

    /// A 3D segment as a camera sees it.
    pub fn world_segment(
        &mut self,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        ends_in_world: [&Vector3<f64>; 2],
        stroke: Stroke,
    ) {
        self.strokes(
            &project_segment(camera, cam_from_world, ends_in_world),
            stroke,
        );
    }

    /// A disc with a thin dark edge around a place.
    pub fn disc(&mut self, center: Pixel, radius_px: f64, color: Rgb<u8>) {
        let center = self.place(center);
        line(
            &mut self.pixels,
            center,
            center,
            2.0 * radius_px + 1.5,
            BLACK,
        );
        line(&mut self.pixels, center, center, 2.0 * radius_px, color);
    }

    /// A ring around a place.
    pub fn ring(&mut self, center: Pixel, radius_px: f64, color: Rgb<u8>) {
        let center = self.place(center);
        ring(&mut self.pixels, center, radius_px, color);
    }

    /// A box in the lower left corner that says what is what.
    pub fn legend(&mut self, legend: &Legend) {
        legend.draw(&mut self.pixels);
    }

    /// The finished picture.
    pub fn into_picture(self) -> RgbImage {
        self.pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_its_pixels_and_nothing_else() {
        let mut picture = RgbImage::new(20, 10);
        line(
            &mut picture,
            Pixel::new(-100.0, 5.5),
            Pixel::new(100.0, 5.5),
            1.0,
            GREEN,
        );
        assert!((0..20).all(|x| *picture.get_pixel(x, 5) == GREEN));
        assert!((0..20).all(|x| picture.get_pixel(x, 3).0 == [0; 3]));
        let before = picture.clone();
        line(
            &mut picture,
            Pixel::new(30.0, 30.0),
            Pixel::new(90.0, 31.0),
            1.0,
            RED,
        );
        line(
            &mut picture,
            Pixel::new(f64::NAN, 0.0),
            Pixel::new(9.0, 3.0),
            1.0,
            RED,
        );
        assert_eq!(picture, before);
    }

    #[test]
    fn a_segment_that_starts_behind_the_camera_is_cut() {
        let camera = Camera::centered(64, 48, 50.0);
        let mut canvas = Canvas::new(&RgbImage::new(64, 48), 1.0);
        canvas.world_segment(
            &camera,
            &CamFromWorld::identity(),
            [&Vector3::new(0.0, 0.1, -1.0), &Vector3::new(0.0, 0.1, 5.0)],
            Stroke {
                width_px: 4.0,
                color: CYAN,
                edge_px: 0.0,
            },
        );
        let picture = canvas.into_picture();
        // Enlarged four times at most.
        assert_eq!(picture.dimensions(), (256, 192));
        // The far end projects to (32, 25); the near part leaves the picture below.
        assert_eq!(*picture.get_pixel(128, 160), CYAN);
        assert_eq!(picture.get_pixel(128, 40).0, [0; 3]);
    }

    #[test]
    fn confidence_runs_through_the_whole_ramp() {
        assert_eq!(confidence_color(0.0).0, RAMP[0]);
        assert_eq!(confidence_color(1.0).0, RAMP[4]);
        assert_eq!(confidence_color(0.5).0, RAMP[2]);
        assert_eq!(confidence_color(f32::NAN).0, confidence_color(0.0).0);
    }

    #[test]
    fn a_legend_stays_in_its_corner() {
        let mut canvas = Canvas::new(&RgbImage::from_pixel(1300, 400, Rgb([90, 90, 90])), 1.0);
        canvas.legend(&Legend {
            title: "located".to_owned(),
            text: vec!["12 of 30 points".to_owned()],
            entries: vec![
                Entry::new(Mark::Line(CYAN), "map"),
                Entry::new(Mark::Confidence, "confidence"),
            ],
        });
        let picture = canvas.into_picture();
        let changed = |x: u32, y: u32| picture.get_pixel(x, y).0 != [90; 3];
        assert!(changed(20, 390));
        assert!(!changed(1200, 390) && !changed(20, 20));
    }
}
