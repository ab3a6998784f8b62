//! Resizing with the pixel map that belongs to it.

use super::{GrayImage, GrayView, ImageError, MAX_PIXELS, MAX_SIDE};
use crate::geometry::{PixelMap, WorkingFromSensor};

/// Source columns whose vertical sums are kept at a time, so that no scratch buffer is needed.
const CHUNK: usize = 512;

/// Shrinks a grey image so that its longest side is at most `max_side`, keeping the aspect ratio (the other side is
/// rounded to nearest, at least 1). An image that is small enough is copied, never enlarged.
///
/// The returned map takes sensor pixels to working pixels; its two factors differ slightly when a side was rounded.
///
/// # Errors
/// `ZeroMaxSide`, or what [`GrayView::check`] finds wrong with the image; `working` is left alone then.
pub fn working_from_gray(
    gray: &GrayView<'_>,
    max_side: usize,
    working: &mut GrayImage,
) -> Result<WorkingFromSensor, ImageError> {
    gray.check()?;
    if max_side == 0 {
        return Err(ImageError::ZeroMaxSide);
    }
    let (width, height) = working_size(gray.width, gray.height, max_side);
    if (width, height) == (gray.width, gray.height) {
        copy(gray, working);
        return Ok(PixelMap::from_scale(1.0, 1.0));
    }
    resize_area(gray, width, height, working)
}

/// Width and height of the working image of a picture, see [`working_from_gray`].
pub fn working_size(width: usize, height: usize, max_side: usize) -> (usize, usize) {
    let longest = width.max(height);
    if longest <= max_side {
        return (width, height);
    }
    // Rounded division in integers: the same on every platform.
    let shrink = |side: usize| ((2 * side * max_side + longest) / (2 * longest)).max(1);
    (shrink(width), shrink(height))
}

/// Resizes by area averaging: every output pixel is the mean of the input area that it covers. The right choice to
/// shrink; sides that grow are repeated like nearest neighbour with blended borders.
///
/// # Errors
/// What is wrong with the image or with the wanted size; `out` is left alone then.
pub fn resize_area<To, From>(
    gray: &GrayView<'_>,
    width: usize,
    height: usize,
    out: &mut GrayImage,
) -> Result<PixelMap<To, From>, ImageError> {
    let map = checked_map(gray, width, height)?;
    if (width, height) == (gray.width, gray.height) {
        copy(gray, out);
        return Ok(map);
    }
    out.set_size(width, height);
    let (step_x, step_y) = (
        gray.width as f64 / width as f64,
        gray.height as f64 / height as f64,
    );
    let norm = (1.0 / (step_x * step_y)) as f32;
    for (y, row_out) in out.data.chunks_exact_mut(width).enumerate() {
        let (top, bottom) = (y as f64 * step_y, (y + 1) as f64 * step_y);
        let mut pen = AreaPen::new(row_out, step_x, norm);
        for begin in (0..gray.width).step_by(CHUNK) {
            let columns = begin..(begin + CHUNK).min(gray.width);
            let mut sums = [0.0f32; CHUNK];
            let sums = &mut sums[..columns.len()];
            for row in whole(top)..ceil(bottom).min(gray.height) {
                let weight = overlap(top, bottom, row) as f32;
                for (sum, &value) in sums.iter_mut().zip(&gray.row(row)[columns.clone()]) {
                    *sum += weight * f32::from(value);
                }
            }
            for (x, &sum) in columns.zip(sums.iter()) {
                pen.add(x, sum);
            }
        }
        pen.finish();
    }
    Ok(map)
}

/// Spreads columns of width 1 over output pixels of width `step`, from left to right.
struct AreaPen<'a> {
    out: core::slice::IterMut<'a, u8>,
    emitted: usize,
    step: f64,
    border: f64,
    norm: f32,
    sum: f32,
}

impl<'a> AreaPen<'a> {
    fn new(row: &'a mut [u8], step: f64, norm: f32) -> Self {
        Self {
            out: row.iter_mut(),
            emitted: 0,
            step,
            border: step,
            norm,
            sum: 0.0,
        }
    }

    fn add(&mut self, x: usize, value: f32) {
        let (mut from, to) = (x as f64, (x + 1) as f64);
        while self.border <= to {
            self.sum += value * (self.border - from) as f32;
            from = self.border;
            self.emit();
        }
        self.sum += value * (to - from) as f32;
    }

    fn emit(&mut self) {
        if let Some(out) = self.out.next() {
            *out = (self.sum * self.norm + 0.5) as u8;
        }
        self.emitted += 1;
        self.border = (self.emitted + 1) as f64 * self.step;
        self.sum = 0.0;
    }

