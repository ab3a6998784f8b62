//! Lines and marks on a colour picture, anti-aliased, for overlays that people look at.

use image::{Rgb, RgbImage};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::Vector3;

/// Agrees with the pose.
pub const GREEN: Rgb<u8> = Rgb([40, 220, 90]);
/// Does not agree.
pub const RED: Rgb<u8> = Rgb([235, 60, 50]);
/// The map's lines.
pub const CYAN: Rgb<u8> = Rgb([30, 200, 255]);
/// Truth, or what was detected.
pub const YELLOW: Rgb<u8> = Rgb([255, 210, 40]);

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
pub fn line(picture: &mut RgbImage, from: Pixel, to: Pixel, width_px: f64, color: Rgb<u8>) {
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
pub fn ring(picture: &mut RgbImage, center: Pixel, radius_px: f64, color: Rgb<u8>) {
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

/// Draws a 3D segment as the camera sees it: cut at the near plane, in pieces, so that lens distortion bends it.
pub fn world_segment(
    picture: &mut RgbImage,
    camera: &Camera,
    cam_from_world: &CamFromWorld,
    ends_in_world: [&Vector3<f64>; 2],
    width_px: f64,
    color: Rgb<u8>,
) {
    const NEAR: f64 = 1e-2;
    const PIECES: usize = 8;
    let [mut a, mut b] = ends_in_world.map(|p| cam_from_world.transform_point(p));
    if a.z < NEAR && b.z < NEAR {
        return;
    }
    if a.z < NEAR {
        a += (b - a) * ((NEAR - a.z) / (b.z - a.z));
    } else if b.z < NEAR {
        b += (a - b) * ((NEAR - b.z) / (a.z - b.z));
    }
    let at = |i: usize| camera.pixel_from_cam(&(a + (b - a) * (i as f64 / PIECES as f64)));
    for i in 0..PIECES {
        if let (Some(p), Some(q)) = (at(i), at(i + 1)) {
            line(picture, p, q, width_px, color);
        }
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
        let mut picture = RgbImage::new(64, 48);
        let camera = Camera::centered(64, 48, 50.0);
        world_segment(
            &mut picture,
            &camera,
            &CamFromWorld::identity(),
            [&Vector3::new(0.0, 0.1, -1.0), &Vector3::new(0.0, 0.1, 5.0)],
            2.0,
            CYAN,
        );
        // The far end projects to (32, 25); the near part leaves the picture below.
        assert_eq!(*picture.get_pixel(32, 40), CYAN);
        assert_eq!(picture.get_pixel(32, 10).0, [0; 3]);
    }
}
