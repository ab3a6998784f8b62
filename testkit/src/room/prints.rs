//! The pictures on the walls: ten styles, drawn from a seed.

use super::color::{Rgb, blend, shade, srgb};
use super::noise::{Dice, cell, fbm, hash, smooth, value};

/// Number of styles.
pub(super) const STYLES: u8 = 10;

/// Reflectance at `s`, `t` metres (t upwards) of a print of `w` x `h` metres. A paper margin surrounds the picture.
pub(super) fn color(style: u8, s: f64, t: f64, w: f64, h: f64, seed: u64) -> Rgb {
    let margin = 0.06 * w.min(h);
    let (x, y) = (
        (s - margin) / (w - 2.0 * margin),
        (t - margin) / (h - 2.0 * margin),
    );
    if !(0.0..1.0).contains(&x) || !(0.0..1.0).contains(&y) {
        return srgb(0xF3EFE4);
    }
    let aspect = (h - 2.0 * margin) / (w - 2.0 * margin);
    let c = match style % STYLES {
        0 => shapes(x, y, aspect, seed),
        1 => mountains(x, y, seed),
        2 => rectangles(x, y, seed),
        3 => rings(x, y, aspect, seed),
        4 => map(x, y, aspect, seed),
        5 => arcs(x, y, aspect, seed),
        6 => lettering(x, y, seed),
        7 => skyline(x, y, seed),
        8 => stars(x, y, aspect, seed),
        _ => op_art(x, y, aspect),
    };
    shade(c, 0.94 + 0.1 * value(260.0 * s, 260.0 * t, seed))
}

/// A grid of quarter circles, triangles and stripes.
fn shapes(x: f64, y: f64, aspect: f64, seed: u64) -> Rgb {
    const INKS: [u32; 6] = [0xD9442F, 0x1F4E8C, 0xEFB735, 0x20242A, 0xF1E8D6, 0x5F9E8F];
    let columns = 4.0;
    let rows = (columns * aspect).round().max(1.0);
    let (i, j) = ((x * columns).floor(), (y * rows).floor());
    let (mut u, mut v) = (x * columns - i, y * rows - j);
    let h = hash(i as i64, j as i64, seed);
    if h & 1 == 1 {
        u = 1.0 - u;
    }
    if h & 2 == 2 {
        v = 1.0 - v;
    }
    let ground = srgb(INKS[((h >> 8) % 6) as usize]);
    let ink = srgb(INKS[((h >> 16) % 6) as usize]);
    let second = srgb(INKS[((h >> 24) % 6) as usize]);
    let r = (u * u + v * v).sqrt();
    match (h >> 3) % 5 {
        0 if r < 0.45 => second,
        0 if r < 1.0 => ink,
        1 if u + v < 1.0 => ink,
        2 if (v * 4.0).rem_euclid(1.0) < 0.5 => ink,
        3 if ((u - 0.5).powi(2) + (v - 0.5).powi(2)).sqrt() < 0.36 => ink,
        4 if u < 0.5 && v < 0.5 || u > 0.5 && v > 0.5 => ink,
        _ => ground,
    }
}

fn mountains(x: f64, y: f64, seed: u64) -> Rgb {
    let mut c = blend(srgb(0xF6D7A7), srgb(0xE2725B), smooth(y));
    if ((x - 0.66).powi(2) + (y - 0.68).powi(2)).sqrt() < 0.13 {
        c = srgb(0xFFF3D6);
    }
    for layer in 0..5u64 {
        let base = 0.62 - 0.13 * layer as f64;
        let jag = fbm(x * (2.0 + layer as f64), 0.5, 5, seed ^ layer);
        let ridge = base + 0.34 * (jag - 0.5);
        if y < ridge {
            c = blend(srgb(0xB9657A), srgb(0x1E2A44), layer as f64 / 4.0);
            if layer == 1 && y > ridge - 0.035 {
                c = srgb(0xF5E9E2);
            }
        }
    }
    c
}

