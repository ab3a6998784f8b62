//! What is known besides the correspondences: gravity, a prior pose, a guess of the focal length.

use super::normal::Normal;
use super::problem::Model;
use super::residuals::Row;
use crate::geometry::vector_from_rotation;
use crate::math::elementary::ln;
use nalgebra::{Matrix3, Matrix6, SVector, Vector3};

/// What is known besides the correspondences.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Soft {
    /// (unit gravity in the camera, unit gravity in the world, sigma in radians)
    pub(super) gravity: Option<(Vector3<f64>, Vector3<f64>, f64)>,
    /// Prior model and the information matrix of its (rotation, normalised translation).
    pub(super) prior: Option<(Model, Matrix6<f64>)>,
    /// Standard deviation of ln focal; the focal length is fixed when `None`.
    pub(super) sigma_ln_focal: Option<f64>,
}

/// Residuals of gravity, prior pose and focal length.
pub(super) fn add_soft(n: &mut Normal, model: &Model, soft: &Soft) {
    if let Some((in_cam, in_world, sigma)) = &soft.gravity {
        for (r, row) in gravity_residuals(model, in_cam, in_world, *sigma) {
            n.add_residual(&row, r);
        }
    }
    if let Some((prior, information)) = &soft.prior {
        let (xi, jacobian) = prior_residual(model, prior);
        let h = jacobian.transpose() * information * jacobian;
        let g = jacobian.transpose() * information * xi;
        for i in 0..6 {
            n.g[i] += g[i];
            for j in i..6 {
                n.h[(i, j)] += h[(i, j)];
            }
        }
        n.cost += 0.5 * xi.dot(&(information * xi));
    }
    if let Some(sigma) = soft.sigma_ln_focal {
        let mut row = [0.0; 7];
        row[6] = 1.0 / sigma;
        n.add_residual(&row, ln(model.focal) / sigma);
    }
}

/// Components of the world's gravity, seen by the camera, that are normal to the measured one.
fn gravity_residuals(
    model: &Model,
    in_cam: &Vector3<f64>,
    in_world: &Vector3<f64>,
    sigma: f64,
) -> [(f64, Row); 2] {
    let seen = model.rotation * in_world;
    let axis = if in_cam.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let b1 = in_cam.cross(&axis).normalize();
    let b2 = in_cam.cross(&b1);
    [b1, b2].map(|b| {
        let j = seen.cross(&b) / sigma;
        (b.dot(&seen) / sigma, [j.x, j.y, j.z, 0.0, 0.0, 0.0, 0.0])
    })
}

/// Logarithm of model * prior^-1 (rotation vector, translation) and its derivative.
fn prior_residual(model: &Model, prior: &Model) -> (SVector<f64, 6>, Matrix6<f64>) {
    let turn = model.rotation * prior.rotation.transpose();
    let w = vector_from_rotation(&turn);
    let v = model.translation - turn * prior.translation;
    let angle = w.norm();
    let k = w.cross_matrix();
    let second = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        let (s, c) = (
            crate::math::elementary::sin(angle),
            crate::math::elementary::cos(angle),
        );
        1.0 / (angle * angle) - (1.0 + c) / (2.0 * angle * s)
    };
    let left_inverse = Matrix3::identity() - k * 0.5 + k * k * second;
    let mut jacobian = Matrix6::identity();
    jacobian
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&left_inverse);
    jacobian
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(-v.cross_matrix()));
    let xi = SVector::<f64, 6>::from_iterator(w.iter().chain(v.iter()).copied());
    (xi, jacobian)
}

#[cfg(test)]
mod tests {
    use super::super::residuals;
    use super::*;
    use crate::geometry::rotation_from_vector;
    use crate::math::Rng;

    fn model(rng: &mut Rng) -> Model {
        let mut v = || Vector3::from_fn(|_, _| rng.normal());
        Model {
            rotation: rotation_from_vector(&v()),
            translation: v(),
            focal: 1.2,
        }
    }

    #[test]
    fn soft_jacobians_agree_with_central_differences() {
        let mut rng = Rng::from_seed(31);
        for _ in 0..100 {
            let m = model(&mut rng);
            let prior = residuals::perturbed(&m, &[0.1, -0.2, 0.15, 0.3, 0.2, -0.1, 0.0]);
            let g_cam = Vector3::new(0.1, 0.9, -0.2).normalize();
            let g_world = m.rotation.transpose() * Vector3::new(0.2, 0.85, -0.1).normalize();
            let rows = gravity_residuals(&m, &g_cam, &g_world, 0.02);
            let (_, jacobian) = prior_residual(&m, &prior);
            let h = 1e-6;
            for c in 0..6 {
                let mut step = [0.0; 7];
                step[c] = h;
                let up = residuals::perturbed(&m, &step);
                step[c] = -h;
                let down = residuals::perturbed(&m, &step);
                for (k, row) in rows.iter().enumerate() {
                    let at = |m: &Model| gravity_residuals(m, &g_cam, &g_world, 0.02)[k].0;
                    let numeric = (at(&up) - at(&down)) / (2.0 * h);
                    assert!((numeric - row.1[c]).abs() < 1e-6 * (1.0 + numeric.abs()));
                }
                let numeric =
                    (prior_residual(&up, &prior).0 - prior_residual(&down, &prior).0) / (2.0 * h);
                assert!((numeric - jacobian.column(c)).amax() < 1e-6);
            }
        }
    }
}
