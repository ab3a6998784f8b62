//! Fundamental matrices (seven and eight points) and homographies (four points and more) between two views.
//!
//! Places are homogeneous with z = 1 and of the order of one, so no further normalisation is needed. Hartley and Zisserman,
//! Multiple View Geometry, chapters 4 and 11.

use super::five_point::{epipolar_row, null_space};
use super::relative::sampson_sq;
use super::robust::RobustProblem;
use crate::math::poly::{cubic_root, quadratic_ratios};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Two places that may show the same thing.
pub(super) type PlacePair = (Vector3<f64>, Vector3<f64>);

fn matrix(v: &[f64; 9]) -> Matrix3<f64> {
    Matrix3::from_row_slice(v)
}

/// Symmetric accumulation of row' row.
fn add_row(gram: &mut SMatrix<f64, 9, 9>, row: &[f64; 9], weight: f64) {
    for i in 0..9 {
        for j in 0..=i {
            gram[(i, j)] += weight * row[i] * row[j];
        }
    }
}

/// The direction in which a Gram matrix (lower half) is smallest.
fn least_direction(mut gram: SMatrix<f64, 9, 9>) -> Option<[f64; 9]> {
    gram.fill_upper_triangle_with_lower_triangle();
    if !gram.iter().all(|v| v.is_finite()) {
        return None;
    }
    let eigen = gram.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let column = eigen.eigenvectors.column(least);
    Some(core::array::from_fn(|i| column[i]))
}

/// Appends the matrices of rank two, three at most, with `b' F a = 0` for seven pairs.
pub(super) fn seven_point(pairs: [&PlacePair; 7], out: &mut Vec<Matrix3<f64>>) {
    let Some([p, q]) = null_space::<7, 2>(pairs.map(|(a, b)| epipolar_row(a, b))) else {
        return;
    };
    let (p, q) = (matrix(&p), matrix(&q));
    // det(p + x (q - p)) by its values at four places would lose digits; expand it.
    let d = q - p;
    let det3 = |a: &Matrix3<f64>, b: &Matrix3<f64>, c: &Matrix3<f64>| -> f64 {
        let column = |m: &Matrix3<f64>, i: usize| Vector3::new(m[(0, i)], m[(1, i)], m[(2, i)]);
        column(a, 0).dot(&column(b, 1).cross(&column(c, 2)))
    };
    let c0 = p.determinant();
    let c1 = det3(&d, &p, &p) + det3(&p, &d, &p) + det3(&p, &p, &d);
    let c2 = det3(&d, &d, &p) + det3(&d, &p, &d) + det3(&p, &d, &d);
    let c3 = d.determinant();
    let mut push = |x: f64| {
        let f = p + d * x;
        let norm = f.norm();
        if norm > 0.0 && norm.is_finite() {
            out.push(f / norm);
        }
    };
    let size = c0.abs() + c1.abs() + c2.abs() + c3.abs();
    if !(size > 0.0) {
        return;
    }
    if c3.abs() > 1e-12 * size {
        let x = cubic_root(c2 / c3, c1 / c3, c0 / c3);
        push(x);
        // What is left after the division by (t - x).
        let (b1, b0) = (c2 + c3 * x, c1 + (c2 + c3 * x) * x);
        for (num, den) in quadratic_ratios(c3, b1, b0).into_iter().flatten() {
            if den != 0.0 {
                push(num / den);
            }
        }
    } else {
        for (num, den) in quadratic_ratios(c2, c1, c0).into_iter().flatten() {
            if den != 0.0 {
                push(num / den);
            }
        }
    }
}

/// The fundamental matrix of eight pairs or more, least squares with weights, rank two enforced.
fn eight_point(
    pairs: &[PlacePair],
    chosen: &[usize],
    weight: impl Fn(&PlacePair) -> f64,
) -> Option<Matrix3<f64>> {
    let mut gram = SMatrix::<f64, 9, 9>::zeros();
    for i in chosen {
        let pair = &pairs[*i];
        add_row(&mut gram, &epipolar_row(&pair.0, &pair.1), weight(pair));
    }
    let f = matrix(&least_direction(gram)?);
    // Take away the smallest singular direction: F (I - v v').
    let eigen = (f.transpose() * f).symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let v: Vector3<f64> = eigen.eigenvectors.column(least).into();
    let flat = f - (f * v) * v.transpose();
    let norm = flat.norm();
    (norm > 0.0 && norm.is_finite()).then(|| flat / norm)
}

