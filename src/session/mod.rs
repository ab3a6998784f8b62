//! What lives over the frames of a camera: prior, state, smoothing, and the focal length of cameras that nobody calibrated.
//! [`Session`] locates every frame that it gets; [`Follower`] gives a pose to every frame of a video from seldom and late answers.
//!
//! * **In and out**: frames with their times and cameras; a [`SessionReport`] for each: the relocalizer's own, a state, and a
//!   pose for display.
//! * **Spaces and units**: as in [`crate::relocalizer`]. What counts as a jump or as fast follows the scene's units and scale.
//! * **Method**: the pose before is the solver's start for the next; the One Euro filter smooths; the median over frames is
//!   the focal length.
//! * **Invariants**: without `tracking` a frame is answered as if it were alone, but for the focal length of its camera.
//! * **Cost**: beside the relocalizer's, a few hundred operations a frame.

mod continuity;
mod error;
mod focal;
mod follow;
mod smoothing;

pub use continuity::{Continuity, LimitedReason, SessionState};
pub use error::SessionError;
pub use focal::FocalMemory;
pub use follow::{
    Answer, AnswerUse, Correction, FollowLimit, FollowOptions, FollowPose, FollowReport,
    FollowSource, FollowState, Follower,
};
pub use smoothing::{PoseFilter, Smoothing};

use crate::geometry::{CamFromWorld, Camera};
use crate::image::FrameView;
use crate::pose::{Gravity, PriorPose};
#[cfg(feature = "webgpu")]
use crate::relocalizer::Begun;
use crate::relocalizer::{CameraSource, Observed, Query, Relocalizer, Report};

/// A focal length known worse than this makes tracking limited.
const MAX_TRACKED_SIGMA_LN: f64 = 0.05;

/// How well a focal length is measured where the frame did not contradict that of the scene.
const OWN_CAMERA_SIGMA_LN: f64 = 0.02;

/// What is known about a frame of a camera besides its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SessionQuery<'a> {
    /// Intrinsics in pixels of the frame; `None` when unknown.
    pub camera: Option<Camera>,
    /// Where they come from.
    pub camera_source: CameraSource,
    /// Name under which the focal length is remembered; empty for none.
    pub camera_name: &'a str,
    /// Time of the frame.
    pub timestamp_ms: f64,
    /// Treat the frame as the next one of a moving camera.
    pub tracking: bool,
    /// Direction of gravity, if a sensor tells.
    pub gravity: Option<Gravity>,
    /// A pose that the caller believes to be near; that of the frame before when not given.
    pub prior: Option<CamFromWorld>,
}

impl Default for SessionQuery<'_> {
    fn default() -> Self {
        Self {
            camera: None,
            camera_source: CameraSource::Given,
            camera_name: "",
            timestamp_ms: 0.0,
            tracking: false,
            gravity: None,
            prior: None,
        }
    }
}

/// Everything about a frame among others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SessionReport {
    /// What the relocalizer says about the frame alone.
    pub frame: Report,
    /// State over the last frames.
    pub state: SessionState,
    /// The pose for display; `None` when smoothing is off, without `tracking`, or without a pose.
    pub smoothed: Option<CamFromWorld>,
}

/// Follows cameras in one scene.
#[derive(Debug)]
pub struct Session {
    relocalizer: Relocalizer,
    smoothing: Smoothing,
    continuity: Continuity,
    filter: PoseFilter,
    focal: FocalMemory,
}

impl Session {
    /// Starts without any knowledge of cameras; smoothing is off.
    pub fn new(relocalizer: Relocalizer) -> Self {
        let metre = relocalizer.scene_info().nominal_metre();
        Self {
            relocalizer,
            smoothing: Smoothing::Off,
            continuity: Continuity::new(metre),
            filter: PoseFilter::new(metre),
            focal: FocalMemory::default(),
        }
    }

    /// What locates single frames.
    pub fn relocalizer(&self) -> &Relocalizer {
        &self.relocalizer
    }

    /// What locates single frames, to change its options or to move its networks.
    pub fn relocalizer_mut(&mut self) -> &mut Relocalizer {
        &mut self.relocalizer
    }

    /// Changes how strongly displayed poses are smoothed.
    pub fn set_smoothing(&mut self, smoothing: Smoothing) {
        self.smoothing = smoothing;
    }

    /// Says that the relocalizer's scene is another one now: where the camera was, and how fast it may be, is measured anew.
    /// What was learned about focal lengths stays.
    pub fn scene_changed(&mut self) {
        let metre = self.relocalizer.scene_info().nominal_metre();
        self.continuity = Continuity::new(metre);
        self.filter = PoseFilter::new(metre);
    }

    /// Forgets where the camera was. What was learned about focal lengths stays.
    pub fn reset(&mut self) {
        self.continuity.reset();
        self.filter.reset();
    }

