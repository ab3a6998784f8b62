//! One point from several rays: midpoint of two, least squares on the reprojection error of many.

use super::{Observation, PosedView};
use crate::math::elementary;
use crate::math::least_squares::{Damping, LeastSquares, Normal, minimize};
use nalgebra::{Matrix2x3, Vector2, Vector3};

/// A half line in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// The camera's position.
    pub origin: Vector3<f64>,
    /// Of unit length.
    pub direction: Vector3<f64>,
}

impl Ray {
    /// Angle between two rays in radians.
    pub fn angle_to(&self, other: &Self) -> f64 {
        let cross = self.direction.cross(&other.direction).norm();
        elementary::atan2(cross, self.direction.dot(&other.direction))
    }

    /// The point halfway between the closest points of two rays; `None` when they are parallel or meet behind.
    pub fn midpoint(&self, other: &Self) -> Option<Vector3<f64>> {
        let between = other.origin - self.origin;
        let cos = self.direction.dot(&other.direction);
        let det = 1.0 - cos * cos;
        if !(det > 1e-12) {
            return None;
        }
        let a = between.dot(&self.direction);
        let b = between.dot(&other.direction);
        let s = (a - b * cos) / det;
        let t = (a * cos - b) / det;
        (s > 0.0 && t > 0.0)
            .then(|| 0.5 * (self.origin + s * self.direction + other.origin + t * other.direction))
    }
}

/// Keypoints of several views that are to see one point.
pub struct Bundle<'a> {
    /// All views.
    pub views: &'a [PosedView<'a>],
}

impl Bundle<'_> {
    /// Distance in pixels; infinite for an observation that does not exist.
    pub fn error_px(&self, seen: Observation, point: &Vector3<f64>) -> f64 {
        self.views
            .get(seen.view as usize)
            .map_or(f64::INFINITY, |v| v.error_px(seen.feature as usize, point))
    }

    /// Moves a point to the least sum of Huber losses of the reprojection errors.
    pub fn refine(
        &self,
        observations: &[Observation],
        start: Vector3<f64>,
        huber_px: f64,
    ) -> Vector3<f64> {
        let mut problem = PointProblem {
            bundle: self,
            observations,
            huber_px,
        };
        minimize(&mut problem, start, &Damping::default(), || false).0
    }

    fn residual(
        &self,
        seen: Observation,
        point: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let view = self.views.get(seen.view as usize)?;
        let seen = view.planar.get(seen.feature as usize)?;
        let p = view.cam_from_world.transform_point(point);
        if !(p.z > 1e-6) || seen.x.is_nan() {
            return None;
        }
        let projected = Vector2::new(p.x / p.z, p.y / p.z);
        let f = view.focal_px;
        let by_cam = Matrix2x3::new(
            f / p.z,
            0.0,
            -f * projected.x / p.z,
            0.0,
            f / p.z,
            -f * projected.y / p.z,
        );
        Some((
            (projected - seen) * f,
            by_cam * view.cam_from_world.rotation,
        ))
    }

    /// Largest angle between the rays of the observations, in radians.
    pub fn largest_angle(&self, observations: &[Observation], point: &Vector3<f64>) -> f64 {
        let directions: Vec<Vector3<f64>> = observations
            .iter()
            .filter_map(|o| {
                (self.views.get(o.view as usize)?.center_in_world - point).try_normalize(0.0)
            })
            .collect();
        // The widest angle to the first direction, then from that one: exact for views along a path, at worst half
        // of the true angle.
        let Some(first) = directions.first() else {
            return 0.0;
        };
        let farthest = |from: &Vector3<f64>| {
            directions
                .iter()
                .map(|d| (elementary::atan2(from.cross(d).norm(), from.dot(d)), *d))
                .fold(
                    (0.0, *from),
                    |best, next| if next.0 > best.0 { next } else { best },
                )
        };
        let (_, edge) = farthest(first);
        farthest(&edge).0
    }
}

/// The place of one point under Huber's loss.
struct PointProblem<'a> {
    bundle: &'a Bundle<'a>,
    observations: &'a [Observation],
    huber_px: f64,
}

/// An observation that cannot see the point costs as much as one that is so far off.
const UNSEEN_PX: f64 = 1e6;

impl LeastSquares for PointProblem<'_> {
    type Parameters = Vector3<f64>;
    type Normal = Normal<3>;
    type Step = Vector3<f64>;

    fn normal(&mut self, point: &Vector3<f64>) -> Normal<3> {
        let mut normal = Normal::default();
        let huber = self.huber_px;
        for o in self.observations {
            let mut error = UNSEEN_PX;
            if let Some((residual, jacobian)) = self.bundle.residual(*o, point) {
                error = residual.norm().min(UNSEEN_PX);
                let weight = if error > huber { huber / error } else { 1.0 };
                for (row, r) in jacobian.row_iter().zip(residual.iter()) {
                    normal.add(&row.transpose(), *r, weight);
                }
            }
            normal.cost += if error > huber {
                huber * (error - 0.5 * huber)
            } else {
                0.5 * error * error
            };
        }
        normal
    }

    fn cost(&self, normal: &Normal<3>) -> f64 {
        normal.cost
    }

    fn step(&self, normal: &Normal<3>, lambda: f64) -> Option<Vector3<f64>> {
        normal.step(lambda)
    }

    fn step_sq(&self, step: &Vector3<f64>) -> f64 {
        step.norm_squared()
    }

    fn moved(&self, at: &Vector3<f64>, step: &Vector3<f64>) -> Vector3<f64> {
        at + step
    }
}