    /// The last border may lie a rounding error beyond the last column.
    fn finish(mut self) {
        if self.out.len() > 0 {
            self.emit();
        }
    }
}

/// Resizes by bilinear interpolation with half-pixel centres (`align_corners = false` of PyTorch, OpenCV's
/// `INTER_LINEAR`); borders repeat. No smoothing: when shrinking, [`resize_area`] keeps more of the picture.
///
/// # Errors
/// What is wrong with the image or with the wanted size; `out` is left alone then.
pub fn resize_bilinear<To, From>(
    gray: &GrayView<'_>,
    width: usize,
    height: usize,
    out: &mut GrayImage,
) -> Result<PixelMap<To, From>, ImageError> {
    let map = checked_map(gray, width, height)?;
    out.set_size(width, height);
    let (step_x, step_y) = (
        gray.width as f64 / width as f64,
        gray.height as f64 / height as f64,
    );
    for (y, row_out) in out.data.chunks_exact_mut(width).enumerate() {
        let (y0, y1, wy) = bilinear_taps(y, step_y, gray.height);
        let (upper, lower) = (gray.row(y0), gray.row(y1));
        for (x, value) in row_out.iter_mut().enumerate() {
            let (x0, x1, wx) = bilinear_taps(x, step_x, gray.width);
            let mix = |row: &[u8]| {
                let (a, b) = (f32::from(row[x0]), f32::from(row[x1]));
                a + wx * (b - a)
            };
            let (a, b) = (mix(upper), mix(lower));
            *value = (a + wy * (b - a) + 0.5) as u8;
        }
    }
    Ok(map)
}

/// The two neighbours of output sample `index` and the weight of the second.
fn bilinear_taps(index: usize, step: f64, len: usize) -> (usize, usize, f32) {
    let position = ((index as f64 + 0.5) * step - 0.5).clamp(0.0, (len - 1) as f64);
    let first = whole(position);
    let second = (first + 1).min(len - 1);
    (first, second, (position - first as f64) as f32)
}

fn checked_map<To, From>(
    gray: &GrayView<'_>,
    width: usize,
    height: usize,
) -> Result<PixelMap<To, From>, ImageError> {
    gray.check()?;
    if width == 0 || height == 0 {
        return Err(ImageError::Empty { width, height });
    }
    if width > MAX_SIDE || height > MAX_SIDE || width * height > MAX_PIXELS {
        return Err(ImageError::TooLarge { width, height });
    }
    Ok(PixelMap::from_scale(
        width as f64 / gray.width as f64,
        height as f64 / gray.height as f64,
    ))
}

fn copy(gray: &GrayView<'_>, out: &mut GrayImage) {
    out.set_size(gray.width, gray.height);
    for (y, row) in out.data.chunks_exact_mut(gray.width).enumerate() {
        row.copy_from_slice(gray.row(y));
    }
}

/// Length of the part of row (or column) `index` inside `from..to`.
fn overlap(from: f64, to: f64, index: usize) -> f64 {
    (to.min((index + 1) as f64) - from.max(index as f64)).max(0.0)
}

// Casts, because `f64::floor` is a call on targets without a rounding instruction; arguments are not negative.
fn whole(v: f64) -> usize {
    v as usize
}

