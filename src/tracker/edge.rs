//! Finds a straight edge near where it should be: the strongest step of the right sign along short normals, then the line
//! through most of them. Edges do not slip along texture as patches may.
//!
//! Positions are index coordinates of the picture.

use super::patch::interpolate;
use crate::image::GrayView;

/// Normals of one edge, at most.
const MAX_NORMALS: usize = 24;
/// Distance between them at least, in pixels.
const SPACING: f32 = 5.0;
/// A step is looked for this far to either side.
const REACH: usize = 6;
/// Grey samples along a normal.
const SAMPLES: usize = 2 * REACH + 3;
/// Edges with fewer steps than this, or less than this share of their normals, are not found.
const MIN_STEPS: usize = 4;
const MIN_SHARE: f32 = 0.6;
/// Steps further than this from the line are not of it, in pixels.
const MAX_OFF: f32 = 1.2;
/// The mean difference of grey levels over two pixels that makes an edge of the reference.
const MIN_STEP: f32 = 8.0;
/// A step of the picture has at least this share of the reference's.
const MIN_STEP_SHARE: f32 = 0.35;

/// A piece of a line in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    pub(super) start: [f32; 2],
    pub(super) end: [f32; 2],
}

impl Piece {
    fn length(&self) -> f32 {
        let [dx, dy] = self.along();
        (dx * dx + dy * dy).sqrt()
    }

    fn along(&self) -> [f32; 2] {
        [self.end[0] - self.start[0], self.end[1] - self.start[1]]
    }

