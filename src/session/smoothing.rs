//! Smooths the poses of a moving camera for display.
//!
//! * **In and out**: poses with their times; a pose that moves less nervously.
//! * **Spaces and units**: position of the camera in the world and its rotation (radians); never
//!   matrix entries, which would leave the rotations.
//! * **Method**: the One Euro filter (Casiez, Roussel and Vogel, CHI 2012): an exponential average whose cut-off frequency
//!   grows with speed, so that a still camera does not tremble and a moving one does not lag. One speed for all axes of a
//!   quantity keeps the direction of a movement.
//! * **Invariants**: the first pose and the pose after a gap pass unchanged; the answer is a rigid transform.
//! * **Cost**: constant, no allocation.

use crate::geometry::{CamFromWorld, WorldFromCam};
use core::f64::consts::TAU;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

/// How strongly displayed poses are smoothed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Smoothing {
    /// Each frame as it was solved.
    #[default]
    Off,
    /// For a camera that is mostly held still.
    Steady,
    /// For a camera that walks about.
    Responsive,
}

impl Smoothing {
    /// Cut-off frequency at rest in Hz, and its growth with speed (per metre/s and per rad/s). Chosen by eye on walked videos.
    fn parameters(self) -> Option<(f64, f64, f64)> {
        match self {
            Self::Off => None,
            Self::Steady => Some((0.8, 2.0, 2.0)),
            Self::Responsive => Some((2.5, 8.0, 6.0)),
        }
    }
}

/// Cut-off of the filter on the speeds themselves, in Hz; the value of the article.
const SPEED_CUTOFF_HZ: f64 = 1.0;

/// A pause longer than this starts anew.
const MAX_GAP_MS: f64 = 1000.0;

/// State of the filter.
#[derive(Debug, Clone)]
pub struct PoseFilter {
    metre: f64,
    last: Option<Filtered>,
}

#[derive(Debug, Clone, Copy)]
struct Filtered {
    center: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    timestamp_ms: f64,
}

impl PoseFilter {
    /// A filter for a scene in which `metre` world units are taken for a metre.
    pub fn new(metre: f64) -> Self {
        Self { metre, last: None }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// The smoothed pose; `None` when smoothing is off.
    pub fn apply(
        &mut self,
        smoothing: Smoothing,
        cam_from_world: &CamFromWorld,
        timestamp_ms: f64,
    ) -> Option<CamFromWorld> {
        let Some((cutoff, per_speed, per_turn)) = smoothing.parameters() else {
            self.reset();
            return None;
        };
        let measured = cam_from_world.inverse();
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
            measured.rotation,
        ));
        let center = measured.translation;
        let next = match self.last {
            Some(last)
                if timestamp_ms > last.timestamp_ms
                    && timestamp_ms - last.timestamp_ms <= MAX_GAP_MS =>
            {
                let dt = (timestamp_ms - last.timestamp_ms) * 1e-3;
                let keep = weight(SPEED_CUTOFF_HZ, dt);
                let velocity = last.velocity.lerp(&((center - last.center) / dt), keep);
                let turn = (last.rotation.inverse() * rotation).scaled_axis();
                let angular_velocity = last.angular_velocity.lerp(&(turn / dt), keep);
                let a = weight(cutoff + per_speed * velocity.norm() / self.metre, dt);
                let b = weight(cutoff + per_turn * angular_velocity.norm(), dt);
                Filtered {
                    center: last.center.lerp(&center, a),
                    rotation: last.rotation * UnitQuaternion::from_scaled_axis(turn * b),
                    velocity,
                    angular_velocity,
                    timestamp_ms,
                }
            }
            _ => Filtered {
                center,
                rotation,
                velocity: Vector3::zeros(),
                angular_velocity: Vector3::zeros(),
                timestamp_ms,
            },
        };
        self.last = Some(next);
        let smoothed =
            WorldFromCam::new(next.rotation.to_rotation_matrix().into_inner(), next.center);
        Some(smoothed.inverse())
    }
}

/// Weight of the newest value in an exponential average with the given cut-off.
fn weight(cutoff_hz: f64, dt_s: f64) -> f64 {
    let r = TAU * cutoff_hz * dt_s;
    r / (r + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, turn: f64) -> CamFromWorld {
        let r = Rotation3::from_axis_angle(&Vector3::y_axis(), turn).into_inner();
        WorldFromCam::new(r, Vector3::new(x, 0.0, 0.0)).inverse()
    }

    #[test]
    fn a_trembling_still_camera_becomes_calm() {
        let mut filter = PoseFilter::new(1.0);
        let mut largest: f64 = 0.0;
        for i in 0..60 {
            let noise = if i % 2 == 0 { 0.01 } else { -0.01 };
            let out = filter
                .apply(Smoothing::Steady, &pose(noise, noise), f64::from(i) * 33.0)
                .unwrap_or_else(CamFromWorld::identity);
            if i > 30 {
                largest = largest.max(out.center_in_world().x.abs());
            }
        }
        assert!(largest < 0.005, "still moves by {largest} of 0.01");
    }

    #[test]
    fn a_walking_camera_is_followed_closely() {
        let mut filter = PoseFilter::new(1.0);
        let mut lag: f64 = 0.0;
        for i in 0..90 {
            let x = f64::from(i) * 0.033;
            let out = filter
                .apply(
                    Smoothing::Responsive,
                    &pose(x, 0.5 * x),
                    f64::from(i) * 33.0,
                )
                .unwrap_or_else(CamFromWorld::identity);
            lag = x - out.center_in_world().x;
            let product = out.rotation.transpose() * out.rotation;
            assert!((product - nalgebra::Matrix3::identity()).norm() < 1e-12);
        }
        assert!(lag.abs() < 0.04, "lags by {lag} m at 1 m/s");
    }

    #[test]
    fn a_gap_starts_anew_and_off_gives_nothing() {
        let mut filter = PoseFilter::new(1.0);
        assert!(filter.apply(Smoothing::Off, &pose(1.0, 0.0), 0.0).is_none());
        filter.apply(Smoothing::Steady, &pose(0.0, 0.0), 0.0);
        let far = filter.apply(Smoothing::Steady, &pose(5.0, 1.0), 5000.0);
        assert_eq!(far.map(|p| p.center_in_world().x), Some(5.0));
        // A clock that runs backwards starts anew as well.
        let back = filter.apply(Smoothing::Steady, &pose(1.0, 0.0), 10.0);
        assert!(back.is_some_and(|p| (p.center_in_world().x - 1.0).abs() < 1e-12));
    }
}
