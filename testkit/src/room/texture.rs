//! What surfaces look like: reflectance as a function of metres on the quad. Linear RGB.

use super::color::{Rgb, blend, shade, srgb};
use super::noise::{Dice, cell, fbm, hash, smooth, value};
use super::patterns;
pub(super) use super::patterns::PATTERNS;

/// Kinds of surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Texture {
    /// Paint with a little unevenness.
    Paint(Rgb),
    /// Rough wall paint with stains.
    Plaster(Rgb),
    /// Bricks in running bond.
    Brick,
    /// Floor boards along s.
    Boards,
    /// Solid wood, grain along s.
    WoodAlong(Rgb),
    /// Solid wood, grain along t.
    WoodUp(Rgb),
    /// Woven rug with a border and diamonds.
    Rug,
    /// Cushions and seats.
    Fabric(Rgb),
    /// Back of a book.
    Spine,
    /// Pages of a book seen from above.
    Pages,
    /// Glazed wall tiles.
    Tiles,
    /// Notes pinned on cork.
    Cork,
    /// Chalk drawings.
    Blackboard,
    /// Printed picture of the given style.
    Print(u8),
    /// What is outside the window. Emits.
    Outside,
    /// Lamp cover. Emits.
    Lamp,
    /// Display of the laptop. Emits a little.
    Screen,
    /// Keys of the laptop.
    Keys,
    /// Face of the wall clock.
    Clock,
    /// Two colours on a grid.
    Pattern {
        kind: u8,
        side_m: f64,
        ground: Rgb,
        ink: Rgb,
    },
}

impl Texture {
    /// Light that the surface emits at full brightness; zero for nearly everything.
    pub(super) fn emission(self) -> f64 {
        match self {
            Self::Outside => 7.0,
            Self::Lamp => 15.0,
            Self::Screen => 0.7,
            _ => 0.0,
        }
    }

    /// Reflectance (or, where it emits, emitted colour) at `s`, `t` metres on a quad of `w` x `h` metres.
    pub(super) fn color(self, s: f64, t: f64, w: f64, h: f64, seed: u64) -> Rgb {
        match self {
            Self::Paint(c) => shade(c, 0.96 + 0.08 * fbm(9.0 * s, 9.0 * t, 3, seed)),
            Self::Plaster(c) => {
                let broad = fbm(1.3 * s, 1.3 * t, 3, seed);
                let fine = fbm(40.0 * s, 40.0 * t, 3, seed ^ 5);
                shade(c, 0.80 + 0.22 * broad + 0.20 * fine)
            }
            Self::Brick => brick(s, t, seed),
            Self::Boards => boards(s, t, seed),
            Self::WoodAlong(c) => wood(s, t, c, seed),
            Self::WoodUp(c) => wood(t, s, c, seed),
            Self::Rug => rug(s, t, w, h, seed),
            Self::Fabric(c) => {
                let weave = (s * 420.0).sin() * (t * 420.0).sin();
                shade(
                    c,
                    0.86 + 0.22 * fbm(14.0 * s, 14.0 * t, 4, seed) + 0.05 * weave,
                )
            }
            Self::Spine => spine(s, t, w, h, seed),
            Self::Pages => shade(srgb(0xE9DFC8), 0.8 + 0.2 * value(900.0 * t, 0.0, seed)),
            Self::Tiles => tiles(s, t, seed),
            Self::Cork => cork(s, t, w, h, seed),
            Self::Blackboard => blackboard(s, t, w, h, seed),
            Self::Print(style) => super::prints::color(style, s, t, w, h, seed),
            Self::Outside => outside(s / h, t / h, seed),
            Self::Lamp => srgb(0xFFF1D8),
            Self::Screen => screen(s / w, t / h, seed),
            Self::Keys => {
                let (x, y) = ((s * 52.0).rem_euclid(1.0), (t * 52.0).rem_euclid(1.0));
                if x > 0.15 && y > 0.15 {
                    srgb(0x2B2D31)
                } else {
                    srgb(0xA9ADB3)
                }
            }
            Self::Clock => clock(s / w - 0.5, t / h - 0.5),
            Self::Pattern {
                kind,
                side_m,
                ground,
                ink,
            } => patterns::color(kind, s, t, side_m, [ground, ink], seed),
        }
    }
}