/// Fundamental matrix from places of two views.
pub(super) struct Fundamental<'a>(pub(super) &'a [PlacePair]);

impl RobustProblem for Fundamental<'_> {
    type Model = Matrix3<f64>;
    const SAMPLE: usize = 7;

    fn num_items(&self) -> usize {
        self.0.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<Matrix3<f64>>) {
        if let Ok(sample) = <[usize; 7]>::try_from(sample) {
            seven_point(sample.map(|i| &self.0[i]), out);
        }
    }

    fn error_sq(&self, model: &Matrix3<f64>, item: usize) -> f64 {
        let (a, b) = &self.0[item];
        sampson_sq(model, a, b)
    }

    fn refine(&self, model: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        if inliers.len() < 8 {
            return None;
        }
        // Weights 1 / slope turn the algebraic into the Sampson error; three rounds settle them.
        let mut f = *model;
        for _ in 0..3 {
            f = eight_point(self.0, inliers, |(a, b)| {
                let in_b = f * a;
                let (u, v) = (f.column(0).dot(b), f.column(1).dot(b));
                1.0 / (in_b.x * in_b.x + in_b.y * in_b.y + u * u + v * v).max(1e-12)
            })?;
        }
        Some(f)
    }
}

/// The two equations of `b ~ H a` for row-major `H`.
fn homography_rows((a, b): &PlacePair) -> [[f64; 9]; 2] {
    [
        [
            0.0,
            0.0,
            0.0,
            -a.x,
            -a.y,
            -a.z,
            b.y * a.x,
            b.y * a.y,
            b.y * a.z,
        ],
        [
            a.x,
            a.y,
            a.z,
            0.0,
            0.0,
            0.0,
            -b.x * a.x,
            -b.x * a.y,
            -b.x * a.z,
        ],
    ]
}

/// Homography between places of two views.
pub(super) struct Homography<'a>(pub(super) &'a [PlacePair]);

impl RobustProblem for Homography<'_> {
    type Model = Matrix3<f64>;
    const SAMPLE: usize = 4;

    fn num_items(&self) -> usize {
        self.0.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<Matrix3<f64>>) {
        let mut rows = [[0.0; 9]; 8];
        for (k, i) in sample.iter().enumerate() {
            let two = homography_rows(&self.0[*i]);
            (rows[2 * k], rows[2 * k + 1]) = (two[0], two[1]);
        }
        if let Some([h]) = null_space::<8, 1>(rows) {
            out.push(matrix(&h));
        }
    }

    fn error_sq(&self, model: &Matrix3<f64>, item: usize) -> f64 {
        transfer_sq(model, &self.0[item])
    }

    fn refine(&self, model: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let mut h = *model;
        for _ in 0..2 {
            let mut gram = SMatrix::<f64, 9, 9>::zeros();
            for i in inliers {
                let pair = &self.0[*i];
                let depth = h.row(2).transpose().dot(&pair.0);
                let weight = 1.0 / (depth * depth).max(1e-12);
                for row in homography_rows(pair) {
                    add_row(&mut gram, &row, weight);
                }
            }
            h = matrix(&least_direction(gram)?);
        }
        Some(h)
    }
}

/// Squared distance between a place of the second view and where a homography carries the other one.
fn transfer_sq(h: &Matrix3<f64>, (a, b): &PlacePair) -> f64 {
    let c = h * a;
    if !(c.z.abs() > 1e-12) {
        return f64::INFINITY;
    }
    let (dx, dy) = (c.x / c.z - b.x, c.y / c.z - b.y);
    dx * dx + dy * dy
}

/// Rotation between bearings of two views that share their centre.
pub(super) struct Turn<'a>(pub(super) &'a [PlacePair]);

