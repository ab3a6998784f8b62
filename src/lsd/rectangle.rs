//! Rectangles: the fit to a region, the pixels inside, and the search for a more meaningful neighbour.
//!
//! Source: `[lsd2012]`, sections on the rectangular approximation, the NFA computation and the rectangle improvement.
//! Coordinates are those of the working image with the centre of the first pixel at (0, 0).

use super::field::{DEFINED, Field};
use super::nfa::NfaTable;
use super::params::{Tolerance, angle_distance};
use super::region::Region;
use crate::math::precise;
use core::f64::consts::PI;

/// Steps of each stage of the improvement.
const STEPS: usize = 5;
/// By how much a step makes the rectangle narrower, in working pixels.
const NARROWER: f64 = 0.5;

/// A rectangle around a region: two end points on its axis, a width, and the precision it is judged by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rectangle {
    pub(super) start: [f64; 2],
    pub(super) end: [f64; 2],
    pub(super) width: f64,
    theta: f64,
    /// Cosine and sine of `theta`.
    axis: [f64; 2],
    /// How often the default precision was halved.
    pub(super) halvings: usize,
}

impl Rectangle {
    /// The rectangle that covers the region along its axis of inertia, weighted by gradient. Nothing when the weights
    /// or the inertia vanish, which image gradients cannot produce.
    pub(super) fn of_region(
        region: &Region,
        field: &Field,
        default_tolerance: &Tolerance,
    ) -> Option<Self> {
        let pixels = || {
            region
                .pixels
                .iter()
                .map(|&p| (p.x() as f64, p.y() as f64, field.norm[field.index(p)]))
        };
        let (mut cx, mut cy, mut total) = (0.0, 0.0, 0.0);
        for (x, y, weight) in pixels() {
            cx += x * weight;
            cy += y * weight;
            total += weight;
        }
        if total <= 0.0 {
            return None;
        }
        cx /= total;
        cy /= total;
        let theta = axis_angle(pixels(), [cx, cy], region.angle(), default_tolerance.rad)?;
        let (sin, cos) = precise::sin_cos(theta);
        let (mut along_min, mut along_max, mut across_min, mut across_max) =
            (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for (x, y, _) in pixels() {
            let along = (x - cx) * cos + (y - cy) * sin;
            let across = -(x - cx) * sin + (y - cy) * cos;
            along_min = along_min.min(along);
            along_max = along_max.max(along);
            across_min = across_min.min(across);
            across_max = across_max.max(across);
        }
        Some(Self {
            start: [cx + along_min * cos, cy + along_min * sin],
            end: [cx + along_max * cos, cy + along_max * sin],
            width: (across_max - across_min).max(1.0),
            theta,
            axis: [cos, sin],
            halvings: 0,
        })
    }

    pub(super) fn length(&self) -> f64 {
        let (dx, dy) = (self.end[0] - self.start[0], self.end[1] - self.start[1]);
        (dx * dx + dy * dy).sqrt()
    }

    /// Narrower by one step and moved sideways by `shift`; nothing when the width would fall below half a pixel.
    fn narrowed(&self, shift: f64) -> Option<Self> {
        let width = self.width - NARROWER;
        let [cos, sin] = self.axis;
        let moved = |p: [f64; 2]| [p[0] - sin * shift, p[1] + cos * shift];
        (width >= 0.5).then(|| Self {
            start: moved(self.start),
            end: moved(self.end),
            width,
            ..*self
        })
    }

    /// Calls `visit` with every column of working pixels inside: index of the first pixel in the field's arrays, count.
    fn for_each_column(&self, field: &Field, mut visit: impl FnMut(usize, usize)) {
        let [cos, sin] = self.axis;
        let half = |p: [f64; 2], sign: f64| {
            [
                p[0] - sign * (sin * self.width / 2.0),
                p[1] + sign * (cos * self.width / 2.0),
            ]
        };
        let corners = [
            half(self.start, 1.0),
            half(self.end, 1.0),
            half(self.end, -1.0),
            half(self.start, -1.0),
        ];
        let ([x1, y1], [x2, y2]) = (self.start, self.end);
        let first = if x1 < x2 && y1 <= y2 {
            0
        } else if x1 >= x2 && y1 < y2 {
            1
        } else if x1 > x2 && y1 >= y2 {
            2
        } else {
            3
        };
        let v: [[f64; 2]; 4] = core::array::from_fn(|i| corners[(first + i) % 4]);
        let low = [
            Side::new(v[0], v[3], f64::min),
            Side::new(v[3], v[2], f64::min),
        ];
        let high = [
            Side::new(v[0], v[1], f64::max),
            Side::new(v[1], v[2], f64::max),
        ];
        let from = ceil(v[0][0]).max(0);
        let mut x = from as f64;
        let last_x = (field.width - 1) as f64;
        let last_y = field.height as i32 - 1;
        while x <= v[2][0] && x <= last_x {
            let y_low = low[usize::from(x >= v[3][0])].at(x);
            let y_high = high[usize::from(x >= v[1][0])].at(x);
            let (top, bottom) = (ceil(y_low).max(0), floor(y_high).min(last_y));
            if top <= bottom {
                visit(
                    (x as usize + 1) * field.stride + top as usize + 1,
                    (bottom - top + 1) as usize,
                );
            }
            x += 1.0;
        }
    }

    /// Number of pixels inside, and for each tolerance how many of them are aligned with the rectangle.
    fn count<const K: usize>(
        &self,
        field: &Field,
        tolerances: &[Tolerance; K],
    ) -> (usize, [usize; K]) {
        let mut total = 0;
        let (mut surely, mut perhaps) = ([0u32; K], [0u32; K]);
        self.for_each_column(field, |first, count| {
            total += count;
            let states = &field.state[first..first + count];
            let lines = &field.direction[first..first + count];
            for (state, line) in states.iter().zip(lines) {
                if state & DEFINED != 0 {
                    let dot = line[0] * self.axis[0] + line[1] * self.axis[1];
                    let signed_square = dot * dot.abs();
                    for k in 0..K {
                        surely[k] += u32::from(signed_square > tolerances[k].above);
                        perhaps[k] += u32::from(signed_square >= tolerances[k].below);
                    }
                }
            }
        });
        if surely != perhaps {
            return (total, self.count_exactly(field, tolerances));
        }
        (total, surely.map(|count| count as usize))
    }

    /// The same by comparing angles, for rectangles with a pixel in the band where products do not decide.
    #[cold]
    fn count_exactly<const K: usize>(
        &self,
        field: &Field,
        tolerances: &[Tolerance; K],
    ) -> [usize; K] {
        let mut aligned = [0; K];
        self.for_each_column(field, |first, count| {
            for i in first..first + count {
                if field.state[i] & DEFINED != 0 {
                    let [dx, dy] = field.direction[i];
                    let difference = angle_distance(self.theta, libm::atan2(dy, dx));
                    for k in 0..K {
                        aligned[k] += usize::from(difference <= tolerances[k].rad);
                    }
                }
            }
        });
        aligned
    }

    /// -log10 of the number of false alarms.
    pub(super) fn neg_log10_nfa(&self, field: &Field, nfa: &mut NfaTable) -> f64 {
        let (n, [k]) = self.count(field, &[nfa.tolerance(self.halvings)]);
        nfa.neg_log10(n, k, self.halvings)
    }

    /// Looks for a more meaningful rectangle nearby as long as this one is not above `least`. Gives the best one and
    /// its -log10 of the number of false alarms.
    pub(super) fn improved(self, field: &Field, nfa: &mut NfaTable, least: f64) -> (Self, f64) {
        let mut best = (self, self.neg_log10_nfa(field, nfa));
        if best.1 > least {
            return best;
        }
        best = finer(best, field, nfa);
        for shift in [0.0, 0.5 * NARROWER, -0.5 * NARROWER] {
            if best.1 > least {
                return best;
            }
            let mut candidate = best.0;
            for _ in 0..STEPS {
                let Some(next) = candidate.narrowed(shift) else {
                    break;
                };
                candidate = next;
                let value = candidate.neg_log10_nfa(field, nfa);
                if value > best.1 {
                    best = (candidate, value);
                }
            }
        }
        if best.1 > least {
            return best;
        }
        finer(best, field, nfa)
    }
}

/// Tries five finer precisions of the same rectangle; one scan counts for all of them.
fn finer((from, value): (Rectangle, f64), field: &Field, nfa: &mut NfaTable) -> (Rectangle, f64) {
    let tolerances: [Tolerance; STEPS] =
        core::array::from_fn(|step| nfa.tolerance(from.halvings + step + 1));
    let (n, aligned) = from.count(field, &tolerances);
    let mut best = (from, value);
    for (step, &k) in aligned.iter().enumerate() {
        let halvings = from.halvings + step + 1;
        let value = nfa.neg_log10(n, k, halvings);
        if value > best.1 {
            best = (Rectangle { halvings, ..from }, value);
        }
    }
    best
}

/// Angle of the axis of least inertia, turned to agree with the region's angle.
fn axis_angle(
    pixels: impl Iterator<Item = (f64, f64, f64)>,
    [cx, cy]: [f64; 2],
    region_angle: f64,
    tolerance: f64,
) -> Option<f64> {
    let (mut ixx, mut iyy, mut ixy) = (0.0, 0.0, 0.0);
    for (x, y, weight) in pixels {
        ixx += (y - cy) * (y - cy) * weight;
        iyy += (x - cx) * (x - cx) * weight;
        ixy -= (x - cx) * (y - cy) * weight;
    }
    if ixx == 0.0 && iyy == 0.0 && ixy == 0.0 {
        return None;
    }
    let smaller = 0.5 * (ixx + iyy - ((ixx - iyy) * (ixx - iyy) + 4.0 * ixy * ixy).sqrt());
    let theta = if ixx.abs() > iyy.abs() {
        precise::atan2(smaller - ixx, ixy)
    } else {
        precise::atan2(ixy, smaller - iyy)
    };
    if angle_distance(theta, region_angle) > tolerance {
        Some(theta + PI)
    } else {
        Some(theta)
    }
}

/// One border of a rectangle as a function of x.
struct Side {
    from: [f64; 2],
    run: f64,
    rise: f64,
    /// The y of a vertical border.
    vertical: Option<f64>,
}

impl Side {
    fn new(from: [f64; 2], to: [f64; 2], pick: fn(f64, f64) -> f64) -> Self {
        let (run, rise) = (to[0] - from[0], to[1] - from[1]);
        let largest = from[0].abs().max(to[0].abs()).max(f64::MIN_POSITIVE);
        Self {
            from,
            run,
            rise,
            vertical: (run.abs() / largest <= 100.0 * f64::EPSILON).then(|| pick(from[1], to[1])),
        }
    }

    fn at(&self, x: f64) -> f64 {
        match self.vertical {
            Some(y) => y,
            None => self.from[1] + (x - self.from[0]) * self.rise / self.run,
        }
    }
}

// Casts instead of `f64::ceil` and `floor`, which are calls on targets without a rounding instruction.
fn ceil(v: f64) -> i32 {
    let cut = v as i32;
    cut + i32::from(f64::from(cut) < v)
}

fn floor(v: f64) -> i32 {
    let cut = v as i32;
    cut - i32::from(f64::from(cut) > v)
}
