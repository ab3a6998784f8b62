//! What is known of a frame that was followed, and what an answer of the relocalizer says and changes.

use crate::geometry::{CamFromWorld, Camera};
use crate::tracker::TrackLoss;
use nalgebra::Matrix6;

/// What an application should know about the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FollowState {
    /// No pose yet, or none any more.
    #[default]
    Searching,
    /// Every frame has a pose.
    Tracking,
    /// There may be a pose, and something is not as it should be.
    Limited(FollowLimit),
}

/// Why following is limited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FollowLimit {
    /// The camera moves too fast.
    ExcessiveMotion,
    /// Too little to see, or something is in front of the camera.
    InsufficientFeatures,
    /// What was to be seen has left the picture.
    OutOfView,
    /// Lost; an answer of the relocalizer is waited for.
    Relocalizing,
    /// The last answer is far from the tracked pose; the next one has to confirm it.
    Jump,
    /// No answer for a while: the pose may have drifted.
    Unconfirmed,
    /// The camera gives the same picture again and again.
    Frozen,
    /// The time of the frame is not after that of the one before.
    Clock,
    /// The size of the picture has changed.
    Resized,
}

/// How a pose came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FollowSource {
    /// The relocalizer found it in this very frame.
    Localization,
    /// It was tracked from an earlier frame.
    Tracking,
}

/// A pose of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FollowPose {
    /// For display: corrections fade in.
    pub cam_from_world: CamFromWorld,
    /// What is believed, without fading.
    pub believed: CamFromWorld,
    /// Of (rotation vector in radians, translation), left perturbation of `believed`.
    pub covariance: Matrix6<f64>,
    /// How it came about.
    pub source: FollowSource,
    /// Frames since the one that was localised last.
    pub age_frames: u64,
    /// Time since then.
    pub age_ms: f64,
    /// Points that were looked for, found, and agree.
    pub num_points: [usize; 3],
    /// Lines that were looked for, found, and agree.
    pub num_lines: [usize; 3],
    /// Median distance of what agrees, pixels of the frame.
    pub median_error_px: f64,
}

/// What an answer changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// How far the picture of the world moves for it, root mean square in pixels of the frame.
    pub distance_px: f64,
    /// Whether it is made at once, in place of fading in.
    pub is_jump: bool,
}

/// Everything about a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FollowReport {
    /// Its number, for [`Follower::hold`](super::Follower::hold) and the answers.
    pub frame: u64,
    /// Its time as given.
    pub timestamp_ms: f64,
    /// Its pose, if it has one.
    pub pose: Option<FollowPose>,
    /// State over the last frames.
    pub state: FollowState,
    /// Why the tracker found nothing in this frame.
    pub loss: Option<TrackLoss>,
    /// What an answer since the frame before has changed.
    pub correction: Option<Correction>,
}

/// What a relocalizer found in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// The frame.
    pub frame: u64,
    /// Intrinsics in pixels of the frame.
    pub camera: Camera,
    /// The pose.
    pub cam_from_world: CamFromWorld,
    /// Of (rotation vector in radians, translation), left perturbation.
    pub covariance: Matrix6<f64>,
}

/// What became of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnswerUse {
    /// It is followed from now on.
    Followed,
    /// It is far from the tracked pose and waits for the next one.
    Unconfirmed,
    /// Its frame is too old, of another size, or has too little to follow.
    Unusable(TrackLoss),
}
