//! Gravity known: two items fix the remaining four degrees of freedom.
//!
//! Input is rotated beforehand so that gravity is the y axis in both spaces; the rotation left is
//! R_y(psi) = [[c, 0, s], [0, 1, 0], [-s, 0, c]]. (Kukelova et al., ACCV 2010, for points.)

use super::{SampleLine, Solutions};
use crate::math::elementary::{acos, atan2, cos, hypot, sin};
use crate::math::poly::quadratic_ratios;
use nalgebra::{Matrix3, Vector2, Vector3};

fn turn(c: f64, s: f64) -> Matrix3<f64> {
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// Two points: the vertical difference is linear in the depths, the horizontal distance quadratic.
///
/// Degenerate when both bearings lie in the horizontal plane or the points above each other.
pub fn up2p(bearings: &[Vector3<f64>; 2], points: &[Vector3<f64>; 2], out: &mut Solutions) {
    out.clear();
    let d = points[1] - points[0];
    let horizontal_sq = d.x * d.x + d.z * d.z;
    let (y1, y2) = (bearings[0].y, bearings[1].y);
    let h = bearings.map(|b| Vector2::new(b.x, b.z));
    let norm = y1 * y1 + y2 * y2;
    if norm < 1e-12 || !(horizontal_sq > 1e-18 * d.norm_squared()) {
        return;
    }
    // Depths on the line l2 y2 - l1 y1 = d.y: the point nearest to zero plus a multiple of (y2, y1).
    let base = Vector2::new(-y1, y2) * (d.y / norm);
    let along = Vector2::new(y2, y1) / norm.sqrt();
    let gap = |l: &Vector2<f64>| h[1] * l.y - h[0] * l.x;
    let (gb, ga) = (gap(&base), gap(&along));
    let roots = quadratic_ratios(
        ga.norm_squared(),
        2.0 * ga.dot(&gb),
        gb.norm_squared() - horizontal_sq,
    );
    for (num, den) in roots.into_iter().flatten() {
        let l = base + along * (num / den);
        if !(l.x > 0.0 && l.y > 0.0) {
            continue;
        }
        let z = bearings[1] * l.y - bearings[0] * l.x;
        let (c, s) = (z.x * d.x + z.z * d.z, z.x * d.z - z.z * d.x);
        let m = (c * c + s * s).sqrt();
        let rotation = turn(c / m, s / m);
        out.push(rotation, bearings[0] * l.x - rotation * points[0]);
    }
}

/// One point and one line: n . R_y V = 0 gives the angle, the point the rest.
///
/// Degenerate for vertical lines, which say nothing about the angle, and when the point lies in the line's viewing plane.
pub fn up1p1ll(
    bearing: &Vector3<f64>,
    point: &Vector3<f64>,
    line: &SampleLine,
    out: &mut Solutions,
) {
    out.clear();
    let (n, v) = (line.normal_in_cam, line.direction_in_world);
    let (a, b, k) = (n.x * v.x + n.z * v.z, n.x * v.z - n.z * v.x, n.y * v.y);
    let amplitude = hypot(a, b);
    let e = n.dot(bearing);
    if amplitude < 1e-9 || k.abs() > amplitude || e.abs() < 1e-12 {
        return;
    }
    let (middle, spread) = (atan2(b, a), acos(-k / amplitude));
    for psi in [middle + spread, middle - spread] {
        let rotation = turn(cos(psi), sin(psi));
        let depth = n.dot(&(rotation * (point - line.point_in_world))) / e;
        if depth > 0.0 {
            out.push(rotation, bearing * depth - rotation * point);
        }
    }
}
