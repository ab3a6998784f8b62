//! The pipeline: a frame in, located or not out.
//!
//! * **In and out**: a [`FrameView`] and what is known about its camera; a [`Report`]. That a frame is not located is a
//!   result with a reason, not an error.
//! * **Spaces and units**: the caller deals in pixels of the frame and in the world; detection, extraction and the solver work
//!   in pixels of the working image, so that thresholds mean the same for every camera.
//! * **Method**: grey, resize, extractor, segments, the scene's two branches, correspondences, solver; over several frames a
//!   prior from the last pose, a state, smoothing, and the remembered focal length of cameras that nobody calibrated.
//!   With the networks on a device a frame is taken in three steps, so that the next one's networks run while its pose is
//!   solved: `Relocalizer::begin`, `Relocalizer::observe`, [`Relocalizer::solve`].
//! * **Invariants**: the same frame, options and seed give the same pose; with the portable kernels, the only ones in the browser,
//!   on every machine. The core reads no clock of its own.
//! * **Cost**: all buffers are kept from frame to frame; a change of the working size builds the extractor's plan anew.

#[cfg(feature = "webgpu")]
mod backend;
#[cfg(feature = "webgpu")]
mod calibration;
mod correspond;
mod error;
mod focal;
#[cfg(feature = "webgpu")]
mod gpu;
mod last_frame;
mod options;
mod result;
mod smoothing;
mod steps;
mod timings;
mod tracking;

pub use error::{CreateError, LocateError};
pub use focal::{FocalBelief, FocalMemory};
#[cfg(feature = "webgpu")]
pub use gpu::GpuNetworks;
pub use options::{CameraSource, Query, RelocalizerOptions};
pub use result::{Counts, Localization, NotLocated, Outcome, Report};
pub use smoothing::{PoseFilter, Smoothing};
pub use steps::{Begun, Observed};
pub use timings::StageTimings;
pub use tracking::{LimitedReason, Track, TrackState};

use crate::front_end::{FrontEnd, FrontEndOptions};
use crate::geometry::{Camera, WorkingFromSensor};
use crate::pose::{Focal, LineCorrespondence, PointCorrespondence, PoseScratch};
use crate::regress::{Predictions, Regressor};
use crate::scene_file::{ExtractorFile, SceneFile, SceneInfo};

/// Focal length divided by the longer side where nothing is known: the middle of phones' video cameras.
const ASSUMED_FOCAL: f64 = 0.85;
/// Finds cameras in one scene.
#[derive(Debug)]
pub struct Relocalizer {
    info: SceneInfo,
    options: RelocalizerOptions,
    front_end: FrontEnd,
    regressor: Regressor,
    predictions: Predictions,
    order: Vec<(f32, usize)>,
    points: Vec<PointCorrespondence>,
    lines: Vec<LineCorrespondence>,
    is_point_inlier: Vec<bool>,
    is_line_inlier: Vec<bool>,
    errors_px: Vec<f32>,
    pose: PoseScratch,
    track: Track,
    filter: PoseFilter,
    focal: FocalMemory,
    /// Of the frame that was answered last; the front end may hold a later one already.
    working_from_sensor: WorkingFromSensor,
    /// Frames begun so far.
    num_begun: u64,
    /// Frames whose networks have run.
    num_observed: u64,
    #[cfg(feature = "webgpu")]
    backend: backend::Backend,
}

impl Relocalizer {
    /// Builds the networks of a scene and its extractor. `change` may alter the options that follow from the scene.
    ///
    /// # Errors
    /// [`CreateError`] when the two files do not belong together or an option has no meaning.
    pub fn new(
        scene: SceneFile,
        extractor: ExtractorFile,
        change: impl FnOnce(&mut RelocalizerOptions),
    ) -> Result<Self, CreateError> {
        scene
            .check_extractor(&extractor)
            .map_err(CreateError::Scene)?;
        let mut options = RelocalizerOptions::new(extractor.kind);
        options.max_side = scene.info.working_max_side as usize;
        change(&mut options);
        options.pose.validate()?;
        let front_end = FrontEnd::new(
            extractor,
            FrontEndOptions {
                max_side: options.max_side,
                keypoints: options.keypoints,
                lsd: options.lsd,
                min_segment_px: options.min_segment_px,
                max_segments: options.max_segments,
                tokens: scene.config.line_tokens().unwrap_or(2),
                sampler: scene.info.sampler,
            },
        )?
        .with_level(options.kernels);
        let info = scene.info.clone();
        let regressor = Regressor::with_level(
            &scene.config,
            scene.weights,
            info.scale,
            options.keypoints.max_keypoints,
            options.max_segments,
            options.kernels,
        )
        .map_err(CreateError::Networks)?;
        Ok(Self {
            info,
            options,
            front_end,
            regressor,
            predictions: Predictions::default(),
            order: Vec::new(),
            points: Vec::new(),
            lines: Vec::new(),
            is_point_inlier: Vec::new(),
            is_line_inlier: Vec::new(),
            errors_px: Vec::new(),
            pose: PoseScratch::default(),
            track: Track::default(),
            filter: PoseFilter::default(),
            focal: FocalMemory::default(),
            working_from_sensor: WorkingFromSensor::from_scale(1.0, 1.0),
            num_begun: 0,
            num_observed: 0,
            #[cfg(feature = "webgpu")]
            backend: backend::Backend::default(),
        })
    }

