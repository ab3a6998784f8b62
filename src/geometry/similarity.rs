//! Two worlds whose unit of length differs.

use super::{CamFromWorld, Rigid};
use nalgebra::{Matrix3, Matrix4, Vector3};

/// A turn, a shift and a change of the unit of length: `a = scale * rotation * b + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Units of the first world in one unit of the second.
    pub scale: f64,
    /// From the second world's axes to the first's.
    pub rotation: Matrix3<f64>,
    /// Where the second world's origin is in the first.
    pub translation: Vector3<f64>,
}

/// Squarings of the matrix whose largest eigenvector is looked for.
const SQUARINGS: usize = 40;

impl Similarity {
    /// The one that brings the second of each pair nearest to the first, in the sum of squares; `None` for fewer than three
    /// pairs, or points that lie in one line, about which the worlds could turn.
    ///
    /// Horn, Closed-form solution of absolute orientation using unit quaternions (1987).
    pub fn fit(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Self> {
        if pairs.len() < 3 {
            return None;
        }
        let num = pairs.len() as f64;
        let middle_a = pairs.iter().map(|p| p.0).sum::<Vector3<f64>>() / num;
        let middle_b = pairs.iter().map(|p| p.1).sum::<Vector3<f64>>() / num;
        let mut m = Matrix3::zeros();
        let (mut size_b, mut spread) = (0.0, Matrix3::zeros());
        for (a, b) in pairs {
            let (a, b) = (a - middle_a, b - middle_b);
            m += b * a.transpose();
            spread += b * b.transpose();
            size_b += b.norm_squared();
        }
        // Sum of the principal 2 x 2 minors: about zero when all lies in one line.
        let minors =
            0.5 * (spread.trace() * spread.trace() - (spread * spread).trace()) / (size_b * size_b);
        if !(minors > 1e-8) {
            return None;
        }
        let n = Matrix4::new(
            m[(0, 0)] + m[(1, 1)] + m[(2, 2)],
            m[(1, 2)] - m[(2, 1)],
            m[(2, 0)] - m[(0, 2)],
            m[(0, 1)] - m[(1, 0)],
            m[(1, 2)] - m[(2, 1)],
            m[(0, 0)] - m[(1, 1)] - m[(2, 2)],
            m[(0, 1)] + m[(1, 0)],
            m[(2, 0)] + m[(0, 2)],
            m[(2, 0)] - m[(0, 2)],
            m[(0, 1)] + m[(1, 0)],
            m[(1, 1)] - m[(0, 0)] - m[(2, 2)],
            m[(1, 2)] + m[(2, 1)],
            m[(0, 1)] - m[(1, 0)],
            m[(2, 0)] + m[(0, 2)],
            m[(1, 2)] + m[(2, 1)],
            m[(2, 2)] - m[(0, 0)] - m[(1, 1)],
        );
        // All eigenvalues above zero, so that the largest one wins.
        let mut power = n + Matrix4::identity() * n.norm();
        for _ in 0..SQUARINGS {
            power /= power.norm();
            power *= power;
        }
        let longest = (0..4).max_by(|x, y| {
            let length = |c: usize| power.column(c).norm_squared();
            length(*x).total_cmp(&length(*y))
        })?;
        let q = power.column(longest);
        if !(q.norm() > 0.0) {
            return None;
        }
        let q = q / q.norm();
        let rotation =
            Rigid::<(), ()>::from_quaternion_wxyz([q[0], q[1], q[2], q[3]], Vector3::zeros())
                .rotation;
        // The trace of rotation * b * a' over all pairs.
        let along = (rotation * m).trace();
        let scale = along / size_b;
        (scale > 0.0).then(|| Self {
            scale,
            rotation,
            translation: middle_a - rotation * middle_b * scale,
        })
    }

    /// A place of the second world in the first.
    pub fn transform_point(&self, b: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * b * self.scale + self.translation
    }

    /// From the first world to the second.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            scale: 1.0 / self.scale,
            rotation,
            translation: -(rotation * self.translation) / self.scale,
        }
    }

    /// A camera of the second world in the first.
    pub fn transform_pose(&self, cam_from_b: &CamFromWorld) -> CamFromWorld {
        let rotation = cam_from_b.rotation * self.rotation.transpose();
        CamFromWorld::new(
            rotation,
            cam_from_b.translation * self.scale - rotation * self.translation,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_vector;
    use crate::math::Rng;

    #[test]
    fn what_was_moved_is_moved_back() {
        for seed in 0..200 {
            let mut rng = Rng::from_seed(seed);
            let mut vector = |size: f64| Vector3::from_fn(|_, _| size * rng.normal());
            let truth = Similarity {
                scale: 0.2 + vector(1.0).norm(),
                rotation: rotation_from_vector(&vector(1.5)),
                translation: vector(4.0),
            };
            let count = 3 + seed as usize % 5;
            let pairs: Vec<_> = (0..count)
                .map(|_| {
                    let b = vector(2.0);
                    (truth.transform_point(&b), b)
                })
                .collect();
            let found = Similarity::fit(&pairs).expect("three and more");
            assert!((found.scale / truth.scale - 1.0).abs() < 1e-9);
            assert!((found.rotation - truth.rotation).norm() < 1e-7);
            assert!((found.translation - truth.translation).norm() < 1e-7);
            let back = found.inverse();
            let camera = CamFromWorld::new(rotation_from_vector(&vector(1.0)), vector(1.0));
            let moved = truth.transform_pose(&camera);
            for (a, b) in &pairs {
                assert!((back.transform_point(a) - b).norm() < 1e-7);
                let seen = moved.transform_point(a) / truth.scale;
                assert!((seen - camera.transform_point(b)).norm() < 1e-7);
            }
        }
    }

    #[test]
    fn a_line_or_two_points_do_not_say_how_a_world_is_turned() {
        let line: Vec<_> = (0..9)
            .map(|i| Vector3::new(f64::from(i), 2.0 * f64::from(i), 1.0))
            .map(|p| (p, p))
            .collect();
        assert_eq!(Similarity::fit(&line), None);
        assert_eq!(Similarity::fit(&line[..2]), None);
        assert_eq!(
            Similarity::fit(&[(Vector3::zeros(), Vector3::zeros()); 5]),
            None
        );
    }
}
