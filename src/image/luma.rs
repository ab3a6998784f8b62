//! Grey levels from colour.

use super::{FrameView, GrayImage, ImageError, PixelFormat};

// Rec. 601 luma weights times 2^16; they sum to 2^16, so that equal channels keep their value.
const RED: u32 = 19_595;
const GREEN: u32 = 38_470;
const BLUE: u32 = 7_471;
const HALF: u32 = 1 << 15;

fn luma(red: u8, green: u8, blue: u8) -> u8 {
    ((u32::from(red) * RED + u32::from(green) * GREEN + u32::from(blue) * BLUE + HALF) >> 16) as u8
}

/// Fills `gray` with the luma of a frame: the byte itself for `Luma8`, otherwise 0.299 R + 0.587 G + 0.114 B of the
/// encoded values, rounded to nearest. Alpha is ignored. Integer arithmetic: the same on every platform.
///
/// # Errors
/// What [`FrameView::check`] finds wrong with the frame; `gray` is left alone then.
pub fn gray_from_frame(frame: &FrameView<'_>, gray: &mut GrayImage) -> Result<(), ImageError> {
    frame.check()?;
    let (width, height) = (frame.width as usize, frame.height as usize);
    gray.set_size(width, height);
    let rows_in = frame.bytes.chunks(frame.stride);
    for (row_out, row_in) in gray.data.chunks_exact_mut(width).zip(rows_in) {
        match frame.format {
            PixelFormat::Luma8 => row_out.copy_from_slice(&row_in[..width]),
            PixelFormat::Rgb8 => {
                for (out, rgb) in row_out.iter_mut().zip(row_in.as_chunks::<3>().0) {
                    *out = luma(rgb[0], rgb[1], rgb[2]);
                }
            }
            PixelFormat::Rgba8 => {
                for (out, rgba) in row_out.iter_mut().zip(row_in.as_chunks::<4>().0) {
                    *out = luma(rgba[0], rgba[1], rgba[2]);
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(bytes: &[u8], width: u32, stride: usize, format: PixelFormat) -> Vec<u8> {
        let mut out = GrayImage::default();
        let frame = FrameView {
            bytes,
            width,
            height: 2,
            stride,
            format,
        };
        gray_from_frame(&frame, &mut out).unwrap();
        assert_eq!((out.width, out.height), (width as usize, 2));
        out.data
    }

    #[test]
    fn known_colours() {
        // Round(0.299 * 255) = 76, round(0.587 * 255) = 150, round(0.114 * 255) = 29.
        let rgba = [255, 0, 0, 9, 0, 255, 0, 0, 0, 0, 255, 255, 255, 255, 255, 1];
        assert_eq!(gray(&rgba, 2, 8, PixelFormat::Rgba8), [76, 150, 29, 255]);
        let rgb = [255, 0, 0, 0, 255, 0, 7, 7, 0, 0, 255, 255, 255, 255];
        assert_eq!(gray(&rgb, 2, 8, PixelFormat::Rgb8), [76, 150, 29, 255]);
        assert_eq!(
            gray(&[1, 2, 0, 3, 4], 2, 3, PixelFormat::Luma8),
            [1, 2, 3, 4]
        );
    }

    #[test]
    fn grey_stays_and_luma_is_within_half_a_level() {
        for v in 0..=255u8 {
            assert_eq!(luma(v, v, v), v);
        }
        for r in (0..=255u8).step_by(17) {
            for g in (0..=255u8).step_by(15) {
                for b in (0..=255u8).step_by(5) {
                    let exact = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
                    assert!(
                        (f64::from(luma(r, g, b)) - exact).abs() < 0.51,
                        "{r} {g} {b}"
                    );
                }
            }
        }
    }
}
