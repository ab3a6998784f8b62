//! A pose for every frame of a camera, from answers of a relocalizer that come late and seldom.
//!
//! * **In and out**: every frame with its time; the answers of a relocalizer, which runs wherever it likes, for some of them; a
//!   [`FollowReport`] for each frame.
//! * **Method**: an answer makes its frame the reference of a [`Tracker`], which is followed to the newest frame from there, the
//!   first time by the turn that small pictures of the frames tell;
//!   answers are averaged along the tracked movement, because each is off by as much as the tracker drifts between them; a
//!   correction fades in, unless it is large: then the next answer has to confirm it, and it is made at once.
//! * **Invariants**: no frame is an error but one that makes no sense in itself; what is wrong is a state with a reason. Any
//!   times are taken.
//! * **Cost**: the tracker's; no allocation once sizes and numbers were seen.

mod motion;
mod report;
#[cfg(test)]
mod tests;

use crate::geometry::{CamFromWorld, vector_from_rotation};
use crate::image::{FrameView, ImageError};
use crate::pose::{LineCorrespondence, PointCorrespondence};
use crate::tracker::{TrackLoss, Tracked, Tracker, TrackerOptions};
use motion::{Blend, Change, Motion};
use nalgebra::Matrix3;
pub use report::{
    Answer, AnswerUse, Correction, FollowLimit, FollowPose, FollowReport, FollowSource, FollowState,
};

/// How a camera is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FollowOptions {
    /// The tracker.
    pub tracker: TrackerOptions,
    /// A correction fades in over this time.
    pub blend_ms: f64,
    /// An answer that is further than this from the tracked pose, for the eye, has to be confirmed: share of the longer side of
    /// the picture.
    pub max_correction: f64,
    /// Weight of an answer against the tracked pose, which comes from the answers before: the mean of both by default, because
    /// from one answer to the next the tracker gets about as far off as an answer is.
    pub gain: f64,
    /// Without an answer for longer than this the pose is called limited: it may have drifted.
    pub max_unconfirmed_ms: f64,
    /// The same picture again and again for longer than this is a camera that hangs.
    pub max_frozen_ms: f64,
}

impl Default for FollowOptions {
    fn default() -> Self {
        Self {
            tracker: TrackerOptions::default(),
            blend_ms: 150.0,
            max_correction: 0.03,
            gain: 0.5,
            max_unconfirmed_ms: 2000.0,
            max_frozen_ms: 500.0,
        }
    }
}

/// Frames after a loss that are still looked at, in case something only passed by: a second and a half of a usual camera, and
/// within the reach of the small pictures that tell how it turned meanwhile.
const MAX_RETRIES: u32 = 45;
/// After so many of them something did more than pass by.
const LONG_LOSS: u32 = 7;
/// Poses of past frames that are kept, for answers to be compared with.
const HISTORY: usize = 64;
/// Steps from an answer's frame to the newest one, where nothing is known of the movement between.
const MAX_HOPS: u64 = 5;
/// A loss at a faster turn than this is put down to it, in radians a second.
const FAST_RAD_PER_S: f64 = 1.5;

/// A sensor's turn from frame to frame that is further than this from what small pictures tell is not believed. They take a
/// step for a turn, by two degrees when walking past something a metre away.
const MAX_LIE_RAD: f64 = 0.09;

/// A frame's pose as the tracker found it.
#[derive(Debug, Clone, Copy)]
struct Past {
    frame: u64,
    cam_from_world: CamFromWorld,
}

/// Follows one camera.
#[derive(Debug)]
pub struct Follower {
    options: FollowOptions,
    tracker: Tracker,
    motion: Motion,
    blend: Blend,
    history: Vec<Past>,
    next_past: usize,
    newest: Option<(u64, f64)>,
    /// The frame of the motion's last pose.
    posed: Option<u64>,
    /// Of the frame that was localised last.
    localized: Option<(u64, f64)>,
    /// An answer far from the tracked pose, as a change of it.
    doubted: Option<Change>,
    correction: Option<Correction>,
    is_tracking: bool,
    num_misses: u32,
    last_loss: Option<TrackLoss>,
    was_fast: bool,
    size: (u32, u32),
    digest: u64,
    same_since_ms: f64,
    times: Vec<(u64, f64)>,
}

