//! Whether the poses of one moving camera follow each other.

use crate::geometry::CamFromWorld;

/// What an application should know about the last frames together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SessionState {
    /// No position yet, or none for a while.
    #[default]
    Searching,
    /// Positions come and agree with each other.
    Tracking,
    /// Something is not as it should be.
    Limited(LimitedReason),
}

/// Why tracking is limited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitedReason {
    /// The last frames were not located.
    Lost,
    /// The position is far from the one before; the next frame has to confirm it.
    Jump,
    /// The focal length is still a guess, and distances with it.
    FocalUncertain,
}

/// Frames without a position after which the state is `Searching` again.
const MAX_MISSES: u32 = 5;
/// A pose older than this is no prior any more.
const MAX_PRIOR_AGE_MS: f64 = 2000.0;
/// A walking or turning person stays below these.
const MAX_SPEED_M_PER_S: f64 = 5.0;
const MAX_TURN_RAD_PER_S: f64 = 6.0;
/// Errors of two poses add up to about this much without any movement.
const JUMP_FLOOR_M: f64 = 0.3;
const JUMP_FLOOR_RAD: f64 = 0.25;

/// Follows one camera.
#[derive(Debug, Clone)]
pub struct Continuity {
    metre: f64,
    last: Option<(CamFromWorld, f64)>,
    misses: u32,
    state: SessionState,
}

impl Continuity {
    /// Follows a camera in a scene in which `metre` world units are taken for a metre.
    pub fn new(metre: f64) -> Self {
        Self {
            metre,
            last: None,
            misses: 0,
            state: SessionState::default(),
        }
    }

    /// Forgets where the camera was.
    pub fn reset(&mut self) {
        *self = Self::new(self.metre);
    }

    /// The state after the last frame.
    pub fn state(&self) -> SessionState {
        self.state
    }

    /// A pose that is probably near, when one is fresh enough.
    pub fn prior(&self, timestamp_ms: f64) -> Option<CamFromWorld> {
        let (cam_from_world, at) = self.last?;
        let age = timestamp_ms - at;
        (0.0..=MAX_PRIOR_AGE_MS)
            .contains(&age)
            .then_some(cam_from_world)
    }

    /// Takes a located frame. `doubt` is a reason to call it limited. True when the pose jumped.
    pub fn located(
        &mut self,
        cam_from_world: &CamFromWorld,
        timestamp_ms: f64,
        doubt: Option<LimitedReason>,
    ) -> bool {
        let jumped = self.prior(timestamp_ms).is_some_and(|before| {
            let dt = self.last.map_or(0.0, |(_, at)| (timestamp_ms - at) * 1e-3);
            let (distance, angle) = cam_from_world.error_to(&before);
            distance > self.metre * (JUMP_FLOOR_M + MAX_SPEED_M_PER_S * dt)
                || angle > JUMP_FLOOR_RAD + MAX_TURN_RAD_PER_S * dt
        });
        self.last = Some((*cam_from_world, timestamp_ms));
        self.misses = 0;
        self.state = match (jumped, doubt) {
            (true, _) => SessionState::Limited(LimitedReason::Jump),
            (false, Some(reason)) => SessionState::Limited(reason),
            (false, None) => SessionState::Tracking,
        };
        jumped
    }

    /// Takes a frame without a position.
    pub fn missed(&mut self) {
        self.misses = self.misses.saturating_add(1);
        if self.misses >= MAX_MISSES || self.last.is_none() {
            self.last = None;
            self.state = SessionState::Searching;
        } else {
            self.state = SessionState::Limited(LimitedReason::Lost);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    fn at(x: f64) -> CamFromWorld {
        CamFromWorld::new(Matrix3::identity(), Vector3::new(-x, 0.0, 0.0))
    }

    #[test]
    fn walks_through_the_states() {
        let mut camera = Continuity::new(1.0);
        assert_eq!(camera.state(), SessionState::Searching);
        camera.missed();
        assert_eq!(camera.state(), SessionState::Searching);
        assert!(!camera.located(&at(0.0), 0.0, None));
        assert_eq!(camera.state(), SessionState::Tracking);
        assert!(!camera.located(&at(0.2), 33.0, Some(LimitedReason::FocalUncertain)));
        assert_eq!(
            camera.state(),
            SessionState::Limited(LimitedReason::FocalUncertain)
        );
        for _ in 0..MAX_MISSES - 1 {
            camera.missed();
            assert_eq!(camera.state(), SessionState::Limited(LimitedReason::Lost));
        }
        camera.missed();
        assert_eq!(camera.state(), SessionState::Searching);
        assert!(camera.prior(40.0).is_none());
    }

    #[test]
    fn a_jump_has_to_be_confirmed() {
        let mut camera = Continuity::new(1.0);
        camera.located(&at(0.0), 0.0, None);
        assert!(camera.located(&at(3.0), 33.0, None));
        assert_eq!(camera.state(), SessionState::Limited(LimitedReason::Jump));
        assert!(!camera.located(&at(3.1), 66.0, None));
        assert_eq!(camera.state(), SessionState::Tracking);
    }

    #[test]
    fn what_is_a_jump_follows_the_scenes_scale() {
        let mut small = Continuity::new(0.01);
        small.located(&at(0.0), 0.0, None);
        assert!(small.located(&at(0.03), 33.0, None));
        let mut large = Continuity::new(100.0);
        large.located(&at(0.0), 0.0, None);
        assert!(!large.located(&at(20.0), 33.0, None));
    }

    #[test]
    fn an_old_pose_is_no_prior() {
        let mut camera = Continuity::new(1.0);
        camera.located(&at(0.0), 0.0, None);
        assert!(camera.prior(1000.0).is_some());
        assert!(camera.prior(2500.0).is_none());
        assert!(camera.prior(-1.0).is_none());
    }
}
