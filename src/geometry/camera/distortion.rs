//! Distortion of the image plane and its inverse.

use super::CameraModel;
use nalgebra::Vector2;

impl CameraModel {
    /// Ideal image coordinates (z = 1 plane, or angle-scaled direction for the fisheye) to distorted ones, with the
    /// Jacobian in row-major order.
    pub(super) fn distort(&self, p: Vector2<f64>) -> (Vector2<f64>, [f64; 4]) {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = |k1: f64, k2: f64| {
            let s = 1.0 + r2 * (k1 + r2 * k2);
            let ds = 2.0 * (k1 + 2.0 * r2 * k2);
            (s, ds)
        };
        match *self {
            Self::SimplePinhole { .. } | Self::Pinhole { .. } => (p, [1.0, 0.0, 0.0, 1.0]),
            Self::SimpleRadial { k, .. } => radial_jacobian(x, y, radial(k, 0.0)),
            Self::Radial { k1, k2, .. } => radial_jacobian(x, y, radial(k1, k2)),
            Self::OpenCv { k1, k2, p1, p2, .. } => {
                let (d, j) = radial_jacobian(x, y, radial(k1, k2));
                let tangential = Vector2::new(
                    2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                );
                (
                    d + tangential,
                    [
                        j[0] + 2.0 * p1 * y + 6.0 * p2 * x,
                        j[1] + 2.0 * p1 * x + 2.0 * p2 * y,
                        j[2] + 2.0 * p1 * x + 2.0 * p2 * y,
                        j[3] + 6.0 * p1 * y + 2.0 * p2 * x,
                    ],
                )
            }
            Self::OpenCvFisheye { k1, k2, k3, k4, .. } => {
                // p = theta * direction here, so the polynomial is radial in theta.
                let s = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
                let ds = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4)));
                radial_jacobian(x, y, (s, ds))
            }
        }
    }

    pub(super) fn is_fisheye(&self) -> bool {
        matches!(self, Self::OpenCvFisheye { .. })
    }

    /// Inverse of [`Self::distort`]; `None` where it does not converge onto the branch that starts at the centre.
    pub(super) fn undistort(&self, distorted: Vector2<f64>) -> Option<Vector2<f64>> {
        if matches!(self, Self::SimplePinhole { .. } | Self::Pinhole { .. }) {
            return Some(distorted);
        }
        let mut p = distorted;
        for _ in 0..50 {
            let (d, j) = self.distort(p);
            let e = d - distorted;
            let det = j[0] * j[3] - j[1] * j[2];
            if !(det > 0.0) {
                // Beyond the fold of the polynomial: move back towards the centre and try again.
                p *= 0.7;
                continue;
            }
            let step = Vector2::new(
                (j[3] * e.x - j[1] * e.y) / det,
                (j[0] * e.y - j[2] * e.x) / det,
            );
            p -= step;
            if step.norm_squared() < 1e-26 * (1.0 + p.norm_squared()) {
                let (back, j) = self.distort(p);
                let is_on_branch = j[0] * j[3] - j[1] * j[2] > 0.0;
                return (is_on_branch && (back - distorted).norm() < 1e-9).then_some(p);
            }
        }
        None
    }
}

fn radial_jacobian(x: f64, y: f64, (s, ds): (f64, f64)) -> (Vector2<f64>, [f64; 4]) {
    (
        Vector2::new(s * x, s * y),
        [s + ds * x * x, ds * x * y, ds * x * y, s + ds * y * y],
    )
}