impl Default for Follower {
    fn default() -> Self {
        Self::new(FollowOptions::default())
    }
}

impl Follower {
    /// Starts without any knowledge.
    pub fn new(options: FollowOptions) -> Self {
        Self {
            options,
            tracker: Tracker::new(options.tracker),
            motion: Motion::default(),
            blend: Blend::default(),
            history: Vec::with_capacity(HISTORY),
            next_past: 0,
            newest: None,
            posed: None,
            localized: None,
            doubted: None,
            correction: None,
            is_tracking: false,
            num_misses: 0,
            last_loss: None,
            was_fast: false,
            size: (0, 0),
            digest: 0,
            same_since_ms: 0.0,
            times: Vec::with_capacity(HISTORY),
        }
    }

    /// The options in use.
    pub fn options(&self) -> &FollowOptions {
        &self.options
    }

    /// Forgets where the camera was, as for another scene.
    pub fn reset(&mut self) {
        self.tracker.forget();
        self.lose();
        self.newest = None;
        self.last_loss = None;
    }

    fn lose(&mut self) {
        self.motion.reset();
        self.posed = None;
        self.blend.clear();
        self.history.clear();
        self.next_past = 0;
        self.localized = None;
        self.doubted = None;
        self.is_tracking = false;
        self.num_misses = 0;
    }

    /// Keeps a frame's picture, because it goes to the relocalizer. False when it is gone already.
    pub fn hold(&mut self, frame: u64) -> bool {
        self.tracker.hold(frame)
    }

    /// Bytes of the pictures that are kept.
    pub fn picture_bytes(&self) -> usize {
        self.tracker.picture_bytes()
    }

    /// A pose that is probably near that of the newest frame, for the relocalizer.
    pub fn prior(&self) -> Option<CamFromWorld> {
        self.is_tracking.then(|| self.motion.last()).flatten()
    }

    /// Takes the next frame. `turned` is how the camera has turned since the frame before, as a sensor says
    /// (`cam_now_from_cam_before`).
    ///
    /// # Errors
    /// [`ImageError`] for a frame that makes no sense; nothing has changed then.
    pub fn frame(
        &mut self,
        frame: &FrameView<'_>,
        timestamp_ms: f64,
        turned: Option<&Matrix3<f64>>,
    ) -> Result<FollowReport, ImageError> {
        let number = self.tracker.push(frame)?;
        let size = (frame.width, frame.height);
        let was_resized = self.newest.is_some() && size != self.size;
        self.size = size;
        if was_resized {
            self.lose();
        }
        let now_ms = self.time(timestamp_ms);
        let before = self.newest;
        let is_clock_wrong =
            !timestamp_ms.is_finite() || before.is_some_and(|(_, at)| now_ms <= at);
        if is_clock_wrong && let Some(last) = self.motion.last() {
            // No speed follows from such times.
            self.motion.reset();
            self.motion.add(&last, now_ms);
        }
        let is_frozen = self.is_frozen(frame, now_ms);
        self.newest = Some((number, now_ms));
        self.remember_time(number, now_ms);

        let turned = self.believed_turn(turned, number).or_else(|| {
            let from = self.posed.filter(|_| !self.motion.knows_speed())?;
            self.tracker.turned(from, number)
        });
        let expected = self.motion.expected(now_ms, turned.as_ref());
        let mut loss = None;
        let mut pose = None;
        if let Some(expected) = expected {
            let last = self.motion.last();
            self.was_fast = last.is_some_and(|last| {
                let seconds = before.map_or(0.033, |(_, at)| 1e-3 * (now_ms - at).max(1.0));
                expected.rotation_angle_to(&last) > FAST_RAD_PER_S * seconds
            });
            match self.track(number, &expected) {
                Ok(tracked) => pose = Some(self.found(number, now_ms, &tracked)),
                Err(why) => {
                    loss = Some(why);
                    self.missed(why);
                }
            }
        }
        let correction = if pose.is_some() {
            self.correction.take()
        } else {
            None
        };
        let state = self.state(
            now_ms,
            was_resized,
            is_clock_wrong,
            is_frozen,
            pose.is_some(),
        );
        Ok(FollowReport {
            frame: number,
            timestamp_ms,
            pose,
            state,
            loss,
            correction,
        })
    }

