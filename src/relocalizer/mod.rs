//! The pipeline: a frame in, located or not out.
//!
//! * **In and out**: a [`FrameView`] and what is known about its camera; a [`Report`]. That a frame is not located is a
//!   result with a reason, not an error.
//! * **Spaces and units**: the caller deals in pixels of the frame and in the world; detection, extraction and the solver work
//!   in pixels of the working image, so that thresholds mean the same for every camera.
//! * **Method**: grey, resize, extractor, segments, the scene's two branches, correspondences, solver; over several frames a
//!   prior from the last pose, a state, smoothing, and the remembered focal length of cameras that nobody calibrated.
//! * **Invariants**: the same frame, options and seed give the same pose; with the portable kernels, the only ones in the browser,
//!   on every machine. The core reads no clock of its own.
//! * **Cost**: all buffers are kept from frame to frame; a change of the working size builds the extractor's plan anew.

#[cfg(feature = "webgpu")]
mod calibration;
mod correspond;
mod error;
mod focal;
mod front_end;
#[cfg(feature = "webgpu")]
mod gpu;
mod last_frame;
mod options;
mod result;
mod smoothing;
mod timings;
mod tracking;

pub use error::{CreateError, LocateError};
pub use focal::{FocalBelief, FocalMemory};
pub use front_end::{FrontEnd, FrontEndOptions};
#[cfg(feature = "webgpu")]
pub use gpu::GpuNetworks;
pub use options::{CameraSource, Query, RelocalizerOptions};
pub use result::{Counts, Localization, NotLocated, Outcome, Report};
pub use smoothing::{PoseFilter, Smoothing};
pub use timings::StageTimings;
pub use tracking::{LimitedReason, Track, TrackState};

use crate::geometry::{CamFromWorld, Camera};
use crate::image::FrameView;
use crate::pose::{
    self, Focal, LineCorrespondence, PointCorrespondence, PoseOptions, PoseScratch, PriorPose,
};
use crate::regress::{Predictions, Regressor};
use crate::scene_file::{ExtractorFile, SceneFile, SceneInfo};
use last_frame::{count, mark};
use timings::Stopwatch;

