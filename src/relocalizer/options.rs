//! What the caller can choose, and what a frame comes with.

use super::error::CreateError;
use crate::front_end::FrontEndOptions;
use crate::geometry::Camera;
use crate::models::ExtractorKind;
use crate::nn::cpu::Level;
use crate::pose::{Focal, Gravity, PoseOptions, PriorPose};
use crate::scene_file::SceneFile;

/// Below this a believed focal length is as good as given. 1.7 % costs 5 cm at 3 m.
const FROZEN_SIGMA_LN: f64 = 0.01;

/// Options of a [`super::Relocalizer`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelocalizerOptions {
    /// How features are made. Samples and sampler are those that the scene was taught with.
    pub front_end: FrontEndOptions,
    /// Kernels of the networks on the CPU. [`Level::Portable`] gives the same bits on every machine and in the browser.
    pub kernels: Level,
    /// What may change between frames.
    pub live: LiveOptions,
}

impl RelocalizerOptions {
    /// What fits a scene.
    pub fn for_scene(scene: &SceneFile) -> Self {
        let usual = Self::for_extractor(scene.info.extractor);
        Self {
            front_end: FrontEndOptions {
                max_side: scene.info.working_max_side as usize,
                tokens: scene.config.line_tokens().unwrap_or(2),
                sampler: scene.info.sampler,
                ..usual.front_end
            },
            ..usual
        }
    }

    /// The usual ones of an extractor.
    pub fn for_extractor(extractor: ExtractorKind) -> Self {
        Self {
            front_end: FrontEndOptions::new(extractor),
            kernels: Level::best(),
            live: LiveOptions::default(),
        }
    }

    /// Checks that the options have a meaning and that the scene's networks can read what they make.
    pub(super) fn check(&self, scene: &SceneFile) -> Result<(), CreateError> {
        self.live.check()?;
        let taught = Self::for_scene(scene).front_end;
        // Without lines nobody looks at samples of segments.
        let has_lines = scene.config.line_tokens().is_some();
        if has_lines && self.front_end.tokens != taught.tokens {
            return Err(CreateError::Option {
                name: "front_end.tokens",
                value: self.front_end.tokens as f64,
                expected: "what the scene was taught with",
            });
        }
        if self.front_end.sampler != taught.sampler {
            return Err(CreateError::Sampler {
                found: self.front_end.sampler.name(),
                taught: taught.sampler.name(),
            });
        }
        Ok(())
    }
}

/// Options that may change between frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiveOptions {
    /// Most points that the solver gets: the most confident.
    pub max_points: usize,
    /// Most lines that the solver gets.
    pub max_lines: usize,
    /// The solver; thresholds are in pixels of the working image. What is known about one frame (focal length, gravity,
    /// prior) comes with its [`Query`] and is refused here.
    pub pose: PoseOptions,
    /// Look again from the first pose, where the scene has landmarks.
    pub look_again: bool,
}

impl Default for LiveOptions {
    fn default() -> Self {
        Self {
            // On RedKitchen 800-899 this locates all pictures within 5 cm and 5 degrees where 300 and 150 leave one out;
            // the solver takes 25 instead of 14 ms.
            max_points: 600,
            max_lines: 300,
            // Hopeless frames use up all iterations: with 100,000 they would cost seconds. Good ones stop after hundreds.
            pose: PoseOptions {
                max_iterations: 10_000,
                ..PoseOptions::default()
            },
            look_again: true,
        }
    }
}

impl LiveOptions {
    /// Checks that every option has a meaning.
    ///
    /// # Errors
    /// [`CreateError`] names the first that has none.
    pub fn check(&self) -> Result<(), CreateError> {
        self.pose.validate()?;
        let of_a_frame = [
            ("focal", self.pose.focal != Focal::Known),
            ("gravity", self.pose.gravity.is_some()),
            ("prior", self.pose.prior.is_some()),
        ];
        match of_a_frame.into_iter().find(|(_, is_set)| *is_set) {
            Some((name, _)) => Err(CreateError::OfAFrame(name)),
            None => Ok(()),
        }
    }
}

/// How the intrinsics of a frame came to be known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraSource {
    /// By the caller, as exact.
    Given,
    /// By the camera's own settings.
    Track,
    /// By the picture's EXIF block: a few percent off.
    Exif,
    /// By the scene: the camera of the pictures that taught it, for pictures of the same shape.
    Scene,
    /// From earlier frames of the same camera.
    Remembered,
    /// Solved from this frame.
    Estimated,
    /// A guess.
    Assumed,
}

impl CameraSource {
    /// Relative standard deviation of the focal length, where the source is not exact.
    pub(super) fn sigma_ln(self) -> Option<f64> {
        match self {
            Self::Given | Self::Track | Self::Scene => None,
            // EXIF gives whole millimetres of the 35 mm equivalent: half a step of 26 is 2 %, and crops add to it.
            Self::Exif => Some(0.05),
            Self::Remembered | Self::Estimated | Self::Assumed => Some(0.25),
        }
    }
}

/// What is believed about the focal length of a camera whose intrinsics nobody told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalBelief {
    /// Focal length divided by the picture's width.
    pub focal_per_width: f64,
    /// Standard deviation of its logarithm.
    pub sigma_ln: f64,
}

impl FocalBelief {
    /// True when it need not be estimated any more.
    pub fn is_frozen(&self) -> bool {
        self.sigma_ln <= FROZEN_SIGMA_LN
    }
}

/// What is known about one frame besides its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Query {
    /// Intrinsics in pixels of the frame; `None` when unknown: a camera of the scene that takes pictures of the frame's shape is
    /// the start then, and what is found says whether it was that one.
    pub camera: Option<Camera>,
    /// Where they come from.
    pub camera_source: CameraSource,
    /// What is believed about the focal length; used without `camera`.
    pub focal: Option<FocalBelief>,
    /// A pose that is probably near.
    pub prior: Option<PriorPose>,
    /// Direction of gravity, if a sensor tells.
    pub gravity: Option<Gravity>,
}

impl Default for Query {
    fn default() -> Self {
        Self {
            camera: None,
            camera_source: CameraSource::Given,
            focal: None,
            prior: None,
            gravity: None,
        }
    }
}

impl Query {
    /// A picture of a known camera.
    pub fn with_camera(camera: Camera) -> Self {
        Self {
            camera: Some(camera),
            ..Self::default()
        }
    }
}
