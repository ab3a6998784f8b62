//! Three lines: one polynomial of degree eight.
//!
//! Two angles fix a rotation that maps line 1 into its viewing plane: theta turns the world normal about V_1, phi turns V_1
//! about n_1. The other two lines are linear in (cos phi, sin phi); eliminating phi leaves an octic in tan(theta / 2).

use super::{SampleLine, Solutions, any_normal};
use crate::math::poly::real_root_ratios;
use nalgebra::{Matrix3, Vector3};

/// Turns the world basis away from the special angle theta = pi for the usual axis-parallel input.
const BASIS_ANGLE_COS_SIN: (f64, f64) = (0.764_842_187_284_488_5, 0.644_217_687_237_691_1);

/// Quadratic in tau, constant term first.
type Quadratic = [f64; 3];

fn multiply(a: &Quadratic, b: &Quadratic) -> [f64; 5] {
    let mut out = [0.0; 5];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

fn difference(a: [f64; 5], b: [f64; 5]) -> [f64; 5] {
    core::array::from_fn(|i| a[i] - b[i])
}

/// Value of the homogeneous form of degree 4 at (x, w).
fn eval_ratio(p: &[f64; 5], x: f64, w: f64) -> f64 {
    (((p[4] * x + p[3] * w) * x + p[2] * w * w) * x + p[1] * w * w * w) * x + p[0] * w * w * w * w
}

/// Poses for which each line lies in its viewing plane.
///
/// Depth is not tested: a line has no bearing. Degenerate when the three planes meet in one ray (a room corner: the scale
/// cannot be seen), when all lines are parallel, or when two lines coincide.
pub fn p3ll(lines: &[SampleLine; 3], out: &mut Solutions) {
    out.clear();
    // Lines 0 and 1 are the pair with the largest angle between their viewing planes.
    let cross = |i: usize, j: usize| {
        lines[i]
            .normal_in_cam
            .cross(&lines[j].normal_in_cam)
            .norm_squared()
    };
    let (c01, c02, c12) = (cross(0, 1), cross(0, 2), cross(1, 2));
    let order = if c01 >= c02 && c01 >= c12 {
        [0, 1, 2]
    } else if c02 >= c12 {
        [0, 2, 1]
    } else {
        [1, 2, 0]
    };
    let l = order.map(|i| lines[i]);
    let n = l.map(|line| line.normal_in_cam);
    let v = l.map(|line| line.direction_in_world);
    let planes = Matrix3::from_rows(&[n[0].transpose(), n[1].transpose(), n[2].transpose()]);
    if !(planes.determinant().abs() > 1e-9) {
        return;
    }
    let Some(planes_inverse) = planes.try_inverse() else {
        return;
    };
    let u0 = any_normal(&v[0]);
    let w0 = v[0].cross(&u0);
    let (cos, sin) = BASIS_ANGLE_COS_SIN;
    let u = u0 * cos + w0 * sin;
    let w = w0 * cos - u0 * sin;
    let m = n[0].cross(&n[1]).normalize();
    let m2 = n[0].cross(&m);
    // cos theta, sin theta and 1 as quadratics in tau over the common factor 1 + tau^2.
    let (one, cos_theta, sin_theta) = ([1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [0.0, 2.0, 0.0]);
    let combine = |a: f64, p: &Quadratic, b: f64, q: &Quadratic| -> Quadratic {
        core::array::from_fn(|i| a * p[i] + b * q[i])
    };
    let coefficients = |i: usize| {
        let (vu, vw, along) = (v[i].dot(&u), v[i].dot(&w), v[i].dot(&v[0]));
        let in_normal = combine(vu, &cos_theta, vw, &sin_theta);
        let in_third = combine(vw, &cos_theta, -vu, &sin_theta);
        let (nm, nm2, nn) = (n[i].dot(&m), n[i].dot(&m2), n[i].dot(&n[0]));
        (
            combine(along * nm, &one, -nm2, &in_third),
            combine(along * nm2, &one, nm, &in_third),
            in_normal.map(|c| nn * c),
        )
    };
    let (a1, b1, c1) = coefficients(1);
    let (a2, b2, c2) = coefficients(2);
    let num_cos = difference(multiply(&b1, &c2), multiply(&b2, &c1));
    let num_sin = difference(multiply(&a2, &c1), multiply(&a1, &c2));
    let den = difference(multiply(&a1, &b2), multiply(&a2, &b1));
    let mut octic = [0.0; 9];
    for i in 0..5 {
        for j in 0..5 {
            octic[i + j] += num_cos[i] * num_cos[j] + num_sin[i] * num_sin[j] - den[i] * den[j];
        }
    }
    for &(x, q) in real_root_ratios(&octic).as_slice() {
        let d = eval_ratio(&den, x, q);
        let (cos_phi, sin_phi) = (
            eval_ratio(&num_cos, x, q) / d,
            eval_ratio(&num_sin, x, q) / d,
        );
        let length = (cos_phi * cos_phi + sin_phi * sin_phi).sqrt();
        if !(length > 0.5 && length < 2.0) {
            continue; // 0 / 0: no rotation belongs to this root
        }
        let (cos_phi, sin_phi) = (cos_phi / length, sin_phi / length);
        let k = x * x + q * q;
        let (cos_theta, sin_theta) = ((q * q - x * x) / k, 2.0 * x * q / k);
        let normal_in_world = u * cos_theta + w * sin_theta;
        let third = v[0].cross(&normal_in_world);
        let axis_in_cam = m * cos_phi + m2 * sin_phi;
        let third_in_cam = m * sin_phi - m2 * cos_phi;
        let mut rotation = n[0] * normal_in_world.transpose()
            + axis_in_cam * v[0].transpose()
            + third_in_cam * third.transpose();
        polish(&n, &v, &mut rotation);
        let offsets = Vector3::from_fn(|i, _| n[i].dot(&(rotation * l[i].point_in_world)));
        out.push(rotation, -(planes_inverse * offsets));
    }
}

/// Two Newton steps on n_i . R V_i = 0 over the rotation, each followed by the exact exponential.
fn polish(n: &[Vector3<f64>; 3], v: &[Vector3<f64>; 3], rotation: &mut Matrix3<f64>) {
    for _ in 0..2 {
        let moved = v.map(|axis| *rotation * axis);
        let residual = Vector3::from_fn(|i, _| n[i].dot(&moved[i]));
        // d/dw n . (w x RV) = (RV x n) . w
        let jacobian = Matrix3::from_rows(&[
            moved[0].cross(&n[0]).transpose(),
            moved[1].cross(&n[1]).transpose(),
            moved[2].cross(&n[2]).transpose(),
        ]);
        let Some(inverse) = jacobian.try_inverse() else {
            return;
        };
        let step = -(inverse * residual);
        if !(step.norm_squared() < 1e-2) {
            return;
        }
        *rotation = crate::geometry::rotation_from_vector(&step) * *rotation;
    }
}
