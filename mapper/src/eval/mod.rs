//! Accuracy on pictures with known poses: errors, recall, medians, and the nearest-landmark baseline beside them.

mod baseline;
mod compare;
mod held_out;
mod html;
mod lines;
mod peer;
mod plots;
mod reliability;
mod report;
mod run;
mod world;

pub use baseline::{Landmarks, baseline_size};
pub use compare::Comparison;
pub use held_out::{held_out, held_range, pose_error};
pub use lines::{LineAccuracy, LineTruth, MAX_LINE_ANGLE_DEG, MAX_LINE_DISTANCE};
pub use peer::{FullMatching, NUM_PICTURES};
pub use reliability::{CONFIDENT, Reliability};
pub use report::{Subject, per_image_csv, table, to_json, write_report};
pub use run::{
    EvalError, EvalOptions, Evaluation, Evaluator, ImageResult, MethodResult, solver_options,
};
pub use world::OtherWorld;

use landline::geometry::CamFromWorld;
use landline::math::stats::median_in_place;
use serde::Serialize;

/// Thresholds of the recall table: world units and degrees.
pub const THRESHOLDS: [(f64, f64); 5] = [
    (0.01, 1.0),
    (0.02, 2.0),
    (0.03, 3.0),
    (0.05, 5.0),
    (0.10, 10.0),
];

/// Those of them that the tables show.
pub(crate) const RECALLS: [(f64, f64); 3] = [(0.02, 2.0), (0.05, 5.0), (0.10, 10.0)];

/// How far a pose is from the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseError {
    /// Distance of the camera positions, world units.
    pub position: f64,
    /// Angle of the rotations in degrees.
    pub rotation_deg: f64,
}

impl PoseError {
    /// Of an estimate against the truth.
    pub fn between(estimate: &CamFromWorld, truth: &CamFromWorld) -> Self {
        let (position, rotation) = estimate.error_to(truth);
        Self {
            position,
            rotation_deg: rotation.to_degrees(),
        }
    }
}

/// Figures of one method over a set of pictures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Pictures.
    pub num_images: usize,
    /// Pictures with a pose.
    pub num_located: usize,
    /// Median over all pictures; one without a pose counts as infinitely far. World units.
    pub median_position: f64,
    /// The same in degrees.
    pub median_rotation_deg: f64,
    /// Share of all pictures within each of [`THRESHOLDS`], both strictly below.
    pub recalls: Vec<f64>,
    /// Median number of point inliers of located pictures.
    pub median_point_inliers: f64,
    /// Median number of line inliers of located pictures.
    pub median_line_inliers: f64,
}

impl Summary {
    /// Sums up; `None` is a picture without a pose. Inliers are of points and of lines.
    pub fn of(errors: &[Option<PoseError>], inliers: &[(usize, usize)]) -> Self {
        let median = |values: &mut Vec<f64>| median_in_place(values).unwrap_or(f64::NAN);
        let of = |part: fn(&PoseError) -> f64| {
            errors
                .iter()
                .map(|e| e.as_ref().map_or(f64::INFINITY, part))
                .collect::<Vec<f64>>()
        };
        let share = |(m, deg): (f64, f64)| {
            let within = errors
                .iter()
                .flatten()
                .filter(|e| e.position < m && e.rotation_deg < deg)
                .count();
            within as f64 / errors.len().max(1) as f64
        };
        Self {
            num_images: errors.len(),
            num_located: errors.iter().flatten().count(),
            median_position: median(&mut of(|e| e.position)),
            median_rotation_deg: median(&mut of(|e| e.rotation_deg)),
            recalls: THRESHOLDS.iter().map(|t| share(*t)).collect(),
            median_point_inliers: median(&mut inliers.iter().map(|i| i.0 as f64).collect()),
            median_line_inliers: median(&mut inliers.iter().map(|i| i.1 as f64).collect()),
        }
    }

    /// The recall at one of [`THRESHOLDS`], given by its distance.
    pub fn recall_at(&self, position: f64) -> Option<f64> {
        let i = THRESHOLDS
            .iter()
            .position(|(m, _)| (m - position).abs() < 1e-9)?;
        self.recalls.get(i).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn medians_and_recalls_count_failures_as_far_away() {
        let e = |position, rotation_deg| {
            Some(PoseError {
                position,
                rotation_deg,
            })
        };
        let s = Summary::of(
            &[
                e(0.004, 0.5),
                e(0.015, 6.0),
                e(0.04, 1.0),
                None,
                e(0.05, 1.0),
            ],
            &[(10, 1), (20, 2), (30, 3), (40, 4)],
        );
        assert_eq!((s.num_images, s.num_located), (5, 4));
        assert_eq!((s.median_position, s.median_rotation_deg), (0.04, 1.0));
        // 0.05 itself is not below 0.05.
        assert_eq!(s.recalls, [0.2, 0.2, 0.2, 0.4, 0.8]);
        let half_failed = Summary::of(&[e(0.01, 0.1), None, None], &[]);
        assert!(half_failed.median_position.is_infinite());
    }

    #[test]
    fn error_is_of_camera_positions() {
        let truth = CamFromWorld::from_quaternion_wxyz([1.0, 0.0, 0.0, 0.0], Vector3::zeros());
        let half = 0.5f64.to_radians() / 2.0;
        let turned = CamFromWorld::from_quaternion_wxyz(
            [half.cos(), 0.0, half.sin(), 0.0],
            Vector3::new(0.0, 0.0, -0.3),
        );
        let e = PoseError::between(&turned, &truth);
        assert!((e.position - 0.3).abs() < 1e-12 && (e.rotation_deg - 0.5).abs() < 1e-9);
    }
}
