//! Rigid transforms whose type says which space they map from and to.

use core::marker::PhantomData;
use core::ops::Mul;
use nalgebra::{Matrix3, Matrix4, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Camera space: x right, y down, z forward.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cam {}
/// World space: as the data set gives it, right-handed, metres when metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {}

/// `x_in_to = rotation * x_in_from + translation`.
#[derive(Debug)]
pub struct Rigid<To, From> {
    /// Orthonormal, determinant +1.
    pub rotation: Matrix3<f64>,
    /// In the units of `To`.
    pub translation: Vector3<f64>,
    spaces: PhantomData<(To, From)>,
}

/// What pose solvers produce: maps a world point into camera space.
pub type CamFromWorld = Rigid<Cam, World>;
/// Its inverse; the translation is the position of the camera.
pub type WorldFromCam = Rigid<World, Cam>;

impl<To, From> Clone for Rigid<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<To, From> Copy for Rigid<To, From> {}
impl<To, From> PartialEq for Rigid<To, From> {
    fn eq(&self, other: &Self) -> bool {
        self.rotation == other.rotation && self.translation == other.translation
    }
}

impl<To, From> Rigid<To, From> {
    /// From a rotation that the caller knows to be orthonormal.
    pub fn new(rotation: Matrix3<f64>, translation: Vector3<f64>) -> Self {
        Self {
            rotation,
            translation,
            spaces: PhantomData,
        }
    }

    /// No rotation, no translation.
    pub fn identity() -> Self {
        Self::new(Matrix3::identity(), Vector3::zeros())
    }

    /// From a quaternion in the order w, x, y, z (normalised here) and a translation.
    pub fn from_quaternion_wxyz(wxyz: [f64; 4], translation: Vector3<f64>) -> Self {
        let [w, x, y, z] = wxyz;
        let unit = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Self::new(unit.to_rotation_matrix().into_inner(), translation)
    }

    /// The rotation as a unit quaternion w, x, y, z with w >= 0.
    pub fn quaternion_wxyz(&self) -> [f64; 4] {
        let q =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        let s = if q.w < 0.0 { -1.0 } else { 1.0 };
        [s * q.w, s * q.i, s * q.j, s * q.k]
    }

    /// The transform in the other direction.
    pub fn inverse(&self) -> Rigid<From, To> {
        let rt = self.rotation.transpose();
        Rigid::new(rt, -(rt * self.translation))
    }

    /// Maps a point.
    pub fn transform_point(&self, point_in_from: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_in_from + self.translation
    }

    /// Row-major 4x4 matrix.
    pub fn to_row_major(&self) -> [f64; 16] {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        let mut out = [0.0; 16];
        for (i, v) in out.iter_mut().enumerate() {
            *v = m[(i / 4, i % 4)];
        }
        out
    }

    /// Angle between the two rotations in radians.
    pub fn rotation_angle_to(&self, other: &Self) -> f64 {
        let d = self.rotation * other.rotation.transpose();
        // atan2 of the sine and cosine stays exact near 0 and near pi, where acos of the trace alone does not.
        let sin = 0.5
            * Vector3::new(
                d[(2, 1)] - d[(1, 2)],
                d[(0, 2)] - d[(2, 0)],
                d[(1, 0)] - d[(0, 1)],
            )
            .norm();
        libm::atan2(sin, 0.5 * (d.trace() - 1.0))
    }
}

/// Rotation by the vector's length (radians) about its direction: the exponential map of SO(3).
pub fn rotation_from_vector(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle_sq = w.norm_squared();
    let angle = angle_sq.sqrt();
    let k = w.cross_matrix();
    // Below 1e-4 rad the series is exact to rounding.
    let (a, b) = if angle < 1e-4 {
        (1.0 - angle_sq / 6.0, 0.5 - angle_sq / 24.0)
    } else {
        let half = libm::sin(0.5 * angle);
        (libm::sin(angle) / angle, 2.0 * half * half / angle_sq)
    };
    Matrix3::identity() + k * a + k * k * b
}

/// Rotation vector of a rotation matrix, length at most pi: the logarithm of SO(3).
pub fn vector_from_rotation(r: &Matrix3<f64>) -> Vector3<f64> {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*r));
    let v = Vector3::new(q.i, q.j, q.k) * if q.w < 0.0 { -1.0 } else { 1.0 };
    let sin_half = v.norm();
    if sin_half < 1e-9 {
        return v * 2.0;
    }
    v * (2.0 * libm::atan2(sin_half, q.w.abs()) / sin_half)
}

impl CamFromWorld {
    /// Position of the camera in the world.
    pub fn center_in_world(&self) -> Vector3<f64> {
        -(self.rotation.transpose() * self.translation)
    }

    /// Where the picture's upper edge points in the world, of unit length.
    pub fn up_in_world(&self) -> Vector3<f64> {
        -self.rotation.row(1).transpose()
    }

    /// Pose error as the field reports it: distance of the camera positions and angle of the rotations (radians).
    pub fn error_to(&self, truth: &Self) -> (f64, f64) {
        (
            (self.center_in_world() - truth.center_in_world()).norm(),
            self.rotation_angle_to(truth),
        )
    }
}

impl<A, B, C> Mul<Rigid<B, C>> for Rigid<A, B> {
    type Output = Rigid<A, C>;

    fn mul(self, right: Rigid<B, C>) -> Rigid<A, C> {
        Rigid::new(
            self.rotation * right.rotation,
            self.rotation * right.translation + self.translation,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_the_transform() {
        let a =
            CamFromWorld::from_quaternion_wxyz([0.9, 0.1, -0.3, 0.2], Vector3::new(1.0, -2.0, 0.5));
        let p = Vector3::new(0.3, 4.0, -1.0);
        let back = a.inverse().transform_point(&a.transform_point(&p));
        assert!((back - p).norm() < 1e-14);
        assert!((a * a.inverse()).rotation_angle_to(&Rigid::identity()) < 1e-14);
        assert!((a.center_in_world() - a.inverse().translation).norm() < 1e-15);
    }

    #[test]
    fn rotation_vectors_round_trip() {
        for w in [
            Vector3::new(0.3, -0.2, 0.9),
            Vector3::new(1e-6, 2e-6, -1e-6),
            Vector3::new(0.0, 3.1, 0.0),
            Vector3::zeros(),
        ] {
            let r = rotation_from_vector(&w);
            assert!((r * r.transpose() - Matrix3::identity()).amax() < 1e-14);
            assert!((vector_from_rotation(&r) - w).norm() < 1e-12);
        }
    }

    #[test]
    fn quaternion_round_trip() {
        let a = CamFromWorld::from_quaternion_wxyz([-0.9, 0.1, -0.3, 0.2], Vector3::zeros());
        let b = CamFromWorld::from_quaternion_wxyz(a.quaternion_wxyz(), Vector3::zeros());
        assert!(a.rotation_angle_to(&b) < 1e-14);
        assert!(a.quaternion_wxyz()[0] > 0.0);
    }
}