fn rectangles(x: f64, y: f64, seed: u64) -> Rgb {
    const FIELDS: [u32; 6] = [0xF4F1E8, 0xF4F1E8, 0xC8202F, 0x1B4F9C, 0xF2C230, 0xE9E4D8];
    let (mut x0, mut y0, mut x1, mut y1) = (0.0, 0.0, 1.0, 1.0);
    let mut id = seed;
    for depth in 0..5 {
        let mut dice = Dice::new(id);
        let cut = dice.range(0.3, 0.7);
        let across = if depth % 2 == 0 {
            x1 - x0 > 0.15
        } else {
            y1 - y0 <= 0.15
        };
        if across {
            let at = x0 + cut * (x1 - x0);
            if (x - at).abs() < 0.012 {
                return srgb(0x17181C);
            }
            if x < at {
                x1 = at
            } else {
                x0 = at
            }
            id = hash(i64::from(x < at), depth, id);
        } else {
            let at = y0 + cut * (y1 - y0);
            if (y - at).abs() < 0.010 {
                return srgb(0x17181C);
            }
            if y < at {
                y1 = at
            } else {
                y0 = at
            }
            id = hash(i64::from(y < at), depth + 9, id);
        }
    }
    srgb(FIELDS[(id % 6) as usize])
}

fn rings(x: f64, y: f64, aspect: f64, seed: u64) -> Rgb {
    let (dx, dy) = (x - 0.5, (y - 0.5) * aspect);
    let r = (dx * dx + dy * dy).sqrt();
    let ring = (r * 13.0).floor();
    let sector = (dy.atan2(dx) / core::f64::consts::TAU * 16.0 + 0.5 * ring).floor();
    let on = hash(ring as i64, (sector as i64).rem_euclid(16), seed) % 3;
    if r > 0.47 {
        return srgb(0xF0E6D2);
    }
    srgb([0x1C3144, 0xD00000, 0xFFBA08][on as usize])
}

fn map(x: f64, y: f64, aspect: f64, seed: u64) -> Rgb {
    let (u, v) = (x, y * aspect);
    let height = fbm(3.1 * u + 7.0, 3.1 * v, 6, seed);
    let grid = (u * 9.0).rem_euclid(1.0) < 0.025 || (v * 9.0).rem_euclid(1.0) < 0.025;
    let mut c = if height > 0.53 {
        blend(
            srgb(0xC9B67A),
            srgb(0x8A6B3E),
            ((height - 0.53) * 5.0).clamp(0.0, 1.0),
        )
    } else if height > 0.515 {
        srgb(0x3E3A33)
    } else {
        blend(
            srgb(0x4F86A0),
            srgb(0xA9CBD3),
            ((height - 0.3) * 4.5).clamp(0.0, 1.0),
        )
    };
    if ((height - 0.53) * 30.0).rem_euclid(1.0) < 0.10 && height > 0.53 {
        c = srgb(0x6B4F2E);
    }
    if grid {
        blend(c, srgb(0x1D2B33), 0.6)
    } else {
        c
    }
}

fn arcs(x: f64, y: f64, aspect: f64, seed: u64) -> Rgb {
    let (u, v) = (x * 7.0, y * 7.0 * aspect);
    let (i, j) = (u.floor(), v.floor());
    let (mut a, b) = (u - i, v - j);
    if hash(i as i64, j as i64, seed) & 1 == 1 {
        a = 1.0 - a;
    }
    let near = (a * a + b * b).sqrt();
    let far = ((1.0 - a).powi(2) + (1.0 - b).powi(2)).sqrt();
    let d = (near - 0.5).abs().min((far - 0.5).abs());
    if d < 0.07 {
        srgb(0xF2E9DC)
    } else if d < 0.16 {
        srgb(0xE07A5F)
    } else {
        srgb(0x2D3A4F)
    }
}

/// Rows of 5 x 7 dot letters.
fn lettering(x: f64, y: f64, seed: u64) -> Rgb {
    const LINES: [&str; 4] = ["LAND", "LINE", "3D", "POSE"];
    const SIZES: [f64; 4] = [0.24, 0.24, 0.20, 0.14];
    let paper = srgb([0xF5C33B, 0xE9E2D0, 0xD8543C][(seed % 3) as usize]);
    let ink = srgb(0x1E2026);
    let mut top = 0.95;
    for (line, size) in LINES.iter().zip(SIZES) {
        let v = (top - y) / size;
        top -= size + 0.035;
        if !(0.0..1.0).contains(&v) {
            continue;
        }
        let row = (v * 7.0) as usize;
        let u = (x - 0.06) / 0.88 * line.len() as f64;
        if !(0.0..line.len() as f64).contains(&u) {
            continue;
        }
        let letter = line.as_bytes()[u as usize];
        let column = ((u - u.floor()) * 6.0) as usize;
        if column < 5 && (glyph(letter)[row] >> (4 - column)) & 1 == 1 {
            return ink;
        }
    }
    paper
}

