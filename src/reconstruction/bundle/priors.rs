//! What is known about poses beforehand, as residuals.

use super::model::Moving;
use super::{BundleProblem, Intrinsics, Loss, PosePrior, RelativePrior};
use crate::geometry::vector_from_rotation;
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3, Vector6};

/// A prior that is off by more than this many standard deviations is believed less and less: reported poses jump.
const LOSS: Loss = Loss::Cauchy(3.0);

/// Six weighted residuals (rotation, position) with their derivatives by (turn, centre) of one or two cameras.
pub(super) struct PriorRow {
    pub(super) error: Vector6<f64>,
    pub(super) by_first: Matrix6<f64>,
    /// `None` for an absolute prior.
    pub(super) by_second: Option<Matrix6<f64>>,
    /// Loss and weight.
    pub(super) loss: (f64, f64),
}

fn stacked(turn: Vector3<f64>, shift: Vector3<f64>) -> Vector6<f64> {
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

fn blocks(turn: Matrix3<f64>, mixed: Matrix3<f64>, shift: Matrix3<f64>) -> Matrix6<f64> {
    let mut m = Matrix6::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    m.fixed_view_mut::<3, 3>(3, 0).copy_from(&mixed);
    m.fixed_view_mut::<3, 3>(3, 3).copy_from(&shift);
    m
}

pub(super) fn absolute(prior: &PosePrior, camera: &Moving) -> PriorRow {
    let given = &prior.cam_from_world;
    let turn =
        vector_from_rotation(&(camera.rotation * given.rotation.transpose())) / prior.sigma_rad;
    let shift = (camera.center - given.center_in_world()) / prior.sigma_position;
    let error = stacked(turn, shift);
    PriorRow {
        error,
        by_first: blocks(
            Matrix3::identity() / prior.sigma_rad,
            Matrix3::zeros(),
            Matrix3::identity() / prior.sigma_position,
        ),
        by_second: None,
        loss: LOSS.at(error.norm_squared()),
    }
}

pub(super) fn relative(prior: &RelativePrior, first: &Moving, second: &Moving) -> PriorRow {
    let (a, b) = &prior.cam_from_world;
    let now = second.rotation * first.rotation.transpose();
    let given = b.rotation * a.rotation.transpose();
    let turn = vector_from_rotation(&(now * given.transpose())) / prior.sigma_rad;
    // In the first camera's own axes: a world that was turned as a whole is not off.
    let was = a.rotation * (b.center_in_world() - a.center_in_world());
    let step = first.rotation * (second.center - first.center);
    let shift = (step - was) / prior.sigma_position;
    let error = stacked(turn, shift);
    PriorRow {
        error,
        by_first: blocks(
            -now / prior.sigma_rad,
            -step.cross_matrix() / prior.sigma_position,
            -first.rotation / prior.sigma_position,
        ),
        by_second: Some(blocks(
            Matrix3::identity() / prior.sigma_rad,
            Matrix3::zeros(),
            first.rotation / prior.sigma_position,
        )),
        loss: LOSS.at(error.norm_squared()),
    }
}

/// All priors of a problem, each with its cameras.
pub(super) fn prior_rows(
    problem: &BundleProblem,
    cameras: &[Moving],
) -> Vec<(usize, Option<usize>, PriorRow)> {
    let absolute = problem.pose_priors.iter().filter_map(|p| {
        let camera = cameras.get(p.camera as usize)?;
        Some((p.camera as usize, None, absolute(p, camera)))
    });
    let relative = problem.relative_priors.iter().filter_map(|p| {
        let (a, b) = (p.cameras.0 as usize, p.cameras.1 as usize);
        let row = relative(p, cameras.get(a)?, cameras.get(b)?);
        Some((a, Some(b), row))
    });
    absolute.chain(relative).collect()
}

/// Weighted errors of (ln f, k) and their slopes.
pub(super) fn intrinsics_prior(intrinsics: &Intrinsics) -> (Vector2<f64>, Vector2<f64>) {
    match &intrinsics.prior {
        None => (Vector2::zeros(), Vector2::zeros()),
        Some(prior) => {
            let off = crate::math::elementary::ln(intrinsics.focal_px / prior.focal_px);
            (
                Vector2::new(off / prior.sigma_ln, intrinsics.k / prior.sigma_k),
                Vector2::new(1.0 / prior.sigma_ln, 1.0 / prior.sigma_k),
            )
        }
    }
}
