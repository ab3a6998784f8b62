//! Wallpapers, tiles, carpets and cloths: two colours on a grid, in kinds that repeat evenly or not.

use super::color::{Rgb, blend, shade};
use super::noise::{cell, fbm, hash, value};

/// Number of kinds.
pub(super) const PATTERNS: u8 = 8;

/// Reflectance at `s`, `t` metres of a pattern whose grid has `side` metres.
pub(super) fn color(
    kind: u8,
    s: f64,
    t: f64,
    side: f64,
    [ground, ink]: [Rgb; 2],
    seed: u64,
) -> Rgb {
    let (i, j) = ((s / side).floor(), (t / side).floor());
    let (x, y) = (s / side - i - 0.5, t / side - j - 0.5);
    let (a, b) = (i as i64, j as i64);
    let joint = |width: f64| x.abs().max(y.abs()) > 0.5 - width;
    let share = match kind % PATTERNS {
        // Stripes of unlike widths.
        0 => f64::from(x.abs() < 0.12 + 0.3 * cell(a % 5, 1, seed)),
        // Dots.
        1 => f64::from(x.hypot(y) < 0.22),
        // Lozenges, here and there another.
        2 => match x.abs() + y.abs() {
            r if r < 0.2 => cell(a, b, seed).round(),
            r => f64::from(r > 0.4),
        },
        // Tiles, each of its own lightness.
        3 if joint(0.02) => 1.0,
        3 => 0.5 * cell(a, b, seed),
        // Checks.
        4 => f64::from((a + b) & 1 == 0),
        // Quarter circles that join into bands.
        5 => {
            let flip = if hash(a, b, seed) & 1 == 0 { x } else { -x };
            let near = (flip + 0.5).hypot(y + 0.5).min((flip - 0.5).hypot(y - 0.5));
            f64::from((near - 0.5).abs() < 0.13)
        }
        // Leaves: blots without any order.
        6 => f64::from(fbm(1.4 * s / side, 1.4 * t / side, 3, seed) > 0.56),
        // Planks across each other.
        _ => {
            let is_along = (a + b) & 1 == 0;
            let across = if is_along { y } else { x } + 0.5;
            let plank = (across * 4.0).floor() as i64;
            let gap = (across * 4.0).rem_euclid(1.0) < 0.06;
            if gap {
                1.0
            } else {
                0.6 * cell(4 * a + plank, b, seed)
            }
        }
    };
    let worn =
        0.86 + 0.16 * fbm(2.5 * s, 2.5 * t, 3, seed ^ 7) + 0.06 * value(220.0 * s, 220.0 * t, seed);
    shade(blend(ground, ink, share), worn)
}