fn brick(s: f64, t: f64, seed: u64) -> Rgb {
    const LENGTH: f64 = 0.24;
    const HEIGHT: f64 = 0.078;
    const JOINT: f64 = 0.011;
    let row = (t / HEIGHT).floor();
    let shifted = s + 0.5 * LENGTH * row.rem_euclid(2.0) + 0.012 * cell(row as i64, 3, seed);
    let column = (shifted / LENGTH).floor();
    let wobble = 0.004 * (fbm(30.0 * s, 30.0 * t, 2, seed) - 0.5);
    let x = shifted - column * LENGTH + wobble;
    let y = t - row * HEIGHT + wobble;
    let grain = fbm(70.0 * s, 70.0 * t, 3, seed ^ 9);
    if x < JOINT || y < JOINT {
        return shade(srgb(0xC9C0B4), 0.65 + 0.45 * grain);
    }
    let (a, b) = (column as i64, row as i64);
    let tint = cell(a, b, seed ^ 11);
    let base = blend(srgb(0x9C4A35), srgb(0xC4714F), tint);
    let base = if cell(a, b, seed ^ 12) > 0.86 {
        blend(base, srgb(0x5B3A33), 0.7)
    } else {
        base
    };
    let rim = smooth(((x - JOINT).min(y - JOINT) / 0.008).clamp(0.0, 1.0));
    shade(
        base,
        (0.55 + 0.75 * grain) * (0.75 + 0.25 * rim) * (0.85 + 0.3 * cell(a, b, seed ^ 13)),
    )
}

fn grain(along: f64, across: f64, seed: u64) -> f64 {
    let bend = 0.02 * fbm(1.7 * along, 6.0 * across, 2, seed);
    let rings = value(3.0 * along, 95.0 * (across + bend), seed ^ 3);
    let pores = value(22.0 * along, 300.0 * across, seed ^ 4);
    0.6 * rings + 0.25 * pores + 0.35 * fbm(2.0 * along, 12.0 * across, 3, seed ^ 6)
}

fn wood(along: f64, across: f64, c: Rgb, seed: u64) -> Rgb {
    shade(c, 0.62 + 0.6 * grain(along, across, seed))
}

fn boards(s: f64, t: f64, seed: u64) -> Rgb {
    const WIDTH: f64 = 0.125;
    let row = (t / WIDTH).floor();
    let length = 1.15;
    let shifted = s + length * cell(row as i64, 1, seed);
    let column = (shifted / length).floor();
    let (x, y) = (shifted - column * length, t - row * WIDTH);
    if x < 0.004 || y < 0.004 {
        return srgb(0x3A2415);
    }
    let (a, b) = (column as i64, row as i64);
    let base = blend(srgb(0x8F5E37), srgb(0xC79A66), cell(a, b, seed ^ 21));
    let knot = {
        let (kx, ky) = (
            length * cell(a, b, seed ^ 22),
            WIDTH * cell(a, b, seed ^ 23),
        );
        let r = (((x - kx) / 1.8).powi(2) + (y - ky).powi(2)).sqrt();
        if cell(a, b, seed ^ 24) > 0.6 {
            smooth((1.0 - r / 0.02).clamp(0.0, 1.0))
        } else {
            0.0
        }
    };
    let c = shade(base, 0.6 + 0.6 * grain(s, t, seed ^ hash(a, b, seed)));
    blend(c, srgb(0x3A2112), 0.75 * knot)
}

