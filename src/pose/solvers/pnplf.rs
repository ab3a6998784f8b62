//! Four points or lines, focal length unknown.
//!
//! diag(f, f, 1) [R | t] is linear in its twelve entries: two equations per item, a null space of dimension four. Orthogonal
//! rows are three quadrics in the three free coefficients; that the first two rows have equal length is left over and rejects
//! false solutions.

use super::quadrics::{self, Quadrics};
use crate::geometry::CamFromWorld;
use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

/// An image line and its world line; pixels are counted from the principal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageLineCentered {
    /// Homogeneous image line: `line . (x, y, 1) = 0` for the pixels (x, y) on it.
    pub line: Vector3<f64>,
    /// Any point of the world line.
    pub point_in_world: Vector3<f64>,
    /// Unit direction of the world line.
    pub direction_in_world: Vector3<f64>,
}

/// A pose with its focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalPose {
    /// The pose.
    pub cam_from_world: CamFromWorld,
    /// In the pixels of the input.
    pub focal_px: f64,
}

/// Up to eight poses with focal lengths.
#[derive(Debug, Clone, Copy)]
pub struct FocalSolutions {
    items: [FocalPose; 8],
    len: usize,
}

impl Default for FocalSolutions {
    fn default() -> Self {
        let none = FocalPose {
            cam_from_world: CamFromWorld::identity(),
            focal_px: 1.0,
        };
        Self {
            items: [none; 8],
            len: 0,
        }
    }
}

impl core::ops::Deref for FocalSolutions {
    type Target = [FocalPose];

    fn deref(&self) -> &[FocalPose] {
        &self.items[..self.len]
    }
}

/// Solutions whose two focal lengths differ by more than this (in ln) are not solutions of a camera with square pixels.
const MAX_LOG_ASPECT: f64 = 0.1;

type Columns = SMatrix<f64, 12, 8>;