/// Rows of a 5 x 7 letter, the leftmost dot in bit 4.
fn glyph(letter: u8) -> [u8; 7] {
    match letter {
        b'A' => [14, 17, 17, 31, 17, 17, 17],
        b'D' => [30, 17, 17, 17, 17, 17, 30],
        b'E' => [31, 16, 16, 30, 16, 16, 31],
        b'I' => [14, 4, 4, 4, 4, 4, 14],
        b'L' => [16, 16, 16, 16, 16, 16, 31],
        b'N' => [17, 25, 21, 21, 19, 17, 17],
        b'O' => [14, 17, 17, 17, 17, 17, 14],
        b'P' => [30, 17, 17, 30, 16, 16, 16],
        b'S' => [15, 16, 16, 14, 1, 1, 30],
        _ => [14, 17, 1, 6, 1, 17, 14],
    }
}

fn skyline(x: f64, y: f64, seed: u64) -> Rgb {
    let mut c = blend(srgb(0x3B2F63), srgb(0x0D1230), smooth(y));
    if cell((x * 130.0) as i64, (y * 130.0) as i64, seed) > 0.985 && y > 0.4 {
        c = srgb(0xFDF6D8);
    }
    if ((x - 0.24).powi(2) + (y - 0.82).powi(2)).sqrt() < 0.075 {
        c = srgb(0xF4E9C4);
    }
    for layer in 0..3i64 {
        let width = 0.13 - 0.02 * layer as f64;
        let slot = ((x + 0.05 * layer as f64) / width).floor() as i64;
        let u = (x + 0.05 * layer as f64) / width - slot as f64;
        let tall = 0.68 - 0.17 * layer as f64 - 0.28 * cell(slot, layer, seed);
        if y < tall && u > 0.03 {
            c = srgb([0x2C2A55, 0x1E1F42, 0x14142C][layer as usize]);
            let (i, j) = ((u * 5.0).floor(), (y * 26.0).floor());
            let (a, b) = ((u * 5.0) - i, y * 26.0 - j);
            let lit = cell(i as i64 + 10 * slot, j as i64, seed ^ layer as u64) > 0.55;
            if a > 0.3 && a < 0.8 && b > 0.3 && b < 0.8 && lit && y < tall - 0.03 {
                c = srgb(0xF6C667);
            }
        }
    }
    c
}

fn stars(x: f64, y: f64, aspect: f64, seed: u64) -> Rgb {
    let (px, py) = (x, y * aspect);
    let mut c = blend(
        srgb(0x10243E),
        srgb(0x1D3B5C),
        fbm(4.0 * px, 4.0 * py, 3, seed),
    );
    let r = ((px - 0.5).powi(2) + (py - 0.5 * aspect).powi(2)).sqrt();
    if ((r * 8.0).rem_euclid(1.0) - 0.5).abs() < 0.02 {
        c = srgb(0x5C7D99);
    }
    let mut dice = Dice::new(seed);
    let mut last: Option<(f64, f64)> = None;
    for star in 0..26 {
        let (sx, sy) = (dice.range(0.06, 0.94), dice.range(0.06, 0.94) * aspect);
        let size = dice.range(0.006, 0.017);
        if let Some((lx, ly)) = last
            && star % 5 != 0
        {
            let (dx, dy) = (sx - lx, sy - ly);
            let k = (((px - lx) * dx + (py - ly) * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
            if ((px - lx - k * dx).powi(2) + (py - ly - k * dy).powi(2)).sqrt() < 0.003 {
                c = srgb(0xB7C9D8);
            }
        }
        last = Some((sx, sy));
        if ((px - sx).powi(2) + (py - sy).powi(2)).sqrt() < size {
            return srgb(0xFBF3D0);
        }
    }
    c
}

/// A checkerboard that bulges.
fn op_art(x: f64, y: f64, aspect: f64) -> Rgb {
    let (dx, dy) = (x - 0.5, (y - 0.5) * aspect);
    let r = (dx * dx + dy * dy).sqrt();
    let k = if r < 0.4 {
        0.45 + 0.55 * (r / 0.4).powi(2)
    } else {
        1.0
    };
    let on = ((dx * k * 12.0).floor() + (dy * k * 12.0).floor()).rem_euclid(2.0) > 0.5;
    if on { srgb(0xF4F0E6) } else { srgb(0x1B1B1E) }
}