fn rug(s: f64, t: f64, w: f64, h: f64, seed: u64) -> Rgb {
    let (red, cream, blue, gold) = (
        srgb(0x8E2B2F),
        srgb(0xE6D9BD),
        srgb(0x25405F),
        srgb(0xC7963E),
    );
    let rim = s.min(w - s).min(t).min(h - t);
    let weave = 0.78 + 0.3 * value(170.0 * s, 170.0 * t, seed) + 0.05 * (t * 600.0).sin();
    let c = if rim < 0.05 {
        blue
    } else if rim < 0.07 {
        cream
    } else if rim < 0.17 {
        let along = if s.min(w - s) < t.min(h - t) { t } else { s };
        let zig = ((along / 0.09).rem_euclid(1.0) - 0.5).abs() * 2.0;
        if (rim - 0.07) / 0.10 < zig { gold } else { red }
    } else if rim < 0.19 {
        cream
    } else {
        let (cx, cy) = ((s / 0.32).floor(), (t / 0.32).floor());
        let (x, y) = (s / 0.32 - cx - 0.5, t / 0.32 - cy - 0.5);
        let d = x.abs() + y.abs();
        let kind = hash(cx as i64, cy as i64, seed) % 3;
        if d < 0.12 {
            [gold, cream, blue][kind as usize]
        } else if d < 0.27 {
            [blue, gold, cream][kind as usize]
        } else if d < 0.33 {
            cream
        } else if d < 0.47 {
            red
        } else if x.abs().max(y.abs()) > 0.40 {
            gold
        } else {
            blue
        }
    };
    shade(c, weave)
}

fn spine(s: f64, t: f64, w: f64, h: f64, seed: u64) -> Rgb {
    const COVERS: [u32; 14] = [
        0x7B2D26, 0x1F3B4D, 0x2F5D50, 0xD9B44A, 0xE4DCC7, 0x4A3B52, 0xB5532C, 0x26262B, 0x6E8B6B,
        0x9FB4C7, 0xC65B4E, 0x3F5F8A, 0xF0EAD6, 0x8A6D3B,
    ];
    let mut dice = Dice::new(seed);
    let cover = srgb(COVERS[dice.index(COVERS.len())]);
    let light = cover.iter().sum::<f64>() > 0.9;
    let ink = if light {
        srgb(0x33271C)
    } else {
        srgb(0xE8D9A8)
    };
    let (x, y) = (s / w, t / h);
    let style = dice.index(4);
    let mut c = shade(cover, 0.85 + 0.25 * fbm(60.0 * s, 25.0 * t, 2, seed));
    let bands: &[f64] = [&[0.08, 0.92][..], &[0.1, 0.13, 0.87, 0.9], &[0.78], &[]][style];
    for band in bands {
        if (y - band).abs() < 0.009 {
            c = ink;
        }
    }
    if style == 2 && y > 0.25 && y < 0.6 && x > 0.12 && x < 0.88 {
        c = srgb(0xEFE8D8);
    }
    // The title: blocks of the size of letters, running up the spine.
    let (from, to) = (dice.range(0.2, 0.3), dice.range(0.55, 0.75));
    if y > from && y < to && (x - 0.5).abs() < 0.24 {
        let letter = (t / 0.013).floor() as i64;
        let filled = cell(letter, 1, seed) > 0.18;
        let stroke = cell(letter, ((x - 0.26) / 0.16).floor() as i64 + 7, seed) > 0.35;
        if filled && stroke && (t / 0.013).rem_euclid(1.0) > 0.22 {
            c = if style == 2 { srgb(0x3B2A1E) } else { ink };
        }
    }
    c
}

fn tiles(s: f64, t: f64, seed: u64) -> Rgb {
    const SIDE: f64 = 0.15;
    let (i, j) = ((s / SIDE).floor(), (t / SIDE).floor());
    let (x, y) = (s / SIDE - i, t / SIDE - j);
    if x < 0.03 || y < 0.03 {
        return srgb(0xB8B4AA);
    }
    let h = hash(i as i64, j as i64, seed);
    let base = blend(
        srgb(0xDCE7E4),
        srgb(0xEDEFE6),
        cell(i as i64, j as i64, seed),
    );
    let r = ((x - 0.515).powi(2) + (y - 0.515).powi(2)).sqrt();
    let (dx, dy) = ((x - 0.515).abs(), (y - 0.515).abs());
    let ink = match h % 5 {
        0 => (0.28..0.36).contains(&r) || r < 0.1,
        1 => dx + dy < 0.34 && dx + dy > 0.22,
        2 => (dx - dy).abs() < 0.05,
        _ => false,
    };
    if ink { srgb(0x2B5C7D) } else { base }
}

