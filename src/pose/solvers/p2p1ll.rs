//! Two points and one line: one quadratic in the ratio of the two depths.
//!
//! With w = R'n, the world normal of the viewing plane (w . V = 0), each point gives w . (X_i - C) = l_i (n . b_i).
//! |w| = 1 and the distance of the two points are two homogeneous quadrics in the depths; eliminating the scale leaves a
//! quadratic. Degree two is minimal (Hruby, Duff, Pollefeys, CVPR 2024).

use super::{SampleLine, Solutions, any_normal, rotation_from_pairs};
use crate::math::poly::quadratic_ratios;
use nalgebra::{Vector2, Vector3};

/// Poses for which both points lie on their bearings, in front of the camera, and the line lies in its viewing plane.
pub fn p2p1ll(
    bearings: &[Vector3<f64>; 2],
    points: &[Vector3<f64>; 2],
    line: &SampleLine,
    out: &mut Solutions,
) {
    out.clear();
    let n = line.normal_in_cam;
    let v = line.direction_in_world;
    let u1 = any_normal(&v);
    let u2 = v.cross(&u1);
    let in_plane = |x: &Vector3<f64>| {
        let d = x - line.point_in_world;
        Vector2::new(u1.dot(&d), u2.dot(&d))
    };
    let (p1, p2) = (in_plane(&points[0]), in_plane(&points[1]));
    let (e1, e2) = (n.dot(&bearings[0]), n.dot(&bearings[1]));
    if e1.abs() < 1e-12 && e2.abs() < 1e-12 {
        return; // both points in the viewing plane of the line: it adds one constraint only
    }
    let cosine = bearings[0].dot(&bearings[1]);
    let edge = points[1] - points[0];
    let s = edge.norm_squared();
    let det = p1.x * p2.y - p1.y * p2.x;
    let is_coplanar = det * det < 1e-12 * p1.norm_squared() * p2.norm_squared();
    let ratios = if is_coplanar {
        let ratio = (e2 * p1.dot(&p2), e1 * p2.norm_squared());
        [ratio, (0.0, 0.0)]
    } else {
        let dd = det * det;
        let a = s * e1 * e1 * p2.norm_squared() - dd;
        let b = 2.0 * (cosine * dd - s * e1 * e2 * p1.dot(&p2));
        let c = s * e2 * e2 * p1.norm_squared() - dd;
        match quadratic_ratios(a, b, c) {
            Some(r) => r,
            None => return,
        }
    };
    for (num, den) in ratios {
        let (mut l1, mut l2) = if num < 0.0 { (-num, -den) } else { (num, den) };
        if !(l1 > 0.0 && l2 > 0.0) {
            continue;
        }
        // The two parts of the ratio may be tiny: bring them to unit size before squaring.
        let size = l1.max(l2);
        l1 /= size;
        l2 /= size;
        let q = l1 * l1 + l2 * l2 - 2.0 * cosine * l1 * l2;
        if !(q > 0.0) {
            continue;
        }
        let scale = (s / q).sqrt();
        let (l1, l2) = (l1 * scale, l2 * scale);
        let mut normals = [None; 2];
        if is_coplanar {
            let (m, r) = if p1.norm_squared() > p2.norm_squared() {
                (p1, l1 * e1)
            } else {
                (p2, l2 * e2)
            };
            let length = m.norm();
            let cos = r / length;
            if !(cos.abs() <= 1.0) {
                continue;
            }
            let sin = (1.0 - cos * cos).sqrt();
            let along = m / length;
            let across = Vector2::new(-along.y, along.x);
            normals = [
                Some(along * cos + across * sin),
                Some(along * cos - across * sin),
            ];
        } else {
            let (r1, r2) = (l1 * e1, l2 * e2);
            normals[0] = Some(Vector2::new(r1 * p2.y - r2 * p1.y, r2 * p1.x - r1 * p2.x) / det);
        }
        for w in normals.iter().flatten() {
            let w = (u1 * w.x + u2 * w.y).normalize();
            let edge_in_cam = bearings[1] * l2 - bearings[0] * l1;
            if let Some(rotation) = rotation_from_pairs((&edge, &w), (&edge_in_cam, &n)) {
                out.push(rotation, bearings[0] * l1 - rotation * points[0]);
            }
        }
    }
}