    /// A sensor's turn since the frame before, unless it is none or pictures contradict it.
    fn believed_turn(&self, turned: Option<&Matrix3<f64>>, number: u64) -> Option<Matrix3<f64>> {
        let turned = turned.copied().filter(is_turn)?;
        let before = number.checked_sub(1)?;
        let seen = self.tracker.turned(before, number);
        let off = seen.map_or(0.0, |seen| {
            vector_from_rotation(&(turned * seen.transpose())).norm()
        });
        (off < MAX_LIE_RAD).then_some(turned)
    }

    /// From where the camera should be, else from where it was and turned as the pictures say, else from where it was.
    fn track(&mut self, number: u64, expected: &CamFromWorld) -> Result<Tracked, TrackLoss> {
        let first = self.tracker.track(number, expected);
        let (Err(_), Some(last)) = (&first, self.motion.last()) else {
            return first;
        };
        let turn = self
            .posed
            .and_then(|from| self.tracker.turned(from, number));
        if let Some(turn) = turn {
            let turned = turned_by(&last, &turn);
            if let Ok(tracked) = self.tracker.track(number, &turned) {
                return Ok(tracked);
            }
        }
        if last == *expected {
            return first;
        }
        self.tracker.track(number, &last)
    }

    fn found(&mut self, number: u64, now_ms: f64, tracked: &Tracked) -> FollowPose {
        let believed = tracked.cam_from_world;
        self.motion.add(&believed, now_ms);
        self.posed = Some(number);
        self.is_tracking = true;
        self.num_misses = 0;
        self.last_loss = None;
        let past = Past {
            frame: number,
            cam_from_world: believed,
        };
        if self.history.len() < HISTORY {
            self.history.push(past);
        } else {
            self.history[self.next_past] = past;
        }
        self.next_past = (self.next_past + 1) % HISTORY;
        let cam_from_world = self.blend.shown(&believed, now_ms, self.options.blend_ms);
        let (localized, at) = self.localized.unwrap_or((number, now_ms));
        FollowPose {
            cam_from_world,
            believed,
            covariance: tracked.covariance,
            source: if localized == number {
                FollowSource::Localization
            } else {
                FollowSource::Tracking
            },
            age_frames: number.saturating_sub(localized),
            age_ms: now_ms - at,
            num_points: tracked.num_points,
            num_lines: tracked.num_lines,
            median_error_px: tracked.median_error_px,
        }
    }

    fn missed(&mut self, why: TrackLoss) {
        self.num_misses = self.num_misses.saturating_add(1);
        self.is_tracking = false;
        self.last_loss = Some(why);
        self.blend.clear();
        if self.num_misses > MAX_RETRIES {
            self.lose();
            self.tracker.forget();
            self.last_loss = Some(why);
        }
    }