fn cork(s: f64, t: f64, w: f64, h: f64, seed: u64) -> Rgb {
    const NOTES: [u32; 7] = [
        0xF6E27A, 0xF2F0E6, 0x9CCFE0, 0xF3A6A0, 0xB9DDA0, 0xF2F0E6, 0xF7C46C,
    ];
    let mut c = shade(
        srgb(0xB98654),
        0.5 + 0.9 * fbm(110.0 * s, 110.0 * t, 2, seed),
    );
    let mut dice = Dice::new(seed ^ 31);
    for note in 0..16 {
        let (cx, cy) = (
            w * (0.10 + 0.2667 * f64::from(note % 4)) + dice.range(-0.03, 0.03),
            h * (0.14 + 0.24 * f64::from(note / 4)) + dice.range(-0.02, 0.02),
        );
        let (nw, nh) = (dice.range(0.045, 0.085), dice.range(0.04, 0.065));
        let turn = dice.range(-0.25, 0.25);
        let paper = srgb(NOTES[dice.index(NOTES.len())]);
        let scribble = dice.bits();
        let (x, y) = (
            (s - cx) * turn.cos() + (t - cy) * turn.sin(),
            (t - cy) * turn.cos() - (s - cx) * turn.sin(),
        );
        if x.abs() < nw && y.abs() < nh {
            c = paper;
            let line = ((nh - y) / 0.016).floor();
            let inside = x.abs() < 0.8 * nw && y.abs() < 0.8 * nh;
            let reach = 2.0 * cell(line as i64, 5, scribble) - 0.4;
            let dash = cell((x / 0.006).floor() as i64, line as i64, scribble) > 0.3;
            if inside && ((nh - y) / 0.016 - line) > 0.62 && x / nw < reach && dash {
                c = srgb(0x2E3440);
            }
        }
        if (x.powi(2) + (y - 0.75 * nh).powi(2)).sqrt() < 0.008 {
            c = srgb([0xC0392B, 0x2C6E49, 0x1D4E89][(scribble % 3) as usize]);
        }
    }
    c
}

