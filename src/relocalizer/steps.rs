//! The steps of one frame: begin, observe, solve.

use super::Relocalizer;
use super::correspond;
use super::error::LocateError;
use super::last_frame::{count, mark};
use super::options::{CameraSource, Query};
use super::result::{Counts, Localization, NotLocated, Outcome, Report};
use super::timings::StageTimings;
use super::tracking::{LimitedReason, TrackState};
use crate::front_end::{FrontEndError, Stopwatch};
use crate::geometry::{CamFromWorld, WorkingFromSensor};
use crate::image::FrameView;
use crate::pose::{self, Focal, PoseOptions, PriorPose};

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

/// A frame whose working image is made and whose extractor runs, if it runs on a device. Goes into
/// `Relocalizer::observe`.
#[derive(Debug)]
#[must_use]
pub struct Begun {
    number: u64,
    size: (u32, u32),
    timings: StageTimings,
    #[cfg(feature = "webgpu")]
    is_on_gpu: bool,
}

/// A frame of which everything is known but the pose. Goes into [`Relocalizer::solve`].
#[derive(Debug)]
#[must_use]
pub struct Observed {
    number: u64,
    size: (u32, u32),
    timings: StageTimings,
    on_gpu: bool,
    working_from_sensor: WorkingFromSensor,
}

impl Relocalizer {
    /// Locates one frame on the CPU. `clock` tells milliseconds, for timings and the time budget.
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense.
    pub fn locate(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, LocateError> {
        let begun = self.prepare(frame, query, &mut Stopwatch::start(clock))?;
        let observed = self.observe_on_cpu(begun, &mut Stopwatch::start(clock), true)?;
        self.solve(observed, query, clock)
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
        let begun = self.begin(frame, query, clock).await?;
        let observed = self.observe(begun, clock).await?;
        self.solve(observed, query, clock)
    }

    /// First step of a frame: makes the working image and starts the extractor on the device, if there is one. The pixels
    /// are not needed afterwards. This may be called once more before the frame before is solved, so that the device works
    /// meanwhile; a frame that was begun and not yet observed is then replaced.
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense.
    #[cfg(feature = "webgpu")]
    pub async fn begin(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Begun, LocateError> {
        let mut stopwatch = Stopwatch::start(clock);
        let mut begun = self.prepare(frame, query, &mut stopwatch)?;
        begun.is_on_gpu = self.backend.begin(&self.front_end.working()).await;
        begun.timings.features_ms = stopwatch.lap();
        begun.timings.total_ms = stopwatch.total();
        Ok(begun)
    }

    /// Second step: segments, while the device is busy with the extractor, then the rest of the networks, and the wait for
    /// their answer. Without a device, or when it fails, the CPU runs the networks here.
    ///
    /// # Errors
    /// [`LocateError::OutOfOrder`] for a frame that another one has replaced.
    #[cfg(feature = "webgpu")]
    pub async fn observe(
        &mut self,
        mut begun: Begun,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Observed, LocateError> {
        let mut stopwatch = Stopwatch::start(clock);
        let started_ms = begun.timings.total_ms;
        let is_on_gpu = begun.is_on_gpu;
        let observed = if is_on_gpu && begun.number == self.num_begun {
            self.front_end.detect()?;
            begun.timings.lines_ms = stopwatch.lap();
            let features = self.front_end.features_without_descriptors();
            let has_answered = self
                .backend
                .finish(
                    &features.segments,
                    &mut features.keypoints,
                    &mut self.predictions,
                )
                .await;
            if has_answered {
                begun.timings.regress_ms = stopwatch.lap();
                begun.timings.total_ms += stopwatch.total();
                self.observed(begun, true)
            } else {
                self.observe_on_cpu(begun, &mut stopwatch, false)?
            }
        } else {
            self.observe_on_cpu(begun, &mut stopwatch, true)?
        };
        self.backend
            .measured(observed.on_gpu, started_ms + stopwatch.total());
        Ok(observed)
    }

    /// Checks the frame and makes its working image.
    fn prepare(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query<'_>,
        stopwatch: &mut Stopwatch<'_>,
    ) -> Result<Begun, LocateError> {
        frame.check().map_err(FrontEndError::Frame)?;
        let size = (frame.width, frame.height);
        // For its errors: the intrinsics themselves may change until this frame is solved.
        self.camera_for(size, query)?;
        // From here on the picture of an earlier frame is gone, even if this one fails.
        self.num_begun += 1;
        self.front_end.prepare(frame)?;
        let preprocess_ms = stopwatch.lap();
        Ok(Begun {
            number: self.num_begun,
            size,
            timings: StageTimings {
                preprocess_ms,
                total_ms: stopwatch.total(),
                ..StageTimings::default()
            },
            #[cfg(feature = "webgpu")]
            is_on_gpu: false,
        })
    }

    /// The second step on the CPU; `with_segments` unless they were detected already.
    fn observe_on_cpu(
        &mut self,
        mut begun: Begun,
        stopwatch: &mut Stopwatch<'_>,
        with_segments: bool,
    ) -> Result<Observed, LocateError> {
        if begun.number != self.num_begun {
            return Err(LocateError::OutOfOrder {
                number: begun.number,
            });
        }
        let stages = self.front_end.run_prepared(stopwatch, with_segments)?;
        begun.timings.features_ms = stages.features_ms;
        begun.timings.lines_ms += stages.lines_ms;
        let features = self.front_end.features();
        self.regressor.run(features, &mut self.predictions)?;
        begun.timings.regress_ms = stopwatch.lap();
        begun.timings.total_ms += stopwatch.total();
        Ok(self.observed(begun, false))
    }

    fn observed(&mut self, begun: Begun, on_gpu: bool) -> Observed {
        self.num_observed = begun.number;
        Observed {
            number: begun.number,
            size: begun.size,
            timings: begun.timings,
            on_gpu,
            working_from_sensor: self.front_end.working_from_sensor(),
        }
    }

    /// Third step: the pose, from what was observed.
    ///
    /// # Errors
    /// [`LocateError::OutOfOrder`] for a frame after which another one was observed; [`LocateError`] for a camera that makes
    /// no sense.
    pub fn solve(
        &mut self,
        observed: Observed,
        query: &Query<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, LocateError> {
        if observed.number != self.num_observed {
            return Err(LocateError::OutOfOrder {
                number: observed.number,
            });
        }
        let (sensor_camera, source, focal) = self.camera_for(observed.size, query)?;
        let mut timings = observed.timings;
        let mut stopwatch = Stopwatch::start(clock);
        self.working_from_sensor = observed.working_from_sensor;
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
        let working = self.working_from_sensor;
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
                let per_width = report_camera.focal_px().0 / f64::from(observed.size.0);
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
        timings.total_ms += stopwatch.total();
        let state = match (query.tracking, &outcome) {
            (true, _) => self.track.state(),
            (false, Outcome::Located(_)) => TrackState::Tracking,
            (false, Outcome::NotLocated(_)) => TrackState::Searching,
        };
        Ok(Report {
            outcome,
            on_gpu: observed.on_gpu,
            camera: report_camera,
            camera_source: report_source,
            focal_sigma_ln,
            counts,
            state,
            pose_stats: solved.stats,
            timings,
        })
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
