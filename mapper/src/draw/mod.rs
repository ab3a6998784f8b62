//! Lines and marks on a colour picture, anti-aliased, for overlays that people look at.

mod legend;

pub use legend::{Entry, Legend, Mark};

use image::{Rgb, RgbImage};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::Vector3;
use tiny_skia::{
    FillRule, LineCap, Paint, Path, PathBuilder, Pixmap, PremultipliedColorU8, Transform,
};

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

/// A pixel of the canvas.
fn opaque(color: Rgb<u8>) -> PremultipliedColorU8 {
    let [r, g, b] = color.0;
    tiny_skia::ColorU8::from_rgba(r, g, b, 255).premultiply()
}

/// What fills with a colour; `alpha` from 0 to 1.
fn paint(color: Rgb<u8>, alpha: f32) -> Paint<'static> {
    let [r, g, b] = color.0;
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, (255.0 * alpha).round() as u8);
    paint
}

/// Lines of a width between corner-based pixels, with round ends. What is not finite is not drawn.
fn lines(pixels: &mut Pixmap, pieces: &[[Pixel; 2]], width_px: f64, color: Rgb<u8>) {
    let mut path = PathBuilder::new();
    for [from, to] in pieces {
        path.move_to(from.x as f32, from.y as f32);
        path.line_to(to.x as f32, to.y as f32);
    }
    let stroke = tiny_skia::Stroke {
        width: width_px as f32,
        line_cap: LineCap::Round,
        ..tiny_skia::Stroke::default()
    };
    along(pixels, path.finish(), &stroke, color);
}

/// Draws along a path, where there is one.
fn along(pixels: &mut Pixmap, path: Option<Path>, stroke: &tiny_skia::Stroke, color: Rgb<u8>) {
    if let Some(path) = path {
        let paint = paint(color, 1.0);
        pixels.stroke_path(&path, &paint, stroke, Transform::identity(), None);
    }
}

/// The edge of a disc; `None` where it is not finite.
fn circle(center: Pixel, radius_px: f64) -> Option<Path> {
    PathBuilder::from_circle(center.x as f32, center.y as f32, radius_px as f32)
}

/// A disc around a corner-based pixel.
fn disc(pixels: &mut Pixmap, center: Pixel, radius_px: f64, color: Rgb<u8>) {
    if let Some(path) = circle(center, radius_px) {
        let rule = FillRule::Winding;
        pixels.fill_path(&path, &paint(color, 1.0), rule, Transform::identity(), None);
    }
}

/// A ring around a corner-based pixel.
fn ring(pixels: &mut Pixmap, center: Pixel, radius_px: f64, color: Rgb<u8>) {
    let stroke = tiny_skia::Stroke {
        width: 1.7,
        ..tiny_skia::Stroke::default()
    };
    along(pixels, circle(center, radius_px), &stroke, color);
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
    pixels: Pixmap,
    scale: u32,
}

/// Pictures whose longer side is shorter are enlarged.
const MIN_LONG_SIDE: u32 = 1200;

impl Canvas {
    /// Of a picture, darkened to a share of its brightness.
    pub fn new(picture: &RgbImage, brightness: f64) -> Self {
        let (w, h) = picture.dimensions();
        let scale = MIN_LONG_SIDE.div_ceil(w.max(h).max(1)).clamp(1, 4);
        // A picture of no pixels has a canvas of one, on which nothing is seen.
        let (w, h) = (w.max(1) * scale, h.max(1) * scale);
        let enlarged =
            image::imageops::resize(picture, w, h, image::imageops::FilterType::CatmullRom);
        let mut pixels = Pixmap::new(w, h).expect("sides of at least one pixel");
        for (to, from) in pixels.pixels_mut().iter_mut().zip(enlarged.pixels()) {
            let [r, g, b] = from.0.map(|v| (f64::from(v) * brightness).round() as u8);
            *to = opaque(Rgb([r, g, b]));
        }
        Self { pixels, scale }
    }

    fn place(&self, p: Pixel) -> Pixel {
        let s = f64::from(self.scale);
        Pixel::new(p.x * s, p.y * s)
    }

    /// A stroke through places of the picture that follow each other.
    fn strokes(&mut self, pieces: &[[Pixel; 2]], stroke: Stroke) {
        let pieces: Vec<[Pixel; 2]> = pieces
            .iter()
            .map(|ends| ends.map(|p| self.place(p)))
            .collect();
        let width = stroke.width_px + 2.0 * stroke.edge_px;
        for (width, color, is_wanted) in [
            (width, BLACK, stroke.edge_px > 0.0),
            (stroke.width_px, stroke.color, true),
        ] {
            if is_wanted {
                lines(&mut self.pixels, &pieces, width, color);
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
        disc(&mut self.pixels, center, radius_px + 0.75, BLACK);
        disc(&mut self.pixels, center, radius_px, color);
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
        let pixels = self.pixels.pixels().iter();
        let values = pixels.flat_map(|p| [p.red(), p.green(), p.blue()]);
        RgbImage::from_vec(self.pixels.width(), self.pixels.height(), values.collect())
            .expect("three values for each pixel")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_its_pixels_and_nothing_else() {
        let stroke = |color| Stroke {
            width_px: 3.0,
            color,
            edge_px: 0.0,
        };
        let (width, height) = (MIN_LONG_SIDE, 10);
        let mut canvas = Canvas::new(&RgbImage::new(width, height), 1.0);
        let from = Pixel::new(-1e4, 5.5);
        canvas.line(from, Pixel::new(1e4, 5.5), stroke(GREEN));
        let picture = canvas.clone().into_picture();
        assert!((0..width).all(|x| *picture.get_pixel(x, 5) == GREEN));
        assert!((0..width).all(|x| picture.get_pixel(x, 3).0 == [0; 3]));
        canvas.line(Pixel::new(30.0, 30.0), Pixel::new(90.0, 31.0), stroke(RED));
        canvas.line(Pixel::new(f64::NAN, 0.0), Pixel::new(9.0, 3.0), stroke(RED));
        canvas.line(Pixel::new(-1e30, 0.0), Pixel::new(-1e29, 9.0), stroke(RED));
        assert_eq!(canvas.into_picture(), picture);
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
