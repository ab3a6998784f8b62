//! Normal equations of the adjustment, reduced to the cameras and the shared intrinsics.
//!
//! One pass over the points keeps, for each observation, the 6x3 block that ties its camera to its point. The reduced system is
//! then filled row of cameras by row of cameras, each independent of the others, so that threads change nothing.

use super::gauge::hold_gauge;
use super::model::{self, Linear, Moving};
use super::priors::{PriorRow, intrinsics_prior, prior_rows};
use super::{BundleObservation, BundleOptions, BundleProblem};
use crate::geometry::{CamFromWorld, rotation_from_vector};
use crate::math::{cholesky, parallel};
use crate::reconstruction::relative::orthonormal;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix6, Matrix6x3, Vector2, Vector3, Vector6};

/// An observation behind its camera costs as much as one that is this far off.
const BEHIND_PX: f64 = 100.0;

/// Curvature that a parameter without any evidence is given, so that it stays.
const LEAST_CURVATURE: f64 = 1e-9;

const FIXED: usize = usize::MAX;

/// Point blocks of the normal equations.
#[derive(Debug, Clone)]
struct PointBlock {
    /// Curvature.
    v: Matrix3<f64>,
    /// Gradient.
    g: Vector3<f64>,
    /// Tie to each observation's camera; empty blocks for fixed cameras.
    ties: Vec<Matrix6x3<f64>>,
    /// Tie to each of the intrinsics (by observation).
    shared: Vec<Matrix2x3<f64>>,
}

/// A step of everything.
pub(super) struct Step {
    /// Cameras (turn, shift), then intrinsics (ln f, k).
    reduced: Vec<f64>,
    points: Vec<Vector3<f64>>,
    /// Decrease of the cost that the quadratic model promises.
    pub(super) predicted: f64,
}

pub(super) struct System {
    options: BundleOptions,
    /// First column of each camera, or [`FIXED`].
    columns: Vec<usize>,
    /// First column of the intrinsics.
    border: usize,
    size: usize,
    /// Columns that may move.
    is_active: Vec<bool>,
    /// Observations of each point: first and one past the last.
    first: Vec<usize>,
    /// (point, place within the point) of each moving camera's observations.
    of_camera: Vec<Vec<(u32, u32)>>,
    blocks: Vec<PointBlock>,
    /// Diagonal blocks and gradient of the cameras, without points.
    curvature: Vec<Matrix6<f64>>,
    gradient: Vec<f64>,
    /// Camera by intrinsics.
    by_border: Vec<Vec<(usize, [f64; 12])>>,
    border_curvature: Vec<Matrix2<f64>>,
    prior_rows: Vec<(usize, Option<usize>, PriorRow)>,
    intrinsics_of: Vec<usize>,
}

fn moving(cam_from_world: &CamFromWorld) -> Moving {
    Moving {
        rotation: cam_from_world.rotation,
        center: cam_from_world.center_in_world(),
    }
}

impl System {
    pub(super) fn new(problem: &BundleProblem, options: &BundleOptions) -> Self {
        let mut columns = Vec::with_capacity(problem.cameras.len());
        let mut size = 0;
        for camera in &problem.cameras {
            columns.push(if camera.is_fixed { FIXED } else { size });
            size += if camera.is_fixed { 0 } else { 6 };
        }
        let border = size;
        size += 2 * problem.intrinsics.len();
        let mut is_active = vec![true; size];
        for i in 0..problem.intrinsics.len() {
            is_active[border + 2 * i] = options.refines_focal;
            is_active[border + 2 * i + 1] = options.refines_radial;
        }
        hold_gauge(problem, &columns, &mut is_active);
        let mut first = vec![0; problem.points.len() + 1];
        for o in &problem.observations {
            first[o.point as usize + 1] += 1;
        }
        for i in 0..problem.points.len() {
            first[i + 1] += first[i];
        }
        let mut of_camera = vec![Vec::new(); problem.cameras.len()];
        for (i, o) in problem.observations.iter().enumerate() {
            let place = (i - first[o.point as usize]) as u32;
            of_camera[o.camera as usize].push((o.point, place));
        }
        Self {
            options: options.clone(),
            columns,
            border,
            size,
            is_active,
            first,
            of_camera,
            blocks: Vec::new(),
            curvature: Vec::new(),
            gradient: Vec::new(),
            by_border: Vec::new(),
            border_curvature: Vec::new(),
            prior_rows: Vec::new(),
            intrinsics_of: problem.cameras.iter().map(|c| c.intrinsics).collect(),
        }
    }

