//! Colours: linear reflectance of red, green and blue.

use super::noise::mix;

/// Linear RGB.
pub(super) type Rgb = [f64; 3];

/// Linear colour from a hexadecimal sRGB code.
pub(super) fn srgb(code: u32) -> Rgb {
    [16, 8, 0].map(|shift| {
        let c = f64::from((code >> shift) & 255) / 255.0;
        if c <= 0.04045 {
            c / 12.92
        } else {
            ((c + 0.055) / 1.055).powf(2.4)
        }
    })
}

pub(super) fn blend(a: Rgb, b: Rgb, t: f64) -> Rgb {
    core::array::from_fn(|i| mix(a[i], b[i], t))
}

pub(super) fn shade(a: Rgb, factor: f64) -> Rgb {
    a.map(|c| (c * factor).max(0.0))
}
