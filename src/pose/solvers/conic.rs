//! Intersection of two conics, the kernel of [`super::p3p`] and [`super::p1p2ll`].
//!
//! A singular member C = A + s B of the pencil is a pair of lines; each line meets B in two points.
//! One real root of the cubic det(A + s B) = 0 is enough.

use crate::math::poly::{cubic_root, quadratic_ratios};
use nalgebra::{Matrix3, Vector3};

/// Up to four projective points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Intersections {
    points: [Vector3<f64>; 4],
    len: usize,
}

impl Intersections {
    const EMPTY: Self = Self {
        points: [Vector3::new(0.0, 0.0, 0.0); 4],
        len: 0,
    };

    pub(super) fn as_slice(&self) -> &[Vector3<f64>] {
        &self.points[..self.len]
    }
}

/// Cofactor matrix of a symmetric matrix.
fn cofactors(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

/// Real common points of y'Ay = 0 and y'By = 0 (symmetric matrices), unit length, sign free.
pub(super) fn intersect(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Intersections {
    let (size_a, size_b) = (a.amax(), b.amax());
    if !(size_a > 0.0 && size_b > 0.0) {
        return Intersections::EMPTY;
    }
    let (mut a, mut b) = (a / size_a, b / size_b);
    let (cof_a, cof_b) = (cofactors(&a), cofactors(&b));
    let mut det_a = a.column(0).dot(&cof_a.column(0));
    let mut det_b = b.column(0).dot(&cof_b.column(0));
    let mut c2 = a.component_mul(&cof_b).sum();
    let mut c1 = b.component_mul(&cof_a).sum();
    if det_b.abs() < det_a.abs() {
        core::mem::swap(&mut a, &mut b);
        core::mem::swap(&mut det_a, &mut det_b);
        core::mem::swap(&mut c1, &mut c2);
    }
    let singular = if det_b.abs() < 1e-300 {
        // Both are pairs of lines already.
        a
    } else {
        a + b * cubic_root(c2 / det_b, c1 / det_b, det_a / det_b)
    };
    let m = -cofactors(&singular);
    let size = singular.amax();
    let i = (0..3).fold(0, |i, j| if m[(j, j)] > m[(i, i)] { j } else { i });
    let largest = m[(i, i)];
    let mut lines = [Vector3::zeros(); 2];
    if largest > 1e-14 * size * size {
        let p = m.column(i) / largest.sqrt();
        let n = singular + p.cross_matrix();
        let (mut row, mut column) = (0, 0);
        let mut best = -1.0;
        for r in 0..3 {
            for c in 0..3 {
                if n[(r, c)].abs() > best {
                    best = n[(r, c)].abs();
                    (row, column) = (r, c);
                }
            }
        }
        lines[0] = n.row(row).transpose();
        lines[1] = n.column(column).into();
    } else if m.amax() <= 1e-12 * size * size {
        // Rank one: a double line.
        let row = (0..3).fold(0, |i, j| {
            if singular.row(j).amax() > singular.row(i).amax() {
                j
            } else {
                i
            }
        });
        lines = [singular.row(row).transpose(); 2];
    } else {
        return Intersections::EMPTY;
    }
    let mut out = Intersections::EMPTY;
    for line in lines {
        let j = line.iamax();
        let pivot = line[j];
        if pivot == 0.0 {
            continue;
        }
        let (k, l) = ((j + 1) % 3, (j + 2) % 3);
        let mut u = Vector3::zeros();
        u[k] = 1.0;
        u[j] = -line[k] / pivot;
        let mut v = Vector3::zeros();
        v[l] = 1.0;
        v[j] = -line[l] / pivot;
        let (bu, bv) = (b * u, b * v);
        if let Some(roots) = quadratic_ratios(u.dot(&bu), 2.0 * u.dot(&bv), v.dot(&bv)) {
            for (x, w) in roots {
                let y = u * x + v * w;
                let norm = y.norm();
                if norm > 0.0 && norm.is_finite() {
                    out.points[out.len] = y / norm;
                    out.len += 1;
                }
            }
        }
    }
    out
}
