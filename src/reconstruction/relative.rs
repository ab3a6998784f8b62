//! Relative pose of two views: essential matrix, Sampson error, refinement on the manifold, choice by cheirality.
//!
//! `b_from_a` maps a point of the first camera into the second; its translation has unit length because two views have no
//! scale. Places are homogeneous on the plane z = 1.

use crate::geometry::rotation_from_vector;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// `[t]x R`: maps a place of the first view to its epipolar line in the second.
pub(super) fn essential(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Matrix3<f64> {
    translation.cross_matrix() * rotation
}

/// Squared Sampson distance of a pair from the epipolar geometry `b' m a = 0`, in the squared unit of the places.
pub(super) fn sampson_sq(m: &Matrix3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let in_b = m * a;
    let product = b.dot(&in_b);
    let (u, v) = (m.column(0).dot(b), m.column(1).dot(b));
    let slope = in_b.x * in_b.x + in_b.y * in_b.y + u * u + v * v;
    if slope > 0.0 {
        product * product / slope
    } else {
        f64::INFINITY
    }
}

/// A relative pose without scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RelativePose {
    pub(super) rotation: Matrix3<f64>,
    /// Of unit length.
    pub(super) translation: Vector3<f64>,
}

impl RelativePose {
    pub(super) fn essential(&self) -> Matrix3<f64> {
        essential(&self.rotation, &self.translation)
    }

    /// Depths along the two places (z in either camera) of the point where their rays come closest; `None` when they are parallel.
    pub(super) fn depths(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> Option<(f64, f64)> {
        // lambda_b b = lambda_a R a + t, least squares.
        let ra = self.rotation * a;
        let (aa, ab, bb) = (ra.norm_squared(), ra.dot(b), b.norm_squared());
        let det = aa * bb - ab * ab;
        if !(det > 1e-14 * aa * bb) {
            return None;
        }
        let (at, bt) = (ra.dot(&self.translation), b.dot(&self.translation));
        Some(((ab * bt - bb * at) / det, (aa * bt - ab * at) / det))
    }

    /// Angle between the rays of a pair in radians.
    pub(super) fn parallax(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let ra = self.rotation * a;
        crate::math::elementary::atan2(ra.cross(b).norm(), ra.dot(b))
    }
}

/// The four poses of an essential matrix, in closed form (Horn 1990); empty when the matrix is not of rank two.
pub(super) fn poses_from_essential(e: &Matrix3<f64>) -> Vec<RelativePose> {
    let (x, y, z) = (e.column(0), e.column(1), e.column(2));
    let crosses = [x.cross(&y), y.cross(&z), z.cross(&x)];
    let longest = crosses.iter().fold(crosses[0], |best, c| {
        if c.norm_squared() > best.norm_squared() {
            *c
        } else {
            best
        }
    });
    // E E' = |t|^2 I - t t', so trace = 2 |t|^2.
    let scale = (0.5 * e.norm_squared()).sqrt();
    let norm = longest.norm();
    if !(norm > 1e-12 * scale * scale && scale > 0.0) {
        return Vec::new();
    }
    let t = longest / norm;
    let unit = e / scale;
    let cofactors = Matrix3::from_columns(&[
        unit.column(1).cross(&unit.column(2)),
        unit.column(2).cross(&unit.column(0)),
        unit.column(0).cross(&unit.column(1)),
    ]);
    let mut poses = Vec::with_capacity(4);
    for sign in [1.0, -1.0] {
        // E = [t]x R: R = cof(E) - [t]x E for either sign of t.
        let r = cofactors - (sign * t).cross_matrix() * unit;
        let rotation = orthonormal(&r);
        poses.push(RelativePose {
            rotation,
            translation: t,
        });
        poses.push(RelativePose {
            rotation,
            translation: -t,
        });
    }
    poses
}

/// The rotation next to a matrix that nearly is one (Gram and Schmidt).
pub(super) fn orthonormal(r: &Matrix3<f64>) -> Matrix3<f64> {
    let x: Vector3<f64> = r.row(0).transpose().normalize();
    let y: Vector3<f64> = r.row(1).transpose();
    let y = (y - x * x.dot(&y)).normalize();
    Matrix3::from_rows(&[x.transpose(), y.transpose(), x.cross(&y).transpose()])
}

/// The pose of the four that puts most pairs before both cameras, with their number.
pub(super) fn choose_by_cheirality(
    e: &Matrix3<f64>,
    pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + Clone,
) -> Option<(RelativePose, usize)> {
    let mut best: Option<(RelativePose, usize)> = None;
    for pose in poses_from_essential(e) {
        let num = pairs
            .clone()
            .filter(|(a, b)| {
                pose.depths(a, b)
                    .is_some_and(|(za, zb)| za > 0.0 && zb > 0.0)
            })
            .count();
        if best.is_none_or(|(_, most)| num > most) {
            best = Some((pose, num));
        }
    }
    best
}

/// Moves a pose to less Sampson error: Gauss-Newton on rotation and direction with truncated weights. `None` when the pairs
/// do not determine it.
pub(super) fn refine_pose(
    start: &RelativePose,
    pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + Clone,
    sigma_sq: f64,
    steps: usize,
) -> Option<RelativePose> {
    let mut pose = *start;
    for _ in 0..steps {
        let e = pose.essential();
        let t = pose.translation;
        let u = if t.x.abs() < 0.7 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let u = t.cross(&u).normalize();
        let v = t.cross(&u);
        let mut hessian = SMatrix::<f64, 5, 5>::zeros();
        let mut gradient = SVector::<f64, 5>::zeros();
        for (a, b) in pairs.clone() {
            let in_b = e * a;
            let (p, q) = (e.column(0).dot(&b), e.column(1).dot(&b));
            let slope = in_b.x * in_b.x + in_b.y * in_b.y + p * p + q * q;
            if !(slope > 0.0) {
                continue;
            }
            let product = b.dot(&in_b);
            let weight = 1.0 / (slope * (1.0 + product * product / (slope * sigma_sq)));
            let y = pose.rotation * a;
            let by_turn = y.cross(&b.cross(&t));
            let by_shift = y.cross(&b);
            let j = SVector::<f64, 5>::new(
                by_turn.x,
                by_turn.y,
                by_turn.z,
                u.dot(&by_shift),
                v.dot(&by_shift),
            );
            hessian += j * j.transpose() * weight;
            gradient += j * (product * weight);
        }
        let damping = 1e-13 * hessian.trace();
        for i in 0..5 {
            hessian[(i, i)] += damping;
        }
        let step = -hessian.cholesky()?.solve(&gradient);
        pose.rotation = orthonormal(
            &(rotation_from_vector(&Vector3::new(step[0], step[1], step[2])) * pose.rotation),
        );
        pose.translation = (t + u * step[3] + v * step[4]).normalize();
        if !(step.norm_squared() > 1e-20) {
            break;
        }
    }
    let is_finite = pose
        .rotation
        .iter()
        .chain(pose.translation.iter())
        .all(|v| v.is_finite());
    is_finite.then_some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    fn random_pose(rng: &mut Rng) -> RelativePose {
        RelativePose {
            rotation: rotation_from_vector(&Vector3::from_fn(|_, _| 0.3 * rng.normal())),
            translation: Vector3::from_fn(|_, _| rng.normal()).normalize(),
        }
    }

    fn pairs(
        pose: &RelativePose,
        n: usize,
        sigma: f64,
        rng: &mut Rng,
    ) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let mut out = Vec::new();
        while out.len() < n {
            let p =
                Vector3::new(rng.range(-0.7, 0.7), rng.range(-0.5, 0.5), 1.0) * rng.range(2.0, 8.0);
            let q = pose.rotation * p + pose.translation;
            if q.z < 0.5 {
                continue;
            }
            let noise =
                |rng: &mut Rng| Vector3::new(sigma * rng.normal(), sigma * rng.normal(), 0.0);
            out.push((p / p.z + noise(rng), q / q.z + noise(rng)));
        }
        out
    }