fn ceil(v: f64) -> usize {
    let down = v as usize;
    if down as f64 == v { down } else { down + 1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pixel, Sensor, Working};

    fn ramp(width: usize, height: usize) -> Vec<u8> {
        (0..width * height)
            .map(|i| ((i % width) * 3 + (i / width) * 2) as u8)
            .collect()
    }

    #[test]
    fn area_by_two_is_the_rounded_mean() {
        let data = [10, 20, 30, 40, 50, 61, 70, 81];
        let mut out = GrayImage::default();
        let map: WorkingFromSensor =
            resize_area(&GrayView::tight(&data, 4, 2), 2, 1, &mut out).unwrap();
        assert_eq!(out.data, [35, 55]);
        assert_eq!(map.apply(Pixel::new(4.0, 2.0)), Pixel::new(2.0, 1.0));
    }

    #[test]
    fn area_equals_the_integral_over_each_output_pixel() {
        let (w, h) = (1301, 37);
        let data: Vec<u8> = (0..w * h).map(|i| (i * 7919 % 251) as u8).collect();
        let view = GrayView::tight(&data, w, h);
        for (nw, nh) in [(640, 18), (1, 1), (1300, 37), (433, 12), (7, 36)] {
            let mut out = GrayImage::default();
            let _: WorkingFromSensor = resize_area(&view, nw, nh, &mut out).unwrap();
            let (sx, sy) = (w as f64 / nw as f64, h as f64 / nh as f64);
            for (i, &got) in out.data.iter().enumerate() {
                let (x, y) = ((i % nw) as f64, (i / nw) as f64);
                let mut sum = 0.0;
                for row in 0..h {
                    let wy = overlap(y * sy, (y + 1.0) * sy, row);
                    if wy > 0.0 {
                        let line: f64 = (0..w)
                            .map(|c| {
                                overlap(x * sx, (x + 1.0) * sx, c) * f64::from(data[row * w + c])
                            })
                            .sum();
                        sum += wy * line;
                    }
                }
                let want = sum / (sx * sy);
                assert!(
                    (f64::from(got) - want).abs() < 0.502,
                    "{nw}x{nh} at {x},{y}: {got} {want}"
                );
            }
        }
    }

    #[test]
    fn bilinear_has_half_pixel_centres() {
        // Doubling [0, 100]: samples lie at -0.25 (clamped), 0.25, 0.75 and 1.25 (clamped).
        let mut out = GrayImage::default();
        let _: WorkingFromSensor =
            resize_bilinear(&GrayView::tight(&[0, 100], 2, 1), 4, 1, &mut out).unwrap();
        assert_eq!(out.data, [0, 25, 75, 100]);
        let data = ramp(40, 30);
        let _: WorkingFromSensor =
            resize_bilinear(&GrayView::tight(&data, 40, 30), 20, 15, &mut out).unwrap();
        // A linear ramp keeps its values: output (x, y) samples index coordinate (2x + 0.5, 2y + 0.5).
        for (i, &v) in out.data.iter().enumerate() {
            let want = (2.0 * (i % 20) as f64 + 0.5) * 3.0 + (2.0 * (i / 20) as f64 + 0.5) * 2.0;
            assert!((f64::from(v) - want).abs() <= 0.5, "{i}: {v} {want}");
        }
    }

    #[test]
    fn working_image_keeps_aspect_and_maps_corners() {
        let data = ramp(50, 30);
        let view = GrayView::tight(&data, 50, 30);
        let mut out = GrayImage::default();
        let map = working_from_gray(&view, 25, &mut out).unwrap();
        assert_eq!((out.width, out.height), (25, 15));
        assert_eq!(map.apply(Pixel::new(50.0, 30.0)), Pixel::new(25.0, 15.0));
        let map = working_from_gray(&view, 50, &mut out).unwrap();
        assert_eq!((out.width, out.height, &out.data), (50, 30, &data));
        assert_eq!(map.scale_x, 1.0);
        let map = working_from_gray(&view, 1, &mut out).unwrap();
        assert_eq!((out.width, out.height), (1, 1));
        assert!((map.scale_y - 1.0 / 30.0).abs() < 1e-15);
        assert_eq!(
            working_from_gray(&view, 0, &mut out).unwrap_err(),
            ImageError::ZeroMaxSide
        );
    }

    #[test]
    fn a_window_resizes_like_its_copy() {
        let data = ramp(60, 40);
        let window = GrayView {
            data: &data[60 * 5 + 7..],
            width: 31,
            height: 29,
            stride: 60,
        };
        let mut tight = GrayImage::default();
        copy(&window, &mut tight);
        let (mut a, mut b) = (GrayImage::default(), GrayImage::default());
        let _: PixelMap<Working, Sensor> = resize_area(&window, 13, 17, &mut a).unwrap();
        let _: PixelMap<Working, Sensor> = resize_area(&tight.view(), 13, 17, &mut b).unwrap();
        assert_eq!(a.data, b.data);
        let _: PixelMap<Working, Sensor> = resize_bilinear(&window, 13, 17, &mut a).unwrap();
        let _: PixelMap<Working, Sensor> = resize_bilinear(&tight.view(), 13, 17, &mut b).unwrap();
        assert_eq!(a.data, b.data);
    }

    #[test]
    fn refuses_sizes() {
        let data = ramp(4, 4);
        let view = GrayView::tight(&data, 4, 4);
        let mut out = GrayImage::default();
        let zero: Result<WorkingFromSensor, _> = resize_area(&view, 0, 4, &mut out);
        assert_eq!(
            zero.unwrap_err(),
            ImageError::Empty {
                width: 0,
                height: 4
            }
        );
        let huge: Result<WorkingFromSensor, _> = resize_bilinear(&view, MAX_SIDE + 1, 4, &mut out);
        assert!(matches!(huge.unwrap_err(), ImageError::TooLarge { .. }));
        assert!(out.data.is_empty());
    }
}
