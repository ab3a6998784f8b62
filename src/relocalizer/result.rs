//! What comes out of a frame.

use super::options::CameraSource;
use super::timings::StageTimings;
use crate::geometry::{CamFromWorld, Camera};
use crate::landmarks::FoundAgain;
use crate::pose::{PoseEstimate, PoseStats, PoseStatus};

/// Why a frame was not located.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotLocated {
    /// Hardly any keypoints or segments: a wall, darkness, blur.
    FewFeatures,
    /// The networks are sure of too few of them.
    FewCorrespondences,
    /// No pose explains them better than chance.
    FewInliers,
    /// They leave the pose or the focal length open.
    Degenerate,
    /// Two clearly different poses explain them almost equally well.
    Ambiguous,
    /// The time budget ran out first.
    Timeout,
    /// Hardly anything of what the scene should show is there from any position: another place, or a part that was not taught.
    OtherPlace,
    /// Many more things would agree if the world were mirrored: a mirrored picture, or a left-handed scene.
    Mirrored,
    /// It is located with another focal length than that of the intrinsics that came with it. From [`super::Relocalizer::explain`].
    FocalMismatch,
    /// It is located once it is turned by so many degrees clockwise: 90, 180 or 270. From [`super::Relocalizer::explain`].
    Turned {
        /// In degrees.
        clockwise_deg: u16,
    },
}

impl NotLocated {
    /// The solver's status as a reason; `None` for a pose that can be used.
    pub(super) fn from_status(status: PoseStatus) -> Option<Self> {
        match status {
            PoseStatus::Ok => None,
            PoseStatus::TooFew => Some(Self::FewCorrespondences),
            PoseStatus::LowInliers => Some(Self::FewInliers),
            PoseStatus::Degenerate => Some(Self::Degenerate),
            PoseStatus::Ambiguous => Some(Self::Ambiguous),
            PoseStatus::OutOfTime => Some(Self::Timeout),
        }
    }

    /// What happened and what helps, for people.
    pub fn message(self) -> &'static str {
        match self {
            Self::FewFeatures => {
                "too little to see: show something with edges and texture, or add light"
            }
            Self::FewCorrespondences => {
                "hardly anything looks like the taught scene: probably another place"
            }
            Self::FewInliers => {
                "what is seen does not agree on one position: show a larger part of the scene"
            }
            Self::Degenerate => {
                "the view leaves the position open: show more depth or more directions"
            }
            Self::Ambiguous => "two positions fit almost equally well: show what exists only once",
            Self::OtherPlace => {
                "not this place, or a part of it that was not taught: what the scene should show is there from no position"
            }
            Self::Mirrored => {
                "mirrored: it fits only as seen in a mirror; turn off the mirroring of the camera or the picture"
            }
            Self::FocalMismatch => {
                "focal mismatch: it is located, but with another focal length than the given one: give that of this picture, or none"
            }
            Self::Turned { clockwise_deg: 90 } => {
                "turned: it is located once it is turned by 90 degrees clockwise; turn the picture, or keep its EXIF orientation"
            }
            Self::Turned { clockwise_deg: 270 } => {
                "turned: it is located once it is turned by 90 degrees counter-clockwise; turn the picture, or keep its EXIF \
                 orientation"
            }
            Self::Turned { .. } => {
                "turned: it is located once it is turned by 180 degrees; turn the picture, or keep its EXIF orientation"
            }
            Self::Timeout => "the time budget ended first: allow more, or show more of the scene",
        }
    }
}

/// A pose that can be used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Localization {
    /// As solved from this frame.
    pub cam_from_world: CamFromWorld,
    /// The solver's full answer. Its camera is that of the working image.
    pub estimate: PoseEstimate,
    /// Median reprojection error of the inliers, pixels of the frame.
    pub median_error_px: f64,
    /// 0..1: how probably the pose is right (within 25 cm), from the evidence above chance and, where the scene has landmarks, from
    /// how many of those that the pose shows were found again. At most 0.89 where nobody told the camera: it is known from this frame
    /// alone, or taken to be the scene's while the frame itself, a flat wall for one, does not tell the focal length.
    pub confidence: f64,
}

/// Located or not.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "one per frame, and boxing would allocate"
)]
pub enum Outcome {
    /// With a pose.
    Located(Localization),
    /// Without one, and why.
    NotLocated(NotLocated),
}

impl Outcome {
    /// The pose, when there is one.
    pub fn located(&self) -> Option<&Localization> {
        match self {
            Self::Located(localization) => Some(localization),
            Self::NotLocated(_) => None,
        }
    }
}

/// How many of everything.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Keypoints.
    pub num_keypoints: usize,
    /// Segments that were given to the network.
    pub num_segments: usize,
    /// Points that entered the solver.
    pub num_point_correspondences: usize,
    /// Lines that entered the solver.
    pub num_line_correspondences: usize,
    /// Points that agree with the pose.
    pub num_point_inliers: usize,
    /// Lines that agree with the pose.
    pub num_line_inliers: usize,
}

impl Counts {
    /// Points and lines that agree with the pose, as a share of those that entered the solver; 0 of none.
    pub(super) fn agreeing_share(&self) -> f64 {
        let agreeing = self.num_point_inliers + self.num_line_inliers;
        let all = self.num_point_correspondences + self.num_line_correspondences;
        agreeing as f64 / all.max(1) as f64
    }
}

/// Everything about one frame, besides the correspondences, which the relocalizer keeps until the next frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Located or not.
    pub outcome: Outcome,
    /// Whether the networks of this frame ran on the GPU.
    pub on_gpu: bool,
    /// Intrinsics that were used, in pixels of the frame, with the focal length as solved.
    pub camera: Camera,
    /// Where they come from.
    pub camera_source: CameraSource,
    /// Whether it contradicts the intrinsics that came with it, or were learned from earlier ones: [`Self::camera`] is a solved one
    /// then.
    pub has_focal_mismatch: bool,
    /// Relative standard deviation of the focal length; `None` when it was given.
    pub focal_sigma_ln: Option<f64>,
    /// How many of everything.
    pub counts: Counts,
    /// What was found again of the scene's landmarks, where there was a pose to look from.
    pub found_again: Option<FoundAgain>,
    /// Where the solver spent its effort.
    pub pose_stats: PoseStats,
    /// Where the time went.
    pub timings: StageTimings,
}
