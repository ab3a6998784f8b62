//! Where the camera will be, and how a correction is spread over time.

use crate::geometry::{CamFromWorld, rotation_from_vector, vector_from_rotation};
use nalgebra::{Matrix3, Vector3};

/// A movement is carried on for this long at most.
const MAX_AHEAD_MS: f64 = 120.0;
/// Poses further apart than this say nothing about the speed.
const MAX_BASE_MS: f64 = 250.0;

/// The last two poses of one camera with their times.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Motion {
    last: Option<(CamFromWorld, f64)>,
    before: Option<(CamFromWorld, f64)>,
}

impl Motion {
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Takes the pose of the newest frame.
    pub(super) fn add(&mut self, cam_from_world: &CamFromWorld, timestamp_ms: f64) {
        self.before = self.last;
        self.last = Some((*cam_from_world, timestamp_ms));
    }

    /// The last pose.
    pub(super) fn last(&self) -> Option<CamFromWorld> {
        self.last.map(|(pose, _)| pose)
    }

    /// All poses as another reference sees them: `change` turns the camera and moves its centre.
    pub(super) fn correct(&mut self, change: &Change) {
        for (pose, _) in self.last.iter_mut().chain(self.before.iter_mut()) {
            *pose = change.applied(pose, 1.0);
        }
    }

    /// The pose before the last one and how much earlier it was, if both tell of a speed.
    fn base(&self) -> Option<(CamFromWorld, f64)> {
        let ((_, at), (pose, before)) = (self.last?, self.before?);
        let base = at - before;
        (base > 0.0 && base <= MAX_BASE_MS).then_some((pose, base))
    }

    /// Whether poses tell how fast the camera moves.
    pub(super) fn knows_speed(&self) -> bool {
        self.base().is_some()
    }

    /// The pose at a time, if the camera goes on as it did; turned as a sensor says where one does.
    pub(super) fn expected(
        &self,
        timestamp_ms: f64,
        turned: Option<&Matrix3<f64>>,
    ) -> Option<CamFromWorld> {
        let (last, at) = self.last?;
        let ahead = (timestamp_ms - at).clamp(0.0, MAX_AHEAD_MS);
        let (turn, center) = match self.base() {
            Some((pose, base)) => {
                let share = ahead / base;
                let step = vector_from_rotation(&(last.rotation * pose.rotation.transpose()));
                let (from, to) = (pose.center_in_world(), last.center_in_world());
                (
                    rotation_from_vector(&(step * share)),
                    to + (to - from) * share,
                )
            }
            None => (Matrix3::identity(), last.center_in_world()),
        };
        let rotation = turned.unwrap_or(&turn) * last.rotation;
        Some(CamFromWorld::new(rotation, -(rotation * center)))
    }
}

/// What takes one pose into another that lies near: a turn in the camera and a shift of its centre in the world.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Change {
    turn: Vector3<f64>,
    shift: Vector3<f64>,
}

impl Change {
    pub(super) fn between(from: &CamFromWorld, to: &CamFromWorld) -> Self {
        Self {
            turn: vector_from_rotation(&(to.rotation * from.rotation.transpose())),
            shift: to.center_in_world() - from.center_in_world(),
        }
    }

    /// A pose with a share of the change: 0 leaves it, 1 makes the whole.
    pub(super) fn applied(&self, pose: &CamFromWorld, share: f64) -> CamFromWorld {
        let rotation = rotation_from_vector(&(self.turn * share)) * pose.rotation;
        let center = pose.center_in_world() + self.shift * share;
        CamFromWorld::new(rotation, -(rotation * center))
    }

    /// A part of the change.
    pub(super) fn scaled(&self, share: f64) -> Self {
        Self {
            turn: self.turn * share,
            shift: self.shift * share,
        }
    }
}

/// A correction that fades.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Blend {
    rest: Change,
    /// Since when; `None` when nothing is left.
    since_ms: Option<f64>,
}