impl RobustProblem for Turn<'_> {
    type Model = Matrix3<f64>;
    const SAMPLE: usize = 2;

    fn num_items(&self) -> usize {
        self.0.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<Matrix3<f64>>) {
        let frame = |p: &Vector3<f64>, q: &Vector3<f64>| -> Option<Matrix3<f64>> {
            let x = p.normalize();
            let z = x.cross(q).try_normalize(1e-9)?;
            Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
        };
        let (first, second) = (&self.0[sample[0]], &self.0[sample[1]]);
        if let (Some(a), Some(b)) = (frame(&first.0, &second.0), frame(&first.1, &second.1)) {
            out.push(b * a.transpose());
        }
    }

    fn error_sq(&self, model: &Matrix3<f64>, item: usize) -> f64 {
        transfer_sq(model, &self.0[item])
    }

    fn refine(&self, model: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        // A few Gauss-Newton steps on b x R a = 0, whose length is the sine of the angle between the two.
        let mut r = *model;
        for _ in 0..4 {
            let mut hessian = Matrix3::zeros();
            let mut gradient = Vector3::zeros();
            for i in inliers {
                let a = r * self.0[*i].0.normalize();
                let b = self.0[*i].1.normalize();
                // d(b - exp(w) a) / dw = [a]x.
                let j = a.cross_matrix();
                hessian += j.transpose() * j;
                gradient += j.transpose() * (b - a);
            }
            let step = -hessian.cholesky()?.solve(&gradient);
            r = super::relative::orthonormal(&(crate::geometry::rotation_from_vector(&step) * r));
        }
        Some(r)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_vector;
    use crate::math::Rng;
    use crate::reconstruction::relative::essential;
    use crate::reconstruction::robust::{RobustOptions, search};

    const OPTIONS: RobustOptions = RobustOptions {
        max_error_sq: 1e-5,
        max_iterations: 3_000,
        min_iterations: 20,
        confidence: 0.999,
    };

    fn views(
        rng: &mut Rng,
        n: usize,
        point: impl Fn(&mut Rng) -> Vector3<f64>,
    ) -> (Matrix3<f64>, Vector3<f64>, Vec<PlacePair>) {
        let r = rotation_from_vector(&Vector3::from_fn(|_, _| 0.15 * rng.normal()));
        let t = Vector3::from_fn(|_, _| 0.3 * rng.normal());
        let mut pairs = Vec::new();
        while pairs.len() < n {
            let p = point(rng);
            let q = r * p + t;
            if q.z > 0.3 {
                pairs.push((p / p.z, q / q.z));
            }
        }
        (r, t, pairs)
    }

    fn deep(rng: &mut Rng) -> Vector3<f64> {
        Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.5, 0.5), 1.0) * rng.range(2.0, 8.0)
    }

    #[test]
    fn seven_points_give_the_fundamental_matrix() {
        let mut rng = Rng::from_seed(3);
        for problem in 0..2_000 {
            let (r, t, pairs) = views(&mut rng, 7, deep);
            let truth = essential(&r, &t).normalize();
            let mut found = Vec::new();
            seven_point(core::array::from_fn(|i| &pairs[i]), &mut found);
            let error = found
                .iter()
                .map(|f| (f - truth).norm().min((f + truth).norm()))
                .fold(f64::INFINITY, f64::min);
            assert!(error < 1e-4, "problem {problem}: {error}");
        }
    }

    #[test]
    fn robust_fits_survive_outliers() {
        let mut rng = Rng::from_seed(4);
        for _ in 0..20 {
            let (r, t, mut pairs) = views(&mut rng, 200, deep);
            for pair in pairs.iter_mut().step_by(3) {
                pair.1 = Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.5, 0.5), 1.0);
            }
            let found = search(&Fundamental(&pairs), &OPTIONS, &mut rng).expect("found");
            // All that is right agrees; the matrix itself is ill-determined when the movement is small.
            assert!(found.inliers.len() >= 131, "{}", found.inliers.len());
            let wrong = found.inliers.iter().filter(|i| *i % 3 == 0).count();
            assert!(wrong < 10, "{wrong}");
            let e = essential(&r, &t).normalize();
            let worst = (0..200)
                .filter(|i| i % 3 != 0)
                .map(|i| sampson_sq(&e, &pairs[i].0, &pairs[i].1));
            assert!(worst.fold(0.0, f64::max) < 1e-20);

            let plane = |rng: &mut Rng| {
                let (x, y) = (rng.range(-0.6, 0.6), rng.range(-0.5, 0.5));
                Vector3::new(x, y, 1.0) * (3.0 / (1.0 + 0.3 * x - 0.2 * y))
            };
            let (_, _, mut pairs) = views(&mut rng, 200, plane);
            for pair in pairs.iter_mut().step_by(3) {
                pair.1 = Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.5, 0.5), 1.0);
            }
            let found = search(&Homography(&pairs), &OPTIONS, &mut rng).expect("found");
            assert!(found.inliers.len() >= 133, "{}", found.inliers.len());

            let (r, _, mut pairs) = views(&mut rng, 200, |rng| deep(rng) * 1e9);
            for pair in pairs.iter_mut().step_by(3) {
                pair.1 = Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.5, 0.5), 1.0);
            }
            let found = search(&Turn(&pairs), &OPTIONS, &mut rng).expect("found");
            assert!((found.model - r).norm() < 1e-6);
        }
    }
}