    fn moves_intrinsics(&self) -> bool {
        self.options.refines_focal || self.options.refines_radial
    }

    /// Half the sum of all losses.
    pub(super) fn cost(&self, problem: &BundleProblem, observations: &[BundleObservation]) -> f64 {
        let cameras: Vec<Moving> = problem
            .cameras
            .iter()
            .map(|c| moving(&c.cam_from_world))
            .collect();
        let behind = self.options.loss.at(BEHIND_PX * BEHIND_PX).0;
        /// Points in one piece of the sum.
        const PIECE: usize = 512;
        let pieces = parallel::map(problem.points.len().div_ceil(PIECE), |piece| {
            let points = piece * PIECE..((piece + 1) * PIECE).min(problem.points.len());
            let mut sum = 0.0;
            for o in &observations[self.first[points.start]..self.first[points.end]] {
                let camera = &problem.cameras[o.camera as usize];
                let error = model::error(
                    &cameras[o.camera as usize],
                    &problem.intrinsics[camera.intrinsics],
                    &problem.points[o.point as usize],
                    &o.place_px,
                );
                sum += error.map_or(behind, |e| self.options.loss.at(e.norm_squared()).0);
            }
            sum
        });
        let mut sum: f64 = pieces.into_iter().sum();
        for row in prior_rows(problem, &cameras) {
            sum += row.2.loss.0;
        }
        if self.moves_intrinsics() {
            // Only where it moves; else it is a constant.
            for i in &problem.intrinsics {
                let (error, _) = intrinsics_prior(i);
                sum += error.norm_squared();
            }
        }
        0.5 * sum
    }

    /// Derivatives at the present values.
    pub(super) fn linearise(&mut self, problem: &BundleProblem) {
        let cameras: Vec<Moving> = problem
            .cameras
            .iter()
            .map(|c| moving(&c.cam_from_world))
            .collect();
        let linear = |o: usize| -> Option<(Linear, f64)> {
            let o = &problem.observations[o];
            let camera = &problem.cameras[o.camera as usize];
            let l = model::linear(
                &cameras[o.camera as usize],
                &problem.intrinsics[camera.intrinsics],
                &problem.points[o.point as usize],
                &o.place_px,
            )?;
            let weight = self.options.loss.at(l.error.norm_squared()).1;
            Some((l, weight))
        };
        let moves_intrinsics = self.moves_intrinsics();
        self.blocks = parallel::map(problem.points.len(), |p| {
            let range = self.first[p]..self.first[p + 1];
            let mut block = PointBlock {
                v: Matrix3::zeros(),
                g: Vector3::zeros(),
                ties: Vec::with_capacity(range.len()),
                shared: Vec::with_capacity(if moves_intrinsics { range.len() } else { 0 }),
            };
            for o in range {
                let (tie, shared) = match linear(o) {
                    Some((l, weight)) => {
                        block.v += l.by_point.transpose() * l.by_point * weight;
                        block.g += l.by_point.transpose() * l.error * weight;
                        (
                            tie(&l, weight),
                            l.by_intrinsics.transpose() * l.by_point * weight,
                        )
                    }
                    None => (Matrix6x3::zeros(), Matrix2x3::zeros()),
                };
                block.ties.push(tie);
                if moves_intrinsics {
                    block.shared.push(shared);
                }
            }
            block
        });
        // Cameras: their own curvature, their gradient, their tie to the intrinsics.
        let num_intrinsics = problem.intrinsics.len();
        let per_camera = parallel::map(problem.cameras.len(), |c| {
            let mut u = Matrix6::zeros();
            let mut g = Vector6::zeros();
            let mut mixed = [0.0; 12];
            let mut own = (Matrix2::zeros(), Vector2::zeros());
            if self.columns[c] == FIXED && !moves_intrinsics {
                return (u, g, mixed, own);
            }
            for &(point, place) in &self.of_camera[c] {
                let Some((l, weight)) = linear(self.first[point as usize] + place as usize) else {
                    continue;
                };
                let j = by_camera(&l);
                u += j.transpose() * j * weight;
                g += j.transpose() * l.error * weight;
                if moves_intrinsics {
                    let m = j.transpose() * l.by_intrinsics * weight;
                    for (slot, v) in mixed.iter_mut().zip(m.iter()) {
                        *slot += v;
                    }
                    own.0 += l.by_intrinsics.transpose() * l.by_intrinsics * weight;
                    own.1 += l.by_intrinsics.transpose() * l.error * weight;
                }
            }
            (u, g, mixed, own)
        });
        self.gradient = vec![0.0; self.size];
        self.curvature = Vec::with_capacity(problem.cameras.len());
        self.by_border = vec![Vec::new(); problem.cameras.len()];
        self.border_curvature = vec![Matrix2::zeros(); num_intrinsics];
        for (c, (u, g, mixed, own)) in per_camera.into_iter().enumerate() {
            let i = problem.cameras[c].intrinsics;
            self.curvature.push(u);
            self.border_curvature[i] += own.0;
            for k in 0..2 {
                self.gradient[self.border + 2 * i + k] += own.1[k];
            }
            let column = self.columns[c];
            if column != FIXED {
                for k in 0..6 {
                    self.gradient[column + k] += g[k];
                }
                self.by_border[c].push((i, mixed));
            }
        }
        if moves_intrinsics {
            for (i, intrinsics) in problem.intrinsics.iter().enumerate() {
                let (error, slope) = intrinsics_prior(intrinsics);
                for k in 0..2 {
                    self.border_curvature[i][(k, k)] += slope[k] * slope[k];
                    self.gradient[self.border + 2 * i + k] += slope[k] * error[k];
                }
            }
        }
        self.prior_rows = prior_rows(problem, &cameras);
        for (a, b, row) in &self.prior_rows {
            let mut add = |camera: usize, by: &Matrix6<f64>| {
                self.curvature[camera] += by.transpose() * by * row.loss.1;
                let column = self.columns[camera];
                if column != FIXED {
                    let g = by.transpose() * row.error * row.loss.1;
                    for k in 0..6 {
                        self.gradient[column + k] += g[k];
                    }
                }
            };
            add(*a, &row.by_first);
            if let (Some(b), Some(by)) = (b, &row.by_second) {
                add(*b, by);
            }
        }
    }