/// Poses and focal lengths for four items in total (`pixels` and `points` in the same order, then `lines`).
///
/// Any other number of items gives an empty list, as do flat scenes, where focal length and depth cannot be told apart.
pub fn pnplf(
    pixels: &[Vector2<f64>],
    points: &[Vector3<f64>],
    lines: &[ImageLineCentered],
    out: &mut FocalSolutions,
) {
    out.len = 0;
    if pixels.len() != points.len() || points.len() + lines.len() != 4 {
        return;
    }
    let unit_px = if pixels.is_empty() {
        let distance = |l: &ImageLineCentered| l.line.z.abs() / l.line.xy().norm();
        lines.iter().map(distance).sum::<f64>() / 4.0
    } else {
        pixels.iter().map(|p| p.norm()).sum::<f64>() / pixels.len() as f64
    };
    let all = || {
        points
            .iter()
            .copied()
            .chain(lines.iter().map(|l| l.point_in_world))
    };
    let center = all().sum::<Vector3<f64>>() / 4.0;
    let scale = all().map(|x| (x - center).norm()).sum::<f64>() / 4.0;
    if !(unit_px > 0.0 && scale > 0.0 && unit_px.is_finite() && scale.is_finite()) {
        return;
    }
    let mut a = Columns::zeros();
    let mut k = 0;
    for (pixel, point) in pixels.iter().zip(points) {
        let x = (point - center) / scale;
        let p = pixel / unit_px;
        for axis in 0..2 {
            for j in 0..4 {
                let h = if j < 3 { x[j] } else { 1.0 };
                a[(4 * axis + j, k)] = -h;
                a[(8 + j, k)] = p[axis] * h;
            }
            k += 1;
        }
    }
    for line in lines {
        let l = Vector3::new(line.line.x, line.line.y, line.line.z / unit_px);
        let l = l / l.norm();
        let c = (line.point_in_world - center) / scale;
        for row in 0..3 {
            for j in 0..3 {
                a[(4 * row + j, k)] = l[row] * line.direction_in_world[j];
                a[(4 * row + j, k + 1)] = l[row] * c[j];
            }
            a[(4 * row + 3, k + 1)] = l[row];
        }
        k += 2;
    }
    let Some(null) = null_space(a) else {
        return;
    };
    // Rows of the left 3x3 block as linear forms in the four coefficients.
    let rows: [SMatrix<f64, 3, 4>; 3] =
        core::array::from_fn(|r| null.fixed_view::<3, 4>(4 * r, 0).into_owned());
    let form = |i: usize, j: usize| {
        let s = rows[i].transpose() * rows[j];
        let s = s + s.transpose();
        [
            0.5 * s[(0, 0)],
            s[(0, 1)],
            s[(0, 2)],
            0.5 * s[(1, 1)],
            s[(1, 2)],
            0.5 * s[(2, 2)],
            s[(0, 3)],
            s[(1, 3)],
            s[(2, 3)],
            0.5 * s[(3, 3)],
        ]
    };
    let forms = [form(0, 1), form(0, 2), form(1, 2)];
    let q = Quadrics::from_fn(|r, c| forms[r][c]);
    quadrics::solve(&q, |s| {
        let p: SVector<f64, 12> = null * SVector::<f64, 4>::new(s.x, s.y, s.z, 1.0);
        let mut left = Matrix3::from_fn(|r, c| p[4 * r + c]);
        let mut right = Vector3::from_fn(|r, _| p[4 * r + 3]);
        let det = left.determinant();
        if det < 0.0 {
            left = -left;
            right = -right;
        }
        let depth_norm = left.row(2).norm();
        let (fx, fy) = (
            left.row(0).norm() / depth_norm,
            left.row(1).norm() / depth_norm,
        );
        let aspect = crate::math::elementary::ln(fx / fy).abs();
        if !(aspect < MAX_LOG_ASPECT) || out.len == out.items.len() {
            return;
        }
        let focal = (fx * fy).sqrt();
        let rotation = Matrix3::from_rows(&[
            left.row(0) / (fx * depth_norm),
            left.row(1) / (fy * depth_norm),
            left.row(2) / depth_norm,
        ]);
        let t = Vector3::new(right.x / fx, right.y / fy, right.z) * (scale / depth_norm);
        let translation = t - rotation * center;
        if (rotation.sum() + translation.sum() + focal).is_finite() {
            out.items[out.len] = FocalPose {
                cam_from_world: CamFromWorld::new(rotation, translation),
                focal_px: focal * unit_px,
            };
            out.len += 1;
        }
    });
}

/// Orthonormal basis of the vectors normal to all columns, by Householder QR with column pivoting; `None` when the rank is
/// below eight.
fn null_space(mut a: Columns) -> Option<SMatrix<f64, 12, 4>> {
    let mut reflectors = Columns::zeros();
    let mut first = 0.0;
    for k in 0..8 {
        let tail = |a: &Columns, c: usize| (k..12).map(|r| a[(r, c)] * a[(r, c)]).sum::<f64>();
        let pivot = (k..8).fold(k, |i, j| if tail(&a, j) > tail(&a, i) { j } else { i });
        a.swap_columns(k, pivot);
        let norm = tail(&a, k).sqrt();
        if k == 0 {
            first = norm;
        }
        if !(norm > 1e-12 * first) {
            return None;
        }
        let alpha = -norm.copysign(a[(k, k)]);
        let mut v = SVector::<f64, 12>::zeros();
        for r in k..12 {
            v[r] = a[(r, k)];
        }
        v[k] -= alpha;
        let v = v / v.norm();
        for c in k..8 {
            let column = a.column(c).into_owned();
            a.set_column(c, &(column - v * (2.0 * v.dot(&column))));
        }
        reflectors.set_column(k, &v);
    }
    let mut basis = SMatrix::<f64, 12, 4>::zeros();
    for c in 0..4 {
        let mut e = SVector::<f64, 12>::zeros();
        e[8 + c] = 1.0;
        for k in (0..8).rev() {
            let v = reflectors.column(k).into_owned();
            e -= v * (2.0 * v.dot(&e));
        }
        basis.set_column(c, &e);
    }
    Some(basis)
}