/// Focal length divided by the longer side where nothing is known: the middle of phones' video cameras.
const ASSUMED_FOCAL: f64 = 0.85;
/// Fewer features than this are not worth a look.
const MIN_FEATURES: usize = 8;
/// Fewer things that agree are not believed, whatever the evidence says: repeated predictions (a network that was taught
/// another place) are not independent of each other, and the solver's evidence takes them to be.
const MIN_INLIERS: u32 = 12;
/// And no fewer than one in so many of what the solver was given: the scene of another room finds chance poses with up to
/// 30 of 900, while in its own room a third of them agree.
const MIN_INLIER_SHARE: u32 = 12;
/// A focal length known worse than this makes tracking limited.
const MAX_TRACKED_SIGMA_LN: f64 = 0.05;
/// Nats of evidence above chance that make a pose 63 % sure, 95 % at three times as much.
const EVIDENCE_SCALE: f64 = 10.0;

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
    #[cfg(feature = "webgpu")]
    gpu: Option<GpuNetworks>,
    /// Present until it is decided whether the device is worth it.
    #[cfg(feature = "webgpu")]
    calibration: Option<calibration::Calibration>,
    gpu_failure: Option<String>,
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
            #[cfg(feature = "webgpu")]
            gpu: None,
            #[cfg(feature = "webgpu")]
            calibration: None,
            gpu_failure: None,
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

    /// Locates one frame. `clock` tells milliseconds, for timings and the time budget.
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense.
    pub fn locate(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, LocateError> {
        let intrinsics = self.camera_for(frame, query)?;
        let mut stopwatch = Stopwatch::start(clock);
        let timings = self.run_on_cpu(frame, &mut stopwatch)?;
        self.solve(frame, query, intrinsics, timings, false, &mut stopwatch)
    }

    /// Moves the networks to a device. They stay there until it fails; then the CPU takes over, for that frame and all
    /// later ones, and [`Self::gpu_failure`] tells why.
    #[cfg(feature = "webgpu")]
    pub fn use_gpu(&mut self, gpu: GpuNetworks) {
        self.gpu = Some(gpu);
        self.calibration = None;
        self.gpu_failure = None;
    }

    /// [`Self::use_gpu`] on trial: a few frames in, the faster of device and CPU is kept. If that is the CPU,
    /// [`Self::gpu_failure`] tells both times.
    #[cfg(feature = "webgpu")]
    pub fn try_gpu(&mut self, gpu: GpuNetworks) {
        self.use_gpu(gpu);
        self.calibration = Some(calibration::Calibration::default());
    }

    /// The networks on a device, if they are there.
    #[cfg(feature = "webgpu")]
    pub fn gpu(&self) -> Option<&GpuNetworks> {
        self.gpu.as_ref()
    }

    /// Why the networks left the device, if they did.
    pub fn gpu_failure(&self) -> Option<&str> {
        self.gpu_failure.as_deref()
    }

    /// [`Self::locate`] with the networks on the device that [`Self::use_gpu`] gave, or on the CPU without one.
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense. A device that fails is no error.
    #[cfg(feature = "webgpu")]
    pub async fn locate_with_gpu(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, LocateError> {
        let intrinsics = self.camera_for(frame, query)?;
        let mut stopwatch = Stopwatch::start(clock);
        let on_trial = self
            .calibration
            .as_ref()
            .map(calibration::Calibration::turn);
        let by_gpu = match on_trial {
            Some(calibration::Turn::Cpu) => None,
            Some(calibration::Turn::Gpu) | None => self.run_on_gpu(frame, &mut stopwatch).await?,
        };
        let timings = match by_gpu {
            Some(timings) => timings,
            None => self.run_on_cpu(frame, &mut stopwatch)?,
        };
        let networks_ms = stopwatch.total();
        if self.gpu.is_none() {
            self.calibration = None;
        } else if let Some(calibration) = &mut self.calibration {
            if by_gpu.is_some() {
                calibration.gpu_frame(networks_ms);
            } else {
                if let Some(why) = calibration.decide(networks_ms) {
                    self.gpu = None;
                    self.gpu_failure = Some(why);
                }
                self.calibration = None;
            }
        }
        let on_gpu = by_gpu.is_some();
        self.solve(frame, query, intrinsics, timings, on_gpu, &mut stopwatch)
    }

    /// Features and predictions by the device; `None` when there is none or it failed.
    #[cfg(feature = "webgpu")]
    async fn run_on_gpu(
        &mut self,
        frame: &FrameView<'_>,
        stopwatch: &mut Stopwatch<'_>,
    ) -> Result<Option<StageTimings>, LocateError> {
        if self.gpu.is_none() {
            return Ok(None);
        }
        let mut timings = StageTimings::default();
        self.front_end.prepare(frame)?;
        timings.preprocess_ms = stopwatch.lap();
        let Some(mut gpu) = self.gpu.take() else {
            return Ok(None);
        };
        let submitted = gpu.submit(&self.front_end.working());
        timings.features_ms = stopwatch.lap();
        if let Err(error) = self.front_end.detect() {
            self.gpu = Some(gpu);
            return Err(error);
        }
        timings.lines_ms = stopwatch.lap();
        let features = self.front_end.features_without_descriptors();
        let finished = match submitted {
            Ok(()) => {
                gpu.finish(
                    &features.segments,
                    &mut features.keypoints,
                    &mut self.predictions,
                )
                .await
            }
            Err(error) => Err(error),
        };
        timings.regress_ms = stopwatch.lap();
        match finished {
            Ok(()) => {
                self.gpu = Some(gpu);
                Ok(Some(timings))
            }
            Err(error) => {
                self.gpu_failure = Some(error.to_string());
                Ok(None)
            }
        }
    }

    /// Features and predictions by the CPU.
    fn run_on_cpu(
        &mut self,
        frame: &FrameView<'_>,
        stopwatch: &mut Stopwatch<'_>,
    ) -> Result<StageTimings, LocateError> {
        let mut timings = StageTimings::default();
        let stages = self.front_end.run_timed(frame, stopwatch)?;
        timings.preprocess_ms = stages.preprocess_ms;
        timings.features_ms = stages.features_ms;
        timings.lines_ms = stages.lines_ms;

        let features = self.front_end.features();
        self.regressor.run(features, &mut self.predictions)?;
        timings.regress_ms = stopwatch.lap();
        Ok(timings)
    }

    /// From predictions to the report.
    fn solve(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
        (sensor_camera, source, focal): (Camera, CameraSource, Focal),
        mut timings: StageTimings,
        on_gpu: bool,
        stopwatch: &mut Stopwatch<'_>,
    ) -> Result<Report, LocateError> {
        let features = self.front_end.features();
        correspond::from_predictions(
            features,
            &self.predictions,
            &self.options,
            &mut self.order,
            &mut self.points,
            &mut self.lines,
        );
        let mut counts = Counts {
            num_keypoints: features.keypoints.len(),
            num_segments: features.segments.len(),
            num_point_correspondences: self.points.len(),
            num_line_correspondences: self.lines.len(),
            ..Counts::default()
        };
        let working = self.front_end.working_from_sensor();
        let camera = sensor_camera.resized(&working);
        let options = PoseOptions {
            focal,
            gravity: query.gravity,
            prior: self.prior(query),
            ..self.options.pose
        };
        let solved = pose::estimate(
            &self.points,
            &self.lines,
            &camera,
            &options,
            &mut self.pose,
            stopwatch.clock(),
        )?;

        let num_given = (self.points.len() + self.lines.len()) as u32;
        let needed = MIN_INLIERS.max(num_given / MIN_INLIER_SHARE);
        let found = solved
            .located()
            .filter(|e| e.num_point_inliers + e.num_line_inliers >= needed)
            .copied();
        let reason = if found.is_some() {
            None
        } else if counts.num_keypoints + counts.num_segments < MIN_FEATURES {
            Some(NotLocated::FewFeatures)
        } else {
            Some(NotLocated::from_status(solved.status).unwrap_or(NotLocated::FewInliers))
        };
        let mut report_camera = sensor_camera;
        let mut report_source = source;
        let mut focal_sigma_ln = None;
        let outcome = if let Some(estimate) = found {
            if focal != Focal::Known {
                let factor = estimate.camera.focal_px().0 / camera.focal_px().0;
                report_camera = sensor_camera.with_focal_scaled(factor);
                let sigma_ln = estimate.sigma_focal_px / estimate.camera.focal_px().0;
                focal_sigma_ln = Some(sigma_ln);
                if report_source == CameraSource::Assumed {
                    report_source = CameraSource::Estimated;
                }
                let per_width = report_camera.focal_px().0 / f64::from(frame.width);
                self.focal.learn(query.camera_name, per_width, sigma_ln);
            }
            let median_error_px = self.mark_inliers() / (0.5 * (working.scale_x + working.scale_y));
            counts.num_point_inliers = count(&self.is_point_inlier);
            counts.num_line_inliers = count(&self.is_line_inlier);
            let smoothed = self.follow(&estimate.cam_from_world, query, focal_sigma_ln);
            Outcome::Located(Localization {
                cam_from_world: estimate.cam_from_world,
                smoothed,
                estimate,
                median_error_px,
                confidence: 1.0 - libm::exp(-estimate.log_evidence.max(0.0) / EVIDENCE_SCALE),
            })
        } else {
            mark(&[], self.points.len(), &mut self.is_point_inlier);
            mark(&[], self.lines.len(), &mut self.is_line_inlier);
            if query.tracking {
                self.track.missed();
            }
            Outcome::NotLocated(reason.unwrap_or(NotLocated::FewInliers))
        };
        timings.solve_ms = stopwatch.lap();
        timings.total_ms = stopwatch.total();
        let state = match (query.tracking, &outcome) {
            (true, _) => self.track.state(),
            (false, Outcome::Located(_)) => TrackState::Tracking,
            (false, Outcome::NotLocated(_)) => TrackState::Searching,
        };
        Ok(Report {
            outcome,
            on_gpu,
            camera: report_camera,
            camera_source: report_source,
            focal_sigma_ln,
            counts,
            state,
            pose_stats: solved.stats,
            timings,
        })
    }

    /// Intrinsics to start from, where they come from, and how free the focal length is.
    fn camera_for(
        &self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
    ) -> Result<(Camera, CameraSource, Focal), LocateError> {
        frame.check()?;
        if !query.timestamp_ms.is_finite() {
            return Err(LocateError::Timestamp(query.timestamp_ms));
        }
        let (width, height) = (frame.width, frame.height);
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

    fn prior(&self, query: &Query<'_>) -> Option<PriorPose> {
        if !query.tracking {
            return self.options.pose.prior;
        }
        let cam_from_world = self.track.prior(query.timestamp_ms)?;
        Some(PriorPose {
            cam_from_world,
            covariance: None,
        })
    }

    /// Updates the state over frames; the smoothed pose when smoothing is on.
    fn follow(
        &mut self,
        cam_from_world: &CamFromWorld,
        query: &Query<'_>,
        focal_sigma_ln: Option<f64>,
    ) -> Option<CamFromWorld> {
        if !query.tracking {
            return None;
        }
        let doubt = focal_sigma_ln
            .filter(|sigma| *sigma > MAX_TRACKED_SIGMA_LN)
            .map(|_| LimitedReason::FocalUncertain);
        if self
            .track
            .located(cam_from_world, query.timestamp_ms, doubt)
        {
            self.filter.reset();
        }
        self.filter
            .apply(self.options.smoothing, cam_from_world, query.timestamp_ms)
    }
}
