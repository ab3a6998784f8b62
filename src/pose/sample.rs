//! One minimal sample: the tests before it is solved, the solver, the tests on the sample itself.

use super::options::Gravity;
use super::problem::{LineItem, MIN_DEPTH, Model, Problem};
use super::residuals;
use super::solvers::{
    FocalSolutions, ImageLineCentered, SampleLine, Solutions, SolverKind, p1p2ll, p2p1ll, p3ll,
    p3p, pnplf, up1p1ll, up2p,
};
use crate::geometry::CamFromWorld;
use nalgebra::{Matrix3, Vector3};

/// Points of a sample must be this far apart in the image.
const MIN_POINT_DISTANCE_PX: f64 = 8.0;

/// Lines of a sample must be this long in the image.
const MIN_LINE_LENGTH_PX: f64 = 12.0;

/// Rotations that bring gravity onto the y axis.
#[derive(Debug)]
pub(super) struct GravityFrames {
    upright_from_cam: Matrix3<f64>,
    upright_from_world: Matrix3<f64>,
}

impl GravityFrames {
    pub(super) fn new(gravity: &Gravity) -> Self {
        Self {
            upright_from_cam: rotation_onto_y(&gravity.in_cam),
            upright_from_world: rotation_onto_y(&gravity.in_world),
        }
    }
}

fn rotation_onto_y(v: &Vector3<f64>) -> Matrix3<f64> {
    let y = v.normalize();
    let axis = if y.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::z()
    };
    let z = axis.cross(&y).normalize();
    let x = y.cross(&z);
    Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()])
}

/// Indices of the drawn items, and the focal length they are solved with.
#[derive(Debug)]
pub(super) struct Sample<'a> {
    pub(super) kind: SolverKind,
    pub(super) points: &'a [usize],
    pub(super) lines: &'a [usize],
    pub(super) focal: f64,
}

impl Sample<'_> {
    /// Cheap tests that save a solver call.
    pub(super) fn is_sound(&self, problem: &Problem) -> bool {
        let (points, lines) = (self.points, self.lines);
        for (k, i) in points.iter().enumerate() {
            for j in &points[..k] {
                let d = problem.points[*i].uv - problem.points[*j].uv;
                if d.norm_squared() < MIN_POINT_DISTANCE_PX * MIN_POINT_DISTANCE_PX {
                    return false;
                }
            }
        }
        if let [i, j, k] = *points {
            let x = |i: usize| problem.points[i].x;
            let (a, b) = (x(j) - x(i), x(k) - x(i));
            let longest = a
                .norm_squared()
                .max(b.norm_squared())
                .max((a - b).norm_squared());
            if a.cross(&b).norm_squared() < 1e-6 * longest * longest {
                return false;
            }
        }
        lines
            .iter()
            .all(|i| problem.lines[*i].length_px > MIN_LINE_LENGTH_PX)
    }

    /// The candidate poses, in `focal_out` where the solver finds the focal length too.
    pub(super) fn solve(
        &self,
        problem: &Problem,
        gravity: Option<&GravityFrames>,
        out: &mut Solutions,
        focal_out: &mut FocalSolutions,
    ) {
        let Sample {
            kind,
            points: pi,
            lines: li,
            focal,
        } = *self;
        let bearing = |k: usize| problem.bearing(&problem.points[pi[k]].uv, focal);
        let x = |k: usize| problem.points[pi[k]].x;
        let line = |k: usize| sample_line(problem, &problem.lines[li[k]], focal);
        match kind {
            SolverKind::P3p => p3p(
                &[bearing(0), bearing(1), bearing(2)],
                &[x(0), x(1), x(2)],
                out,
            ),
            SolverKind::P2p1ll => p2p1ll(&[bearing(0), bearing(1)], &[x(0), x(1)], &line(0), out),
            SolverKind::P1p2ll => p1p2ll(&bearing(0), &x(0), &[line(0), line(1)], out),
            SolverKind::P3ll => p3ll(&[line(0), line(1), line(2)], out),
            SolverKind::Up2p | SolverKind::Up1p1ll => {
                let Some(frames) = gravity else {
                    out.clear();
                    return;
                };
                let (c, w) = (&frames.upright_from_cam, &frames.upright_from_world);
                if kind == SolverKind::Up2p {
                    up2p(
                        &[c * bearing(0), c * bearing(1)],
                        &[w * x(0), w * x(1)],
                        out,
                    );
                } else {
                    let l = line(0);
                    let turned = SampleLine {
                        normal_in_cam: c * l.normal_in_cam,
                        point_in_world: w * l.point_in_world,
                        direction_in_world: w * l.direction_in_world,
                    };
                    up1p1ll(&(c * bearing(0)), &(w * x(0)), &turned, out);
                }
                out.map(|pose| {
                    CamFromWorld::new(
                        c.transpose() * pose.rotation * w,
                        c.transpose() * pose.translation,
                    )
                });
            }
            SolverKind::Pnplf => {
                // The solver wants square pixels: measure y in the unit of x.
                let aspect = problem.fx / problem.fy;
                let unit = (problem.fx * problem.fy).sqrt() / problem.fx;
                let px = |k: usize| {
                    let uv = problem.points[pi[k.min(pi.len() - 1)]].uv;
                    nalgebra::Vector2::new(uv.x, uv.y * aspect) * unit
                };
                let pixels: [_; 4] = core::array::from_fn(|k| {
                    if pi.is_empty() {
                        nalgebra::Vector2::zeros()
                    } else {
                        px(k)
                    }
                });
                let points: [_; 4] =
                    core::array::from_fn(|k| if k < pi.len() { x(k) } else { Vector3::zeros() });
                let mut lines = [ImageLineCentered {
                    line: Vector3::zeros(),
                    point_in_world: Vector3::zeros(),
                    direction_in_world: Vector3::x(),
                }; 4];
                for (slot, i) in lines.iter_mut().zip(li) {
                    let l = &problem.lines[*i];
                    let end = |uv: &nalgebra::Vector2<f64>| {
                        Vector3::new(uv.x * unit, uv.y * aspect * unit, 1.0)
                    };
                    *slot = ImageLineCentered {
                        line: end(&l.a).cross(&end(&l.b)),
                        point_in_world: l.x1,
                        direction_in_world: l.direction,
                    };
                }
                pnplf(
                    &pixels[..pi.len()],
                    &points[..pi.len()],
                    &lines[..li.len()],
                    focal_out,
                );
            }
        }
    }

    /// Sampled points and both world ends of sampled lines lie in front, and the segments overlap: removes most candidates.
    pub(super) fn is_explained_by(&self, problem: &Problem, model: &Model) -> bool {
        let (pi, li) = (self.points, self.lines);
        let (fx, fy) = (problem.fx, problem.fy);
        pi.iter().all(|i| {
            let z = model.rotation.row(2) * problem.points[*i].x;
            z[0] + model.translation.z > MIN_DEPTH
        }) && li.iter().all(|i| {
            let item = &problem.lines[*i];
            residuals::line(fx, fy, model, item)
                .is_some_and(|(_, state)| residuals::overlaps(fx, fy, item, &state, model.focal))
        })
    }
}

fn sample_line(problem: &Problem, item: &LineItem, focal: f64) -> SampleLine {
    SampleLine {
        normal_in_cam: problem.plane_normal(item, focal),
        point_in_world: item.x1,
        direction_in_world: item.direction,
    }
}