    /// Takes over the focal length (divided by the width) that an earlier session learned of a camera, as a start.
    ///
    /// # Errors
    /// [`SessionError::Recall`] for an empty name or a focal length that no camera has.
    pub fn recall_camera(&mut self, name: &str, focal_per_width: f64) -> Result<(), SessionError> {
        if self.focal.recall(name, focal_per_width) {
            return Ok(());
        }
        Err(SessionError::Recall {
            camera: name.to_owned(),
            focal_per_width,
        })
    }

    /// Locates one frame on the CPU. `clock` tells milliseconds, for timings and the time budget.
    ///
    /// # Errors
    /// [`SessionError`] for a frame, camera or time that makes no sense.
    pub fn locate(
        &mut self,
        frame: &FrameView<'_>,
        query: &SessionQuery<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<SessionReport, SessionError> {
        let alone = self.alone(query)?;
        let report = self.relocalizer.locate(frame, &alone, clock)?;
        Ok(self.follow(report, query))
    }

    /// First step of a frame, as [`Relocalizer::begin`]. The next frame may begin before this one is solved.
    ///
    /// # Errors
    /// [`SessionError`] for a frame, camera or time that makes no sense.
    #[cfg(feature = "webgpu")]
    pub async fn begin(
        &mut self,
        frame: &FrameView<'_>,
        query: &SessionQuery<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Begun, SessionError> {
        let alone = self.alone(query)?;
        Ok(self.relocalizer.begin(frame, &alone, clock).await?)
    }

    /// Second step of a frame, as [`Relocalizer::observe`].
    ///
    /// # Errors
    /// As that.
    #[cfg(feature = "webgpu")]
    pub async fn observe(
        &mut self,
        begun: Begun,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Observed, SessionError> {
        Ok(self.relocalizer.observe(begun, clock).await?)
    }

    /// Third step of a frame, as [`Relocalizer::solve`], with what earlier frames have told.
    ///
    /// # Errors
    /// As that.
    pub fn solve(
        &mut self,
        observed: Observed,
        query: &SessionQuery<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<SessionReport, SessionError> {
        let alone = self.alone(query)?;
        let report = self.relocalizer.solve(observed, &alone, clock)?;
        Ok(self.follow(report, query))
    }

    /// Finds out what was wrong with the frame that was answered last, as [`Relocalizer::explain`].
    ///
    /// # Errors
    /// As that.
    pub fn explain(
        &mut self,
        query: &SessionQuery<'_>,
        report: &SessionReport,
    ) -> Result<SessionReport, SessionError> {
        let alone = self.alone(query)?;
        let frame = self.relocalizer.explain(&alone, &report.frame)?;
        if frame.outcome.located().is_some() || report.frame.outcome.located().is_none() {
            return Ok(SessionReport { frame, ..*report });
        }
        Ok(SessionReport {
            frame,
            state: SessionState::Searching,
            smoothed: None,
        })
    }

    /// What the relocalizer is handed: all that earlier frames say about this one.
    pub(crate) fn alone(&self, query: &SessionQuery<'_>) -> Result<Query, SessionError> {
        if !query.timestamp_ms.is_finite() {
            return Err(SessionError::Timestamp(query.timestamp_ms));
        }
        let before = self.continuity.prior(query.timestamp_ms);
        Ok(Query {
            camera: query.camera,
            camera_source: query.camera_source,
            focal: self.focal.belief(query.camera_name),
            prior: query
                .prior
                .or(before.filter(|_| query.tracking))
                .map(|cam_from_world| PriorPose {
                    cam_from_world,
                    covariance: None,
                }),
            gravity: query.gravity,
        })
    }

    /// Learns from an answer and puts it in its place among the others.
    pub(crate) fn follow(&mut self, frame: Report, query: &SessionQuery<'_>) -> SessionReport {
        let found = frame.outcome.located();
        // That a camera of the scene fits is a measurement too.
        let sigma_ln = match frame.camera_source {
            CameraSource::Scene => frame.focal_sigma_ln.or(Some(OWN_CAMERA_SIGMA_LN)),
            _ => frame.focal_sigma_ln,
        };
        if let (Some(_), Some(sigma_ln)) = (found, sigma_ln) {
            let per_width = frame.camera.focal_px().0 / f64::from(frame.camera.width);
            self.focal.learn(query.camera_name, per_width, sigma_ln);
        }
        let mut smoothed = None;
        let state = match found {
            Some(_) if !query.tracking => SessionState::Tracking,
            None if !query.tracking => SessionState::Searching,
            Some(found) => {
                let doubt = frame
                    .focal_sigma_ln
                    .filter(|sigma| *sigma > MAX_TRACKED_SIGMA_LN)
                    .map(|_| LimitedReason::FocalUncertain);
                let (cam_from_world, at) = (&found.cam_from_world, query.timestamp_ms);
                if self.continuity.located(cam_from_world, at, doubt) {
                    self.filter.reset();
                }
                smoothed = self.filter.apply(self.smoothing, cam_from_world, at);
                self.continuity.state()
            }
            None => {
                self.continuity.missed();
                self.continuity.state()
            }
        };
        SessionReport {
            frame,
            state,
            smoothed,
        }
    }
}