    /// The damped reduced system: matrix (lower half, row-major), right-hand side, and the inverses of the points' blocks.
    fn reduce(&self, lambda: f64) -> (Vec<f64>, Vec<f64>, Vec<Matrix3<f64>>) {
        let n = self.size;
        let inverses: Vec<Matrix3<f64>> = self
            .blocks
            .iter()
            .map(|b| {
                let mut v = b.v;
                for k in 0..3 {
                    v[(k, k)] += lambda * v[(k, k)] + LEAST_CURVATURE;
                }
                v.try_inverse().unwrap_or_else(Matrix3::zeros)
            })
            .collect();
        let mut matrix = vec![0.0; n * n];
        let mut right: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        let moving: Vec<usize> = (0..self.columns.len())
            .filter(|c| self.columns[*c] != FIXED)
            .collect();
        // The camera that owns each observation of a point, in the points' order.
        let owner = self.owners();
        let (cameras, border) = matrix.split_at_mut(self.border * n);
        let shift = parallel::map_chunks(cameras, 6 * n, |m, rows| {
            let c = moving[m];
            let column = self.columns[c];
            let mut right = Vector6::zeros();
            let u = &self.curvature[c];
            for r in 0..6 {
                for k in 0..=r {
                    rows[r * n + column + k] += u[(r, k)];
                }
                rows[r * n + column + r] += lambda * u[(r, r)] + LEAST_CURVATURE;
            }
            for &(point, place) in &self.of_camera[c] {
                let block = &self.blocks[point as usize];
                let y = block.ties[place as usize] * inverses[point as usize];
                right += y * block.g;
                let others = &owner[self.first[point as usize]..];
                for (tie, other) in block.ties.iter().zip(others) {
                    let at = self.columns[*other as usize];
                    if at != FIXED && at <= column {
                        let product = y * tie.transpose();
                        for r in 0..6 {
                            let row = &mut rows[r * n + at..r * n + at + 6];
                            for (slot, k) in row.iter_mut().zip(0..6) {
                                *slot -= product[(r, k)];
                            }
                        }
                    }
                }
            }
            right
        });
        for (m, right_of_camera) in shift.into_iter().enumerate() {
            let column = self.columns[moving[m]];
            for k in 0..6 {
                right[column + k] += right_of_camera[k];
            }
        }
        if self.moves_intrinsics() {
            self.reduce_border(border, &mut right, &inverses, &owner, lambda);
        } else {
            for c in self.border..n {
                border[(c - self.border) * n + c] = 1.0;
            }
        }
        for (a, b, row) in &self.prior_rows {
            let (Some(b), Some(by_second)) = (b, &row.by_second) else {
                continue;
            };
            let (p, q) = (self.columns[*a], self.columns[*b]);
            if p == FIXED || q == FIXED {
                continue;
            }
            let product = row.by_first.transpose() * by_second * row.loss.1;
            for r in 0..6 {
                for k in 0..6 {
                    let (i, j) = (p + r, q + k);
                    matrix[i.max(j) * n + i.min(j)] += product[(r, k)];
                }
            }
        }
        for (c, active) in self.is_active.iter().enumerate() {
            if !active {
                matrix[c * n..c * n + c].fill(0.0);
                for r in c + 1..n {
                    matrix[r * n + c] = 0.0;
                }
                matrix[c * n + c] = 1.0;
                right[c] = 0.0;
            }
        }
        (matrix, right, inverses)
    }