    /// [`Self::new`] from the bytes of the two files.
    ///
    /// # Errors
    /// [`CreateError`].
    pub fn from_bytes(
        scene: &[u8],
        extractor: &[u8],
        change: impl FnOnce(&mut RelocalizerOptions),
    ) -> Result<Self, CreateError> {
        let scene = SceneFile::from_bytes(scene).map_err(CreateError::Scene)?;
        let extractor = ExtractorFile::from_bytes(extractor).map_err(CreateError::Extractor)?;
        Self::new(scene, extractor, change)
    }

    /// What the scene file says about itself.
    pub fn scene_info(&self) -> &SceneInfo {
        &self.info
    }

    /// The options in use.
    pub fn options(&self) -> &RelocalizerOptions {
        &self.options
    }

    /// Changes options between frames. What concerns the networks (keypoints, detector, segments, kernels) stays as it was
    /// when the relocalizer was made.
    ///
    /// # Errors
    /// [`CreateError`] when an option has no meaning; nothing has changed then.
    pub fn set_options(
        &mut self,
        change: impl FnOnce(&mut RelocalizerOptions),
    ) -> Result<(), CreateError> {
        let mut options = self.options;
        change(&mut options);
        options.pose.validate()?;
        self.front_end.set_max_side(options.max_side)?;
        self.options = RelocalizerOptions {
            keypoints: self.options.keypoints,
            lsd: self.options.lsd,
            min_segment_px: self.options.min_segment_px,
            max_segments: self.options.max_segments,
            kernels: self.options.kernels,
            ..options
        };
        Ok(())
    }

    /// Forgets where the camera was. What was learned about focal lengths stays.
    pub fn reset(&mut self) {
        self.track = Track::default();
        self.filter.reset();
    }

    /// Takes over the focal length (divided by the width) that an earlier session learned of a camera, as a start.
    ///
    /// # Errors
    /// [`CreateError::Option`] for an empty name or a focal length that no camera has.
    pub fn recall_camera(&mut self, name: &str, focal_per_width: f64) -> Result<(), CreateError> {
        if self.focal.recall(name, focal_per_width) {
            return Ok(());
        }
        Err(CreateError::Option {
            name: "focal_per_width",
            value: focal_per_width,
            expected: "0.13 to 20, for a camera that has a name",
        })
    }

    /// Moves the networks to a device. They stay there until it fails; then the CPU takes over, for that frame and all
    /// later ones, and [`Self::gpu_failure`] tells why. An answer that is late is made up for by the CPU once; the device
    /// goes if the next one is late too.
    #[cfg(feature = "webgpu")]
    pub fn use_gpu(&mut self, gpu: GpuNetworks) {
        self.backend = backend::Backend::new(gpu, false);
    }

    /// [`Self::use_gpu`] on trial: a few frames in, the faster of device and CPU is kept. If that is the CPU,
    /// [`Self::gpu_failure`] tells both times.
    #[cfg(feature = "webgpu")]
    pub fn try_gpu(&mut self, gpu: GpuNetworks) {
        self.backend = backend::Backend::new(gpu, true);
    }

    /// The networks on a device, if they are there.
    #[cfg(feature = "webgpu")]
    pub fn gpu(&self) -> Option<&GpuNetworks> {
        self.backend.networks()
    }

    /// Why the last frame ran on the CPU though a device was given, if it did.
    #[cfg(feature = "webgpu")]
    pub fn gpu_failure(&self) -> Option<&str> {
        self.backend.failure()
    }

    /// Intrinsics to start from, where they come from, and how free the focal length is.
    fn camera_for(
        &self,
        (width, height): (u32, u32),
        query: &Query<'_>,
    ) -> Result<(Camera, CameraSource, Focal), LocateError> {
        if !query.timestamp_ms.is_finite() {
            return Err(LocateError::Timestamp(query.timestamp_ms));
        }
        if let Some(camera) = query.camera {
            camera.validate()?;
            if (camera.width, camera.height) != (width, height) {
                return Err(LocateError::CameraSize {
                    camera_width: camera.width,
                    camera_height: camera.height,
                    width,
                    height,
                });
            }
            let focal = match query.camera_source.sigma_ln() {
                None => Focal::Known,
                Some(sigma_ln) => Focal::Refine { sigma_ln },
            };
            return Ok((camera, query.camera_source, focal));
        }
        if let Some(belief) = self.focal.belief(query.camera_name) {
            let f = belief.focal_per_width * f64::from(width);
            let focal = if belief.is_frozen() {
                Focal::Known
            } else {
                Focal::Refine {
                    sigma_ln: belief.sigma_ln,
                }
            };
            let camera = Camera::centered(width, height, f);
            return Ok((camera, CameraSource::Remembered, focal));
        }
        let f = ASSUMED_FOCAL * f64::from(width.max(height));
        let camera = Camera::centered(width, height, f);
        Ok((camera, CameraSource::Assumed, Focal::Unknown))
    }
}