    /// The part that lies inside the picture with a margin for the normals; `None` when nothing does.
    pub(super) fn inside(&self, width: usize, height: usize) -> Option<Self> {
        let margin = REACH as f32 + 3.0;
        let [dx, dy] = self.along();
        let (mut from, mut to) = (0.0_f32, 1.0_f32);
        for (at, step, len) in [(self.start[0], dx, width), (self.start[1], dy, height)] {
            let (low, high) = (margin - at, len as f32 - 1.0 - margin - at);
            if step.abs() < 1e-6 {
                if !(low <= 0.0 && high >= 0.0) {
                    return None;
                }
                continue;
            }
            let (a, b) = (low / step, high / step);
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
        let at = |t: f32| [self.start[0] + t * dx, self.start[1] + t * dy];
        (from < to).then(|| Self {
            start: at(from),
            end: at(to),
        })
    }
}

/// Steps that were found along the normals: position along the piece, 0..1, and distance from it.
#[derive(Debug, Clone, Copy)]
struct Steps {
    at: [[f32; 2]; MAX_NORMALS],
    len: usize,
}

/// Looks for an edge near a piece. `strength` is the signed step of the reference (positive: brighter on the side of the normal,
/// which is the direction turned from x towards y); without one the edge's own sign is taken. The piece of the edge between the
/// same normals, and its step.
pub(super) fn find(
    image: &GrayView<'_>,
    near: &Piece,
    strength: Option<f32>,
) -> Option<(Piece, f32)> {
    let piece = near.inside(image.width, image.height)?;
    let length = piece.length();
    let count = ((length / SPACING) as usize).min(MAX_NORMALS);
    if count < MIN_STEPS {
        return None;
    }
    let [dx, dy] = piece.along().map(|v| v / length);
    let normal = [-dy, dx];
    let mut profiles = [[0.0; SAMPLES]; MAX_NORMALS];
    let t = |i: usize| (i as f32 + 0.5) / count as f32;
    let mut own = 0.0;
    for (i, profile) in profiles[..count].iter_mut().enumerate() {
        let center = [
            piece.start[0] + t(i) * length * dx,
            piece.start[1] + t(i) * length * dy,
        ];
        for (k, value) in profile.iter_mut().enumerate() {
            let s = k as f32 - (REACH as f32 + 1.0);
            *value = bilinear(
                image,
                [center[0] + s * normal[0], center[1] + s * normal[1]],
            )?;
        }
        own += profile[REACH + 2] - profile[REACH];
    }
    let strength = strength.unwrap_or(own / count as f32);
    if !(strength.abs() >= MIN_STEP) {
        return None;
    }
    let mut steps = Steps {
        at: [[0.0; 2]; MAX_NORMALS],
        len: 0,
    };
    for (i, profile) in profiles[..count].iter().enumerate() {
        if let Some(offset) = strongest(profile, strength) {
            steps.at[steps.len] = [t(i), offset];
            steps.len += 1;
        }
    }
    if (steps.len as f32) < MIN_SHARE * count as f32 || steps.len < MIN_STEPS {
        return None;
    }
    let [offset, slope] = through_most(&steps, count)?;
    let shifted = |t: f32| {
        let by = offset + slope * t;
        [
            piece.start[0] + t * length * dx + by * normal[0],
            piece.start[1] + t * length * dy + by * normal[1],
        ]
    };
    let found = Piece {
        start: shifted(0.0),
        end: shifted(1.0),
    };
    Some((found, strength))
}

/// Where the step of the right sign is largest, by a parabola through its neighbours; near the middle rather than far off.
fn strongest(profile: &[f32; SAMPLES], strength: f32) -> Option<f32> {
    let sign = strength.signum();
    let step = |k: usize| sign * (profile[k + 1] - profile[k - 1]);
    let least = MIN_STEP_SHARE * strength.abs();
    let mut best: Option<(f32, usize)> = None;
    for k in 2..SAMPLES - 2 {
        let value = step(k);
        let is_peak = value >= least && value >= step(k - 1) && value > step(k + 1);
        // A step counts half at the end of the reach.
        let off = (k as f32 - (REACH as f32 + 1.0)).abs() / REACH as f32;
        let score = value.min(1.5 * strength.abs()) * (1.0 - 0.5 * off);
        if is_peak && best.is_none_or(|(most, _)| score > most) {
            best = Some((score, k));
        }
    }
    let (_, k) = best?;
    let (before, at, after) = (step(k - 1), step(k), step(k + 1));
    let bend = before - 2.0 * at + after;
    let shift = if bend < 0.0 {
        (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
    } else {
        0.0
    };
    Some(k as f32 - (REACH as f32 + 1.0) + shift)
}

/// Offset and slope of the line through most steps: the best pair, then least squares over what agrees.
fn through_most(steps: &Steps, count: usize) -> Option<[f32; 2]> {
    let at = &steps.at[..steps.len];
    let near =
        |line: [f32; 2], step: &[f32; 2]| (step[1] - line[0] - line[1] * step[0]).abs() < MAX_OFF;
    let mut best = (0, [0.0; 2]);
    for (i, a) in at.iter().enumerate() {
        // Pairs that lie apart, so that the slope is well known.
        for b in at[i + 1..].iter().filter(|b| b[0] - a[0] > 0.4) {
            let slope = (b[1] - a[1]) / (b[0] - a[0]);
            let line = [a[1] - slope * a[0], slope];
            let votes = at.iter().filter(|step| near(line, step)).count();
            if votes > best.0 {
                best = (votes, line);
            }
        }
    }
    let (votes, line) = best;
    if (votes as f32) < MIN_SHARE * count as f32 || votes < MIN_STEPS {
        return None;
    }
    let (mut n, mut t, mut tt, mut s, mut ts) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for step in at.iter().filter(|step| near(line, step)) {
        n += 1.0;
        t += step[0];
        tt += step[0] * step[0];
        s += step[1];
        ts += step[0] * step[1];
    }
    let determinant = n * tt - t * t;
    if !(determinant > 1e-6) {
        return None;
    }
    Some([
        (tt * s - t * ts) / determinant,
        (n * ts - t * s) / determinant,
    ])
}

fn bilinear(image: &GrayView<'_>, [x, y]: [f32; 2]) -> Option<f32> {
    if !(x >= 0.0 && y >= 0.0) {
        return None;
    }
    let (left, top) = (x as usize, y as usize);
    if left + 1 >= image.width || top + 1 >= image.height {
        return None;
    }
    Some(interpolate(image, [left, top], [x, y]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::GrayImage;

    /// A straight border between 60 and 180 through a point, with the exact share of each pixel that lies on the bright side of
    /// it, to a 64th.
    fn border(width: usize, height: usize, through: [f32; 2], normal: [f32; 2]) -> GrayImage {
        let side = |x: f32, y: f32| (x - through[0]) * normal[0] + (y - through[1]) * normal[1];
        let mut data = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let bright = (0..64).filter(|k| {
                    let (i, j) = (k % 8, k / 8);
                    let at = |base: usize, k: usize| base as f32 + (k as f32 + 0.5) / 8.0 - 0.5;
                    side(at(x, i), at(y, j)) > 0.0
                });
                data.push((60.0 + 120.0 * bright.count() as f32 / 64.0).round() as u8);
            }
        }
        GrayImage {
            data,
            width,
            height,
        }
    }

    fn distance(piece: &Piece, through: [f32; 2], normal: [f32; 2]) -> f32 {
        let off = |p: [f32; 2]| (p[0] - through[0]) * normal[0] + (p[1] - through[1]) * normal[1];
        off(piece.start).abs().max(off(piece.end).abs())
    }

    #[test]
    fn a_border_is_found_to_a_tenth_of_a_pixel() {
        for (angle, shift) in [(0.0_f32, 0.3_f32), (0.4, -2.7), (1.2, 3.4), (2.9, 1.0)] {
            let normal = [-angle.sin(), angle.cos()];
            let through = [80.3, 60.7];
            let image = border(160, 120, through, normal);
            // The guess lies beside the border and is turned by a degree.
            let turned = angle + 0.017;
            let start = [
                through[0] + shift * normal[0],
                through[1] + shift * normal[1],
            ];
            let ends = |s: f32| [start[0] + s * turned.cos(), start[1] + s * turned.sin()];
            let near = Piece {
                start: ends(-30.0),
                end: ends(30.0),
            };
            let (found, strength) = find(&image.view(), &near, Some(100.0)).expect("in reach");
            assert!(
                distance(&found, through, normal) < 0.1,
                "{angle} {shift}: {}",
                distance(&found, through, normal)
            );
            assert_eq!(strength, 100.0);
            // The other sign is not there.
            assert!(find(&image.view(), &near, Some(-100.0)).is_none());
            // On the border itself the sign shows.
            let own = Piece {
                start: found.start,
                end: found.end,
            };
            let (_, strength) = find(&image.view(), &own, None).expect("on the border");
            assert!(strength > 60.0);
        }
    }

    #[test]
    fn nothing_is_found_on_a_wall() {
        let image = GrayImage {
            data: vec![90; 160 * 120],
            width: 160,
            height: 120,
        };
        let near = Piece {
            start: [20.0, 30.0],
            end: [120.0, 80.0],
        };
        assert!(find(&image.view(), &near, None).is_none());
        assert!(find(&image.view(), &near, Some(50.0)).is_none());
    }

    #[test]
    fn pieces_are_cut_to_the_picture() {
        let piece = Piece {
            start: [-50.0, 60.0],
            end: [250.0, 60.0],
        };
        let inside = piece.inside(160, 120).expect("crosses it");
        assert_eq!((inside.start, inside.end), ([9.0, 60.0], [150.0, 60.0]));
        let outside = Piece {
            start: [-50.0, 4.0],
            end: [250.0, 4.0],
        };
        assert!(outside.inside(160, 120).is_none());
    }
}
