//! One point and two lines: the intersection of two conics.
//!
//! With w_i = R'n_i normal to V_i and w_i . (X - C_i) = l (n_i . b), each w_i is known up to one number s_i once the depth l
//! is; |w_1| = |w_2| = 1 and w_1 . w_2 = n_1 . n_2 are three quadrics in (l, s_1, s_2) without mixed constants.

use super::{SampleLine, Solutions, conic, rotation_from_pairs};
use nalgebra::{Matrix3, Vector3};

/// Poses for which the point lies on its bearing, in front of the camera, and each line lies in its viewing plane.
pub fn p1p2ll(
    bearing: &Vector3<f64>,
    point: &Vector3<f64>,
    lines: &[SampleLine; 2],
    out: &mut Solutions,
) {
    out.clear();
    let mut u = [Vector3::zeros(); 2];
    let mut v = [Vector3::zeros(); 2];
    let mut g = [0.0; 2];
    for i in 0..2 {
        let axis = lines[i].direction_in_world;
        let offset = point - lines[i].point_in_world;
        let across = offset - axis * axis.dot(&offset);
        let distance = across.norm();
        if !(distance > 1e-12 * offset.norm()) {
            return; // the point lies on the line
        }
        u[i] = across / distance;
        v[i] = axis.cross(&u[i]);
        g[i] = lines[i].normal_in_cam.dot(bearing) / distance;
    }
    let largest = g[0].abs().max(g[1].abs());
    if !(largest > 0.0) {
        return;
    }
    let k = lines[0].normal_in_cam.dot(&lines[1].normal_in_cam);
    let (g0, g1) = (g[0] / largest, g[1] / largest);
    let a = g0 * g1 * u[0].dot(&u[1]);
    let b = 0.5 * g0 * u[0].dot(&v[1]);
    let c = 0.5 * g1 * v[0].dot(&u[1]);
    let d = 0.5 * v[0].dot(&v[1]);
    let first = Matrix3::new(g0 * g0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0);
    let second = Matrix3::new(g1 * g1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let third = Matrix3::new(a, c, b, c, 0.0, d, b, d, 0.0);
    let unit = if g0.abs() >= g1.abs() { first } else { second };
    for direction in conic::intersect(&(first - second), &(third - unit * k)).as_slice() {
        let mut y = if direction.x < 0.0 {
            -direction
        } else {
            *direction
        };
        if !(y.x > 0.0) {
            continue;
        }
        let q = y.dot(&(unit * y));
        if !(q > 0.0) {
            continue;
        }
        y /= q.sqrt();
        for _ in 0..2 {
            let (h1, h2, h3) = (first * y, second * y, third * y);
            let residual = Vector3::new(y.dot(&h1) - 1.0, y.dot(&h2) - 1.0, y.dot(&h3) - k);
            let jacobian =
                Matrix3::from_rows(&[h1.transpose(), h2.transpose(), h3.transpose()]) * 2.0;
            let Some(inverse) = jacobian.try_inverse() else {
                break;
            };
            let step = inverse * residual;
            if !(step.norm_squared() < 0.01 * y.norm_squared()) {
                break;
            }
            y -= step;
        }
        let depth = y.x / largest;
        let w0 = u[0] * (depth * g[0]) + v[0] * y.y;
        let w1 = u[1] * (depth * g[1]) + v[1] * y.z;
        let cam = (&lines[0].normal_in_cam, &lines[1].normal_in_cam);
        if let Some(rotation) = rotation_from_pairs((&w0, &w1), cam) {
            out.push(rotation, bearing * depth - rotation * point);
        }
    }
}