    fn owners(&self) -> Vec<u32> {
        let mut owner = vec![0; self.first.last().copied().unwrap_or(0)];
        for (c, seen) in self.of_camera.iter().enumerate() {
            for &(point, place) in seen {
                owner[self.first[point as usize] + place as usize] = c as u32;
            }
        }
        owner
    }

    /// Rows of the shared intrinsics.
    fn reduce_border(
        &self,
        border: &mut [f64],
        right: &mut [f64],
        inverses: &[Matrix3<f64>],
        owner: &[u32],
        lambda: f64,
    ) {
        let n = self.size;
        for (i, own) in self.border_curvature.iter().enumerate() {
            for r in 0..2 {
                for k in 0..2 {
                    border[(2 * i + r) * n + self.border + 2 * i + k] += own[(r, k)];
                }
                border[(2 * i + r) * n + self.border + 2 * i + r] +=
                    lambda * own[(r, r)] + LEAST_CURVATURE;
            }
        }
        for (c, mixed) in self.by_border.iter().enumerate() {
            for (i, m) in mixed {
                for k in 0..2 {
                    for r in 0..6 {
                        border[(2 * i + k) * n + self.columns[c] + r] += m[6 * k + r];
                    }
                }
            }
        }
        for (p, block) in self.blocks.iter().enumerate() {
            let owners = &owner[self.first[p]..self.first[p + 1]];
            let mut sums: Vec<(usize, Matrix2x3<f64>)> = Vec::with_capacity(1);
            for (shared, camera) in block.shared.iter().zip(owners) {
                let i = self.intrinsics_of[*camera as usize];
                match sums.iter_mut().find(|(k, _)| *k == i) {
                    Some((_, sum)) => *sum += shared,
                    None => sums.push((i, *shared)),
                }
            }
            for (i, sum) in &sums {
                let y = sum * inverses[p];
                let g = y * block.g;
                for k in 0..2 {
                    right[self.border + 2 * i + k] += g[k];
                }
                for (tie, camera) in block.ties.iter().zip(owners) {
                    let at = self.columns[*camera as usize];
                    if at == FIXED {
                        continue;
                    }
                    let product = y * tie.transpose();
                    for k in 0..2 {
                        for r in 0..6 {
                            border[(2 * i + k) * n + at + r] -= product[(k, r)];
                        }
                    }
                }
                for (j, other) in &sums {
                    let product = y * other.transpose();
                    for k in 0..2 {
                        for r in 0..2 {
                            border[(2 * i + k) * n + self.border + 2 * j + r] -= product[(k, r)];
                        }
                    }
                }
            }
        }
    }