impl Blend {
    pub(super) fn clear(&mut self) {
        self.since_ms = None;
    }

    /// From what was shown last to what is believed now.
    pub(super) fn start(&mut self, shown: &CamFromWorld, believed: &CamFromWorld, now_ms: f64) {
        self.rest = Change::between(believed, shown);
        self.since_ms = Some(now_ms);
    }

    /// What to show for a pose.
    pub(super) fn shown(
        &mut self,
        believed: &CamFromWorld,
        now_ms: f64,
        blend_ms: f64,
    ) -> CamFromWorld {
        let Some(since) = self.since_ms else {
            return *believed;
        };
        let t = (now_ms - since) / blend_ms;
        if !(0.0..1.0).contains(&t) {
            self.since_ms = None;
            return *believed;
        }
        // Starts and ends without a jerk.
        let left = 1.0 - t * t * (3.0 - 2.0 * t);
        self.rest.applied(believed, left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(turn: f64, x: f64) -> CamFromWorld {
        let rotation = rotation_from_vector(&Vector3::new(0.1, turn, -0.2));
        CamFromWorld::new(rotation, -(rotation * Vector3::new(x, 0.3, 1.0)))
    }

    #[test]
    fn a_steady_movement_goes_on() {
        let mut motion = Motion::default();
        assert!(motion.expected(0.0, None).is_none());
        let spin = Vector3::new(0.0, 0.02, 0.01);
        let at = |k: f64| {
            let rotation = rotation_from_vector(&(spin * k)) * pose(0.4, 0.0).rotation;
            CamFromWorld::new(rotation, -(rotation * Vector3::new(0.1 * k, 0.0, 0.0)))
        };
        motion.add(&at(0.0), 0.0);
        motion.add(&at(1.0), 33.0);
        let expected = motion.expected(66.0, None).expect("two poses");
        let (m, rad) = expected.error_to(&at(2.0));
        assert!(m < 1e-9 && rad < 1e-9, "{m} {rad}");
        // Backwards in time, or long after, nothing runs away.
        let (m, _) = motion
            .expected(-500.0, None)
            .expect("two")
            .error_to(&at(1.0));
        assert!(m < 1e-9);
        let (m, _) = motion.expected(9e9, None).expect("two").error_to(&at(1.0));
        assert!(m < 0.4);
        // A sensor's turn replaces the extrapolated one.
        let none = Matrix3::identity();
        let held = motion.expected(66.0, Some(&none)).expect("two");
        assert!(held.rotation_angle_to(&at(1.0)) < 1e-9);
    }

    #[test]
    fn changes_undo_each_other_and_blends_fade() {
        let (a, b) = (pose(0.1, 0.0), pose(0.13, 0.05));
        let change = Change::between(&a, &b);
        let (m, rad) = change.applied(&a, 1.0).error_to(&b);
        assert!(m < 1e-12 && rad < 1e-12);
        let (m, rad) = change
            .scaled(0.5)
            .applied(&a, 1.0)
            .error_to(&change.applied(&a, 0.5));
        assert!(m < 1e-12 && rad < 1e-12);
        let mut blend = Blend::default();
        assert_eq!(blend.shown(&b, 0.0, 150.0), b);
        blend.start(&a, &b, 1000.0);
        let (m, rad) = blend.shown(&b, 1000.0, 150.0).error_to(&a);
        assert!(m < 1e-12 && rad < 1e-12);
        let mut last = f64::INFINITY;
        for ms in [1020.0, 1060.0, 1100.0, 1140.0] {
            let (m, _) = blend.shown(&b, ms, 150.0).error_to(&b);
            assert!(m < last && m > 0.0);
            last = m;
        }
        assert_eq!(blend.shown(&b, 1150.0, 150.0), b);
        // Time that runs backwards ends a blend and does not turn it round.
        blend.start(&a, &b, 1000.0);
        assert_eq!(blend.shown(&b, 900.0, 150.0), b);
        assert_eq!(blend.shown(&b, 1010.0, 150.0), b);
    }
}