    fn state(
        &self,
        now_ms: f64,
        was_resized: bool,
        is_clock_wrong: bool,
        is_frozen: bool,
        has_pose: bool,
    ) -> FollowState {
        if is_frozen {
            return FollowState::Limited(FollowLimit::Frozen);
        }
        if was_resized {
            return FollowState::Limited(FollowLimit::Resized);
        }
        if has_pose {
            let unconfirmed = self
                .localized
                .is_some_and(|(_, at)| now_ms - at > self.options.max_unconfirmed_ms);
            return if is_clock_wrong {
                FollowState::Limited(FollowLimit::Clock)
            } else if self.doubted.is_some() {
                FollowState::Limited(FollowLimit::Jump)
            } else if unconfirmed {
                FollowState::Limited(FollowLimit::Unconfirmed)
            } else {
                FollowState::Tracking
            };
        }
        if !self.tracker.has_reference() {
            return FollowState::Searching;
        }
        FollowState::Limited(match self.last_loss {
            Some(_) if self.num_misses > LONG_LOSS => FollowLimit::Relocalizing,
            Some(TrackLoss::OutOfView) => FollowLimit::OutOfView,
            Some(TrackLoss::FewFound | TrackLoss::Disagreement) if self.was_fast => {
                FollowLimit::ExcessiveMotion
            }
            Some(TrackLoss::FewFound | TrackLoss::Disagreement) => {
                FollowLimit::InsufficientFeatures
            }
            _ => FollowLimit::Relocalizing,
        })
    }

    /// Takes what the relocalizer found in a frame: its pose, and the points and lines that agree with it, in pixels of that
    /// frame. The frame may be a while ago.
    pub fn localized(
        &mut self,
        answer: &Answer,
        points: impl Iterator<Item = PointCorrespondence>,
        lines: impl Iterator<Item = LineCorrespondence>,
    ) -> AnswerUse {
        let Some((newest, now_ms)) = self.newest else {
            return AnswerUse::Unusable(TrackLoss::NoFrame);
        };
        let past = self
            .history
            .iter()
            .find(|past| past.frame == answer.frame)
            .filter(|_| self.is_tracking)
            .map(|past| past.cam_from_world);
        let Some(past) = past else {
            return self.start(answer, newest, now_ms, points, lines);
        };
        let longest = f64::from(self.size.0.max(self.size.1));
        let limit = self.options.max_correction * longest;
        let distance_px = self.tracker.distance_px(&answer.cam_from_world, &past);
        let change = Change::between(&past, &answer.cam_from_world);
        let is_far = !(distance_px <= limit);
        // Far off, but where the answer before was too.
        let is_confirmed = is_far
            && self.doubted.is_some_and(|doubted| {
                let other = doubted.applied(&past, 1.0);
                self.tracker.distance_px(&answer.cam_from_world, &other) <= limit
            });
        if is_far && !is_confirmed {
            self.doubted = Some(change);
            return AnswerUse::Unconfirmed;
        }
        self.doubted = None;
        let gain = if is_confirmed { 1.0 } else { self.options.gain };
        let fused = change.applied(&past, gain);
        let shown = self
            .motion
            .last()
            .map(|last| self.blend.shown(&last, now_ms, self.options.blend_ms));
        if let Err(why) = self.refer(answer, &fused, points, lines) {
            return AnswerUse::Unusable(why);
        }
        // The movement since then is known: all later poses change alike.
        let change = change.scaled(gain);
        self.motion.correct(&change);
        for past in &mut self.history {
            past.cam_from_world = change.applied(&past.cam_from_world, 1.0);
        }
        if let (Some(shown), Some(believed)) = (shown, self.motion.last()) {
            if is_confirmed {
                self.blend.clear();
            } else {
                self.blend.start(&shown, &believed, now_ms);
            }
        }
        self.correction = Some(Correction {
            distance_px: gain * distance_px,
            is_jump: is_confirmed,
        });
        AnswerUse::Followed
    }

    /// Takes note that the relocalizer found nothing in a frame.
    pub fn not_located(&mut self, frame: u64) {
        // An answer that was doubted is not confirmed by silence; the picture need not be kept.
        let _ = frame;
        self.doubted = None;
    }

    /// Makes an answer's frame the reference.
    fn refer(
        &mut self,
        answer: &Answer,
        cam_from_world: &CamFromWorld,
        points: impl Iterator<Item = PointCorrespondence>,
        lines: impl Iterator<Item = LineCorrespondence>,
    ) -> Result<(), TrackLoss> {
        self.tracker.refer(
            answer.frame,
            &answer.camera,
            cam_from_world,
            &answer.covariance,
            points,
            lines,
        )?;
        self.localized = Some((answer.frame, self.time_of(answer.frame)));
        Ok(())
    }