    #[test]
    fn the_pose_of_an_essential_matrix_is_the_one_it_was_made_of() {
        let mut rng = Rng::from_seed(1);
        for _ in 0..500 {
            let truth = random_pose(&mut rng);
            let seen = pairs(&truth, 12, 0.0, &mut rng);
            let e = truth.essential() * rng.range(-3.0, 3.0);
            let (pose, num) = choose_by_cheirality(&e, seen.iter().copied()).expect("rank two");
            assert_eq!(num, 12);
            assert!((pose.rotation - truth.rotation).norm() < 1e-9);
            assert!((pose.translation - truth.translation).norm() < 1e-9);
            for (a, b) in &seen {
                assert!(sampson_sq(&pose.essential(), a, b) < 1e-18);
                let (za, zb) = pose.depths(a, b).expect("not parallel");
                assert!((pose.rotation * a * za + pose.translation - b * zb).norm() < 1e-9);
            }
        }
        assert!(poses_from_essential(&Matrix3::zeros()).is_empty());
    }

    #[test]
    fn refinement_reaches_the_least_squares_pose() {
        let mut rng = Rng::from_seed(2);
        for _ in 0..50 {
            let truth = random_pose(&mut rng);
            let seen = pairs(&truth, 60, 1e-4, &mut rng);
            let start = RelativePose {
                rotation: rotation_from_vector(&Vector3::from_fn(|_, _| 0.02 * rng.normal()))
                    * truth.rotation,
                translation: (truth.translation + Vector3::from_fn(|_, _| 0.05 * rng.normal()))
                    .normalize(),
            };
            let cost = |p: &RelativePose| -> f64 {
                let e = p.essential();
                seen.iter().map(|(a, b)| sampson_sq(&e, a, b)).sum()
            };
            let found = refine_pose(&start, seen.iter().copied(), 1.0, 10).expect("determined");
            // The truth has the noise's own cost; the minimum has less.
            assert!(cost(&found) <= cost(&truth) * (1.0 + 1e-9));
            assert!((found.rotation - truth.rotation).norm() < 5e-3);
        }
    }
}