    /// A damped step; `None` when the system is not positive definite.
    pub(super) fn solve(&self, lambda: f64) -> Option<Step> {
        let (mut matrix, mut reduced, inverses) = self.reduce(lambda);
        if !cholesky::solve_in_place(&mut matrix, &mut reduced) {
            return None;
        }
        let owner = self.owners();
        let mut predicted = 0.0;
        let mut points = Vec::with_capacity(self.blocks.len());
        for (p, block) in self.blocks.iter().enumerate() {
            let mut g = block.g;
            for (place, camera) in owner[self.first[p]..self.first[p + 1]].iter().enumerate() {
                let at = self.columns[*camera as usize];
                if at != FIXED {
                    let step = Vector6::from_column_slice(&reduced[at..at + 6]);
                    g += block.ties[place].transpose() * step;
                }
                if let Some(shared) = block.shared.get(place) {
                    let at = self.border + 2 * self.intrinsics_of[*camera as usize];
                    g += shared.transpose() * Vector2::new(reduced[at], reduced[at + 1]);
                }
            }
            let step = -(inverses[p] * g);
            let damped = step.component_mul(&block.v.diagonal()) * lambda;
            predicted += 0.5 * step.dot(&(damped - block.g));
            points.push(step);
        }
        for (c, column) in self.columns.iter().enumerate() {
            if *column != FIXED {
                for k in 0..6 {
                    let step = reduced[column + k];
                    let damped = lambda * self.curvature[c][(k, k)] * step;
                    predicted += 0.5 * step * (damped - self.gradient[column + k]);
                }
            }
        }
        if self.moves_intrinsics() {
            for (i, own) in self.border_curvature.iter().enumerate() {
                for k in 0..2 {
                    let at = self.border + 2 * i + k;
                    let damped = lambda * own[(k, k)] * reduced[at];
                    predicted += 0.5 * reduced[at] * (damped - self.gradient[at]);
                }
            }
        }
        let is_finite = reduced.iter().all(|v| v.is_finite()) && predicted.is_finite();
        is_finite.then_some(Step {
            reduced,
            points,
            predicted,
        })
    }

    /// The problem after a step, without its observations.
    pub(super) fn moved(&self, problem: &BundleProblem, step: &Step) -> BundleProblem {
        let mut moved = BundleProblem {
            cameras: problem.cameras.clone(),
            intrinsics: problem.intrinsics.clone(),
            points: problem.points.clone(),
            observations: Vec::new(),
            pose_priors: problem.pose_priors.clone(),
            relative_priors: problem.relative_priors.clone(),
        };
        for (camera, column) in moved.cameras.iter_mut().zip(&self.columns) {
            if *column == FIXED {
                continue;
            }
            let s = &step.reduced[*column..column + 6];
            // What is held keeps its bits.
            if s.iter().all(|v| *v == 0.0) {
                continue;
            }
            let now = moving(&camera.cam_from_world);
            let turn = rotation_from_vector(&Vector3::new(s[0], s[1], s[2]));
            let rotation = orthonormal(&(turn * now.rotation));
            let center = now.center + Vector3::new(s[3], s[4], s[5]);
            camera.cam_from_world = CamFromWorld::new(rotation, -(rotation * center));
        }
        for (i, intrinsics) in moved.intrinsics.iter_mut().enumerate() {
            let at = self.border + 2 * i;
            intrinsics.focal_px *= crate::math::elementary::exp(step.reduced[at].clamp(-0.5, 0.5));
            intrinsics.k += step.reduced[at + 1];
        }
        for (point, s) in moved.points.iter_mut().zip(&step.points) {
            *point += s;
        }
        moved
    }

    /// Standard deviations of ln f at the present values; [`Self::linearise`] comes before.
    pub(super) fn focal_sigmas(&self, problem: &BundleProblem) -> Option<Vec<f64>> {
        if !self.options.refines_focal {
            return None;
        }
        let num_unknowns = self.is_active.iter().filter(|a| **a).count() + 3 * problem.points.len();
        let num_equations = 2 * problem.observations.len();
        let freedom = num_equations.checked_sub(num_unknowns).filter(|f| *f > 0)?;
        let variance = 2.0 * self.cost(problem, &problem.observations) / freedom as f64;
        (0..problem.intrinsics.len())
            .map(|i| {
                let (mut matrix, mut right, _) = self.reduce(0.0);
                right.fill(0.0);
                right[self.border + 2 * i] = 1.0;
                cholesky::solve_in_place(&mut matrix, &mut right).then_some(())?;
                Some((variance * right[self.border + 2 * i]).max(0.0).sqrt())
            })
            .collect()
    }
}

fn by_camera(l: &Linear) -> nalgebra::Matrix2x6<f64> {
    let mut j = nalgebra::Matrix2x6::zeros();
    j.fixed_view_mut::<2, 3>(0, 0).copy_from(&l.by_turn);
    j.fixed_view_mut::<2, 3>(0, 3).copy_from(&-l.by_point);
    j
}

fn tie(l: &Linear, weight: f64) -> Matrix6x3<f64> {
    by_camera(l).transpose() * (l.by_point * weight)
}