    /// From an answer to the newest frame, with no movement known between.
    fn start(
        &mut self,
        answer: &Answer,
        newest: u64,
        now_ms: f64,
        points: impl Iterator<Item = PointCorrespondence>,
        lines: impl Iterator<Item = LineCorrespondence>,
    ) -> AnswerUse {
        self.lose();
        if let Err(why) = self.refer(answer, &answer.cam_from_world, points, lines) {
            return AnswerUse::Unusable(why);
        }
        self.motion
            .add(&answer.cam_from_world, self.time_of(answer.frame));
        self.posed = Some(answer.frame);
        // At once, turned as the pictures say; step by step where that does not do.
        let turn = self.tracker.turned(answer.frame, newest);
        let expected = turn.map(|turn| turned_by(&answer.cam_from_world, &turn));
        if let Some(expected) = expected
            && let Ok(tracked) = self.tracker.track(newest, &expected)
        {
            self.found(newest, now_ms, &tracked);
            return AnswerUse::Followed;
        }
        let stride = (newest.saturating_sub(answer.frame))
            .div_ceil(MAX_HOPS)
            .max(1);
        let mut at = answer.frame;
        while at < newest {
            at = (at + stride).min(newest);
            // Pictures between may be gone; the newest is not.
            if !self.tracker.has(at) {
                continue;
            }
            let time = self.time_of(at);
            let Some(expected) = self.motion.expected(time, None) else {
                break;
            };
            match self.track(at, &expected) {
                Ok(tracked) if at == newest => {
                    self.found(newest, now_ms, &tracked);
                }
                Ok(tracked) => {
                    self.motion.add(&tracked.cam_from_world, time);
                    self.posed = Some(at);
                }
                // The next hop or frame may succeed.
                Err(why) => self.last_loss = Some(why),
            }
        }
        AnswerUse::Followed
    }

    /// A time that can be computed with: that of the frame, or where it is none, that of the frame before.
    fn time(&self, timestamp_ms: f64) -> f64 {
        if timestamp_ms.is_finite() {
            timestamp_ms
        } else {
            self.newest.map_or(0.0, |(_, at)| at)
        }
    }

    fn remember_time(&mut self, frame: u64, at: f64) {
        if self.times.len() < HISTORY {
            self.times.push((frame, at));
        } else {
            self.times[(frame % HISTORY as u64) as usize] = (frame, at);
        }
    }

    fn time_of(&self, frame: u64) -> f64 {
        let known = self.times.iter().find(|(number, _)| *number == frame);
        known.or(self.times.first()).map_or(0.0, |(_, at)| *at)
    }

    /// Whether the camera has given the same bytes for a while.
    fn is_frozen(&mut self, frame: &FrameView<'_>, now_ms: f64) -> bool {
        let digest = digest(frame);
        let same = self.newest.is_some() && digest == self.digest;
        self.digest = digest;
        if !same || now_ms < self.same_since_ms {
            self.same_since_ms = now_ms;
        }
        same && now_ms - self.same_since_ms > self.options.max_frozen_ms
    }
}

/// The pose of a camera that turned where it was.
fn turned_by(pose: &CamFromWorld, turn: &Matrix3<f64>) -> CamFromWorld {
    CamFromWorld::new(turn * pose.rotation, turn * pose.translation)
}

/// Whether a matrix that a sensor gives is a turn.
fn is_turn(m: &Matrix3<f64>) -> bool {
    let off = (m * m.transpose() - Matrix3::identity()).amax();
    off < 1e-3 && m.determinant() > 0.0
}

/// Of a few thousand bytes all over the picture: sensor noise alone changes it. FNV-1a.
fn digest(frame: &FrameView<'_>) -> u64 {
    let step = (frame.bytes.len() / 4096).max(1) | 1;
    let mut hash = 0xCBF2_9CE4_8422_2325_u64;
    for byte in frame.bytes.iter().step_by(step) {
        hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01B3);
    }
    hash
}
