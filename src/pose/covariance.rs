//! How well a pose is known, and whether it is known at all.
//!
//! The covariance is the inverse of the weighted normal matrix at the optimum, times a factor for what the noise model leaves
//! out. A direction without information shows as a standard deviation beyond the scene; the structure of the inliers then
//! names the reason.

use super::normal::Matrix7;
use super::problem::{Model, Problem};
use super::refine::Refined;
use super::residuals;
use super::types::Degeneracy;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// The reweighted normal matrix of a bivariate Student-t exceeds its Fisher information by (tail + 4) / (tail + 2).
const OPTIMISM: f64 = 1.36;

/// A rotation known worse than this (radians), or a position known worse than this share of the scene scale, is not known.
const MAX_SIGMA_RAD: f64 = 0.15;
const MAX_SIGMA_SCALE: f64 = 0.3;

/// A focal length known worse than this (ln) is not known.
const MAX_SIGMA_LN_FOCAL: f64 = 0.04;

/// Uncertainty in the units of the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct Uncertainty {
    pub(super) covariance: Matrix6<f64>,
    pub(super) sigma_rad: f64,
    pub(super) sigma_m: f64,
    pub(super) sigma_ln_focal: f64,
    pub(super) degeneracy: Option<Degeneracy>,
}

/// Largest eigenvalue of a symmetric matrix.
fn largest_eigenvalue(m: &Matrix3<f64>) -> f64 {
    m.symmetric_eigenvalues().max()
}

pub(super) fn uncertainty(
    problem: &Problem,
    refined: &Refined,
    has_focal: bool,
    inlier_limit_px: (f64, f64),
) -> Uncertainty {
    let mut h: Matrix7 = refined.normal.h;
    if !has_focal {
        h.fill_row(6, 0.0);
        h.fill_column(6, 0.0);
        h[(6, 6)] = 1.0;
    }
    let inverse = h.cholesky().map(|c| c.inverse() * OPTIMISM);
    let is_usable = |m: &Matrix7| m.iter().all(|v| v.is_finite());
    let Some(normalized) = inverse.filter(is_usable) else {
        return Uncertainty {
            covariance: Matrix6::from_diagonal_element(f64::MAX.sqrt()),
            sigma_rad: core::f64::consts::PI,
            sigma_m: f64::MAX.sqrt(),
            sigma_ln_focal: if has_focal { f64::MAX.sqrt() } else { 0.0 },
            degeneracy: Some(name(problem, &refined.model, inlier_limit_px)),
        };
    };
    let turn: Matrix3<f64> = normalized.fixed_view::<3, 3>(0, 0).into_owned();
    let shift: Matrix3<f64> = normalized.fixed_view::<3, 3>(3, 3).into_owned();
    let sigma_rad = largest_eigenvalue(&turn).max(0.0).sqrt();
    let sigma = largest_eigenvalue(&shift).max(0.0).sqrt();
    let sigma_ln_focal = if has_focal {
        normalized[(6, 6)].max(0.0).sqrt()
    } else {
        0.0
    };
    let degeneracy = if has_focal && !(sigma_ln_focal < MAX_SIGMA_LN_FOCAL) {
        Some(Degeneracy::FocalUndetermined)
    } else if !(sigma_rad < MAX_SIGMA_RAD && sigma < MAX_SIGMA_SCALE) {
        Some(name(problem, &refined.model, inlier_limit_px))
    } else {
        None
    };
    let s = problem.scale;
    let covariance = Matrix6::from_fn(|i, j| {
        let unit = |k: usize| if k < 3 { 1.0 } else { s };
        normalized[(i, j)] * unit(i) * unit(j)
    });
    Uncertainty {
        covariance,
        sigma_rad,
        sigma_m: sigma * s,
        sigma_ln_focal,
        degeneracy,
    }
}

/// Smallest share of the largest eigenvalue at which a structure extends in a second (or third) direction.
const FLAT: f64 = 1e-5;

/// What leaves the pose undetermined whichever correspondences are right: no minimal sample of them has a solution.
pub(super) fn of_input(problem: &Problem) -> Option<Degeneracy> {
    let sorted = |m: Matrix3<f64>| {
        let mut values = m.symmetric_eigenvalues();
        values.as_mut_slice().sort_unstable_by(f64::total_cmp);
        values
    };
    let count = problem.points.len().max(1) as f64;
    let mean = problem.points.iter().map(|p| p.x).sum::<Vector3<f64>>() / count;
    let offsets = problem.points.iter().map(|p| p.x - mean);
    let spread = sorted(offsets.map(|d| d * d.transpose()).sum());
    let is_collinear = !(spread[1] > FLAT * spread[2]);
    let directions = problem.lines.iter().map(|l| l.direction);
    let turn = sorted(directions.map(|d| d * d.transpose()).sum());
    let is_parallel = !(turn[1] > FLAT * turn[2]);
    // The viewing planes of a room corner, or of lines towards one vanishing point, share a ray.
    let normals = problem.lines.iter().map(|l| problem.plane_normal(l, 1.0));
    let tilt = sorted(normals.map(|n| n * n.transpose()).sum());
    let is_star = !(tilt[0] > FLAT * tilt[2]);
    match (problem.points.is_empty(), problem.lines.is_empty()) {
        (_, true) => is_collinear.then_some(Degeneracy::Collinear),
        (true, false) => (is_parallel || is_star).then_some(Degeneracy::LineDirections),
        (false, false) => None,
    }
}

/// Which structure of the inliers leaves the pose undetermined.
fn name(problem: &Problem, model: &Model, (max_point, max_line): (f64, f64)) -> Degeneracy {
    let (fx, fy) = (problem.fx, problem.fy);
    let mut count = 0.0;
    let mut mean = Vector3::zeros();
    let mut moment = Matrix3::zeros();
    for p in &problem.points {
        if residuals::point(fx, fy, model, p)
            .is_some_and(|(r, ..)| r.squared() < max_point * max_point)
        {
            count += 1.0;
            mean += p.x;
            moment += p.x * p.x.transpose();
        }
    }
    let num_lines = problem
        .lines
        .iter()
        .filter(|l| {
            residuals::line(fx, fy, model, l)
                .is_some_and(|(r, _)| r.r[0].abs() + r.r[1].abs() < max_line)
        })
        .count();
    if count >= 3.0 {
        mean /= count;
        let spread = moment / count - mean * mean.transpose();
        let mut values = spread.symmetric_eigenvalues();
        values.as_mut_slice().sort_unstable_by(f64::total_cmp);
        if values[1] < 1e-3 * values[2] {
            return Degeneracy::Collinear;
        }
    }
    if count < 3.0 && num_lines > 0 {
        return Degeneracy::LineDirections;
    }
    Degeneracy::PoseUndetermined
}