fn blackboard(s: f64, t: f64, w: f64, h: f64, seed: u64) -> Rgb {
    let smear = fbm(5.0 * s, 9.0 * t, 4, seed);
    let board = shade(srgb(0x2F4A43), 0.6 + 0.8 * smear);
    let chalk = blend(
        board,
        srgb(0xF2F2EA),
        0.65 + 0.3 * value(400.0 * s, 400.0 * t, seed),
    );
    let on_line = |x0: f64, y0: f64, x1: f64, y1: f64| {
        let (dx, dy) = (x1 - x0, y1 - y0);
        let k = (((s - x0) * dx + (t - y0) * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
        ((s - x0 - k * dx).powi(2) + (t - y0 - k * dy).powi(2)).sqrt() < 0.0042
    };
    // A camera looking at a cube, as rays through a picture plane.
    let (ox, oy) = (0.12 * w, 0.35 * h);
    let cube =
        [(0.55, 0.30), (0.80, 0.25), (0.80, 0.62), (0.55, 0.67)].map(|(x, y)| (x * w, y * h));
    let back = cube.map(|(x, y)| (x + 0.10 * w, y + 0.14 * h));
    let mut drawn = on_line(0.33 * w, 0.2 * h, 0.33 * w, 0.72 * h);
    for i in 0..4 {
        let (a, b) = (cube[i], cube[(i + 1) % 4]);
        let (c, d) = (back[i], back[(i + 1) % 4]);
        drawn |= on_line(a.0, a.1, b.0, b.1)
            || on_line(c.0, c.1, d.0, d.1)
            || on_line(a.0, a.1, c.0, c.1)
            || on_line(ox, oy, a.0, a.1);
    }
    // Lines of writing.
    let row = (t / (0.075 * h)).floor();
    let writing = s < 0.45 * w && t > 0.78 * h || s > 0.6 * w && t < 0.17 * h;
    let letter = (s / 0.016).floor() as i64;
    let stroke = cell(
        (s / 0.004).floor() as i64,
        (t / 0.007).floor() as i64,
        seed ^ 8,
    ) > 0.55;
    if writing && cell(letter / 5, row as i64, seed) > 0.15 && letter % 6 != 0 && stroke {
        let y = t / (0.075 * h) - row;
        drawn |= y > 0.3 && y < 0.75;
    }
    if drawn { chalk } else { board }
}

fn outside(x: f64, y: f64, seed: u64) -> Rgb {
    let sky = blend(
        srgb(0xDCEBF5),
        srgb(0x6FA3D8),
        smooth(((y - 0.4) / 0.6).clamp(0.0, 1.0)),
    );
    let cloud = smooth(((fbm(3.0 * x, 7.0 * y, 5, seed) - 0.5) * 4.0).clamp(0.0, 1.0));
    let mut c = blend(sky, srgb(0xFFFFFF), 0.8 * cloud);
    for (layer, (height, color)) in [(0.52, 0x8FA8B8), (0.42, 0x6C8A78), (0.33, 0x4F7350)]
        .into_iter()
        .enumerate()
    {
        let k = 1.5 + layer as f64;
        let ridge = height + 0.22 * (fbm(k * x, 0.0, 4, seed ^ (40 + layer as u64)) - 0.5);
        if y < ridge {
            let leaf = fbm(40.0 * x, 40.0 * y, 3, seed ^ 50);
            c = shade(srgb(color), 0.65 + 0.6 * leaf);
        }
    }
    // A row of houses.
    let slot = (x / 0.21).floor();
    let u = x / 0.21 - slot;
    let kind = hash(slot as i64, 9, seed);
    let tall = 0.17 + 0.08 * cell(slot as i64, 10, seed);
    let wall = srgb([0xD8C7A8, 0xB5654A, 0xE3DED2, 0x8C9DA8][(kind % 4) as usize]);
    if u > 0.06 && u < 0.94 && y < tall {
        let (wx, wy) = ((u * 4.0).rem_euclid(1.0), (y / 0.055).rem_euclid(1.0));
        let pane = wx > 0.3 && wx < 0.72 && wy > 0.3 && wy < 0.8 && y > 0.03;
        c = if pane { srgb(0x34434F) } else { wall };
    } else if y >= tall && y < tall + 0.09 * (1.0 - (2.0 * u - 1.0).abs()) {
        c = srgb([0x8B3A2B, 0x5D4A44, 0x9A5B3C][(kind % 3) as usize]);
    }
    c
}

fn screen(x: f64, y: f64, seed: u64) -> Rgb {
    if y > 0.93 {
        return srgb(0x3C3F46);
    }
    if x < 0.2 {
        let row = (y * 18.0).floor() as i64;
        let on = (y * 18.0).rem_euclid(1.0) > 0.45 && x < 0.03 + 0.13 * cell(row, 2, seed);
        return if on { srgb(0x7C8796) } else { srgb(0x22252B) };
    }
    let row = (y * 22.0).floor() as i64;
    let indent = 0.23 + 0.03 * (cell(row, 1, seed) * 4.0).floor();
    let reach = indent + 0.1 + 0.4 * cell(row, 3, seed);
    let word = cell((x * 28.0).floor() as i64, row, seed);
    if (y * 22.0).rem_euclid(1.0) > 0.45 && x > indent && x < reach && word > 0.2 {
        srgb([0x9CDCFE, 0xC586C0, 0xCE9178, 0xB5CEA8][((word * 97.0) as usize) % 4])
    } else {
        srgb(0x1B1E24)
    }
}

fn clock(x: f64, y: f64) -> Rgb {
    let r = (x * x + y * y).sqrt();
    let angle = x.atan2(y).rem_euclid(core::f64::consts::TAU);
    let hand = |turns: f64, length: f64, width: f64| {
        let (c, s) = (
            (turns * core::f64::consts::TAU).cos(),
            (turns * core::f64::consts::TAU).sin(),
        );
        let along = x * s + y * c;
        (x * c - y * s).abs() < width && along > -0.05 && along < length
    };
    if r > 0.5 {
        return srgb(0xE4DED2);
    }
    if r > 0.46 {
        return srgb(0x2A2A2E);
    }
    let hour = (angle / core::f64::consts::TAU * 12.0 + 0.5).rem_euclid(1.0) - 0.5;
    let mark = (0.36..0.43).contains(&r) && (hour * r).abs() < 0.025;
    if mark || hand(0.845, 0.24, 0.016) || hand(0.14, 0.36, 0.011) || r < 0.03 {
        srgb(0x1D1D20)
    } else {
        srgb(0xF7F4EC)
    }
}
