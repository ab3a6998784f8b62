//! One observation: error and derivatives.

use super::Intrinsics;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

/// Nearer than this a point is not in front of a camera.
const MIN_DEPTH: f64 = 1e-6;

/// A camera as the adjustment moves it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moving {
    pub(super) rotation: Matrix3<f64>,
    pub(super) center: Vector3<f64>,
}

/// Error of one observation with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Linear {
    pub(super) error: Vector2<f64>,
    /// By the rotation vector on the left.
    pub(super) by_turn: Matrix2x3<f64>,
    /// By the point; the derivative by the centre is its negative.
    pub(super) by_point: Matrix2x3<f64>,
    /// By (ln f, k).
    pub(super) by_intrinsics: Matrix2<f64>,
}

/// Seen minus observed; `None` behind the camera.
pub(super) fn error(
    camera: &Moving,
    intrinsics: &Intrinsics,
    point: &Vector3<f64>,
    place: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let x = camera.rotation * (point - camera.center);
    if !(x.z > MIN_DEPTH) {
        return None;
    }
    let p = Vector2::new(x.x / x.z, x.y / x.z);
    let factor = intrinsics.focal_px * (1.0 + intrinsics.k * p.norm_squared());
    Some(p * factor - place)
}

/// [`error`] with derivatives.
pub(super) fn linear(
    camera: &Moving,
    intrinsics: &Intrinsics,
    point: &Vector3<f64>,
    place: &Vector2<f64>,
) -> Option<Linear> {
    let x = camera.rotation * (point - camera.center);
    if !(x.z > MIN_DEPTH) {
        return None;
    }
    let inverse = 1.0 / x.z;
    let p = Vector2::new(x.x * inverse, x.y * inverse);
    let r_sq = p.norm_squared();
    let (f, k) = (intrinsics.focal_px, intrinsics.k);
    let seen = p * (f * (1.0 + k * r_sq));
    let (a, b) = (f * (1.0 + k * r_sq), 2.0 * f * k);
    let by_plane = Matrix2::new(
        a + b * p.x * p.x,
        b * p.x * p.y,
        b * p.x * p.y,
        a + b * p.y * p.y,
    );
    let plane_by_cam = Matrix2x3::new(inverse, 0.0, -p.x * inverse, 0.0, inverse, -p.y * inverse);
    let by_cam = by_plane * plane_by_cam;
    let radial = p * (f * r_sq);
    Some(Linear {
        error: seen - place,
        by_turn: -by_cam * x.cross_matrix(),
        by_point: by_cam * camera.rotation,
        by_intrinsics: Matrix2::new(seen.x, radial.x, seen.y, radial.y),
    })
}
