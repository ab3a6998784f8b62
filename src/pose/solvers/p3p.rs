//! Three points.
//!
//! Depths l satisfy l_i^2 + l_j^2 - 2 c_ij l_i l_j = |X_i - X_j|^2. Eliminating the scale leaves two conics in the
//! direction of l, whose intersection gives up to four solutions (Ding et al., CVPR 2023, use the same pencil).

use super::{Solutions, conic, rotation_from_pairs};
use nalgebra::{Matrix3, Vector3};

/// Poses for which each world point lies on its bearing, in front of the camera.
///
/// Degenerate when the points are collinear or two bearings coincide: the list stays empty.
pub fn p3p(bearings: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3], out: &mut Solutions) {
    out.clear();
    let d01 = (points[0] - points[1]).norm_squared();
    let d02 = (points[0] - points[2]).norm_squared();
    let d12 = (points[1] - points[2]).norm_squared();
    // The pair that does not touch index 0 must be the longest.
    let order = if d12 >= d01 && d12 >= d02 {
        [0, 1, 2]
    } else if d02 >= d01 {
        [1, 0, 2]
    } else {
        [2, 0, 1]
    };
    let b = order.map(|i| bearings[i]);
    let x = order.map(|i| points[i]);
    let (e1, e2) = (x[1] - x[0], x[2] - x[0]);
    let s01 = e1.norm_squared();
    let s02 = e2.norm_squared();
    let s12 = (x[1] - x[2]).norm_squared();
    // |cross| is twice the area; below this share of the longest side squared the points are collinear.
    if !(e1.cross(&e2).norm_squared() > 1e-18 * s12 * s12) {
        return;
    }
    let (c01, c02, c12) = (b[0].dot(&b[1]), b[0].dot(&b[2]), b[1].dot(&b[2]));
    let m01 = Matrix3::new(1.0, -c01, 0.0, -c01, 1.0, 0.0, 0.0, 0.0, 0.0);
    let m02 = Matrix3::new(1.0, 0.0, -c02, 0.0, 0.0, 0.0, -c02, 0.0, 1.0);
    let m12 = Matrix3::new(0.0, 0.0, 0.0, 0.0, 1.0, -c12, 0.0, -c12, 1.0);
    let candidates = conic::intersect(&(m01 - m12 * (s01 / s12)), &(m02 - m12 * (s02 / s12)));
    for direction in candidates.as_slice() {
        let mut l = if direction.sum() < 0.0 {
            -direction
        } else {
            *direction
        };
        if !(l.min() > 0.0) {
            continue;
        }
        let q = l.dot(&(m12 * l));
        if !(q > 0.0) {
            continue;
        }
        l *= (s12 / q).sqrt();
        for _ in 0..2 {
            let (g01, g02, g12) = (m01 * l, m02 * l, m12 * l);
            let residual = Vector3::new(l.dot(&g01) - s01, l.dot(&g02) - s02, l.dot(&g12) - s12);
            let jacobian =
                Matrix3::from_rows(&[g01.transpose(), g02.transpose(), g12.transpose()]) * 2.0;
            let Some(inverse) = jacobian.try_inverse() else {
                break;
            };
            let step = inverse * residual;
            // At a double root the Jacobian is singular; a step that is not small is not a polish.
            if !(step.norm_squared() < 0.01 * l.norm_squared()) {
                break;
            }
            l -= step;
        }
        let z0 = b[0] * l.x;
        let (c1, c2) = (b[1] * l.y - z0, b[2] * l.z - z0);
        if let Some(rotation) = rotation_from_pairs((&e1, &e2), (&c1, &c2)) {
            out.push(rotation, z0 - rotation * x[0]);
        }
    }
}
