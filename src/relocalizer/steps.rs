//! The steps of one frame: begin, observe, solve.

use super::Relocalizer;
use super::accept::{accept, is_fitting};
use super::confidence::{confidence, fitting};
use super::correspond::correspondences;
use super::error::LocateError;
use super::last_frame::{count, mark};
use super::options::{CameraSource, Query};
use super::result::{Counts, Localization, NotLocated, Outcome, Report};
use super::start::{Start, Starts};
use super::timings::StageTimings;
use crate::front_end::{FrontEndError, Stopwatch};
use crate::geometry::{Camera, WorkingFromSensor};
use crate::image::FrameView;
use crate::landmarks::FoundAgain;
use crate::pose::{self, PoseEstimate, PoseOptions, PoseStats};

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

/// A frame of which everything is known but the pose. Goes into [`Relocalizer::solve`], more than once if need be.
#[derive(Debug, Clone)]
#[must_use]
pub struct Observed {
    number: u64,
    size: (u32, u32),
    timings: StageTimings,
    on_gpu: bool,
    working_from_sensor: WorkingFromSensor,
}

/// So many times as much is found again without what is wrong with a given camera. In RedKitchen and in the rendered sample a ratio
/// of focal lengths that was 14 % off left three quarters and half of it.
const CLEARLY_MORE: f64 = 1.15;

/// A frame solved from one start.
#[derive(Debug, Clone, Copy)]
struct Answer {
    outcome: Outcome,
    camera: Camera,
    source: CameraSource,
    sigma_ln: Option<f64>,
    counts: Counts,
    found_again: Option<FoundAgain>,
    stats: PoseStats,
}

impl Answer {
    /// Whether another start may do better: where there is no pose yet, and no reason that no camera changes; another camera of the
    /// scene where the one that was tried proved to be another; and a given one's doubts, those of a part where it fits badly.
    fn is_open_to(&self, start: &Start, is_of_part: bool) -> bool {
        match self.outcome {
            Outcome::NotLocated(NotLocated::FewFeatures | NotLocated::Timeout) => false,
            Outcome::NotLocated(_) => true,
            Outcome::Located(_) => {
                let is_another = self.source == CameraSource::Estimated;
                is_another && start.source == CameraSource::Scene
                    || start.is_doubt() && (is_another || !is_of_part || !is_fitting(&self.counts))
            }
        }
    }

    /// Whether this answer, from `start`, counts more than the one before. That a given camera is wrong has to be seen by more than
    /// its confidence, which knows of no other: clearly more has to be found again without it.
    fn is_better_than(&self, other: &Self, start: &Start) -> bool {
        let sure = |answer: &Self| answer.outcome.located().map_or(-1.0, |l| l.confidence);
        let found = |answer: &Self| {
            let found = answer.found_again.filter(|_| sure(answer) >= 0.0);
            found.map_or(0.0, |f| f64::from(f.found_points + f.found_lines))
        };
        if start.is_doubt() {
            // Where the given camera fell already, to one that was solved, half of it known beats all of it solved.
            let is_fallen = other.source == CameraSource::Estimated;
            return found(self) > if is_fallen { 1.0 } else { CLEARLY_MORE } * found(other);
        }
        sure(self) > sure(other)
    }
}

impl Relocalizer {
    /// Locates one frame on the CPU. `clock` tells milliseconds, for timings and the time budget.
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense.
    pub fn locate(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, LocateError> {
        let observed = self.observe_on_cpu(frame, query, clock)?;
        self.solve(observed, query, clock)
    }

    /// The first two steps of a frame on the CPU, for [`Self::solve`].
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense.
    pub fn observe_on_cpu(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Observed, LocateError> {
        let begun = self.prepare(frame, query, &mut Stopwatch::start(clock))?;
        self.run_on_cpu(begun, &mut Stopwatch::start(clock), true)
    }

    /// [`Self::locate`] with the networks on the device that `place` or `use_gpu` gave, or on the CPU without one.
    ///
    /// # Errors
    /// [`LocateError`] for a frame or camera that makes no sense. A device that fails is no error.
    #[cfg(feature = "webgpu")]
    pub async fn locate_with_gpu(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query,
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
        query: &Query,
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
            let has_answered = self.backend.finish(features, &mut self.predictions).await;
            if has_answered {
                self.has_predicted = true;
                begun.timings.regress_ms = stopwatch.lap();
                begun.timings.total_ms += stopwatch.total();
                self.observed(begun, true)
            } else {
                self.run_on_cpu(begun, &mut stopwatch, false)?
            }
        } else {
            self.run_on_cpu(begun, &mut stopwatch, true)?
        };
        self.backend
            .measured(observed.on_gpu, started_ms + stopwatch.total());
        Ok(observed)
    }

    /// Checks the frame and makes its working image.
    fn prepare(
        &mut self,
        frame: &FrameView<'_>,
        query: &Query,
        stopwatch: &mut Stopwatch<'_>,
    ) -> Result<Begun, LocateError> {
        frame.check().map_err(FrontEndError::Frame)?;
        let size = (frame.width, frame.height);
        // For its errors: the intrinsics themselves may change until this frame is solved.
        self.starts(size, query)?;
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
    fn run_on_cpu(
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
        self.predict()?;
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
        query: &Query,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, LocateError> {
        if observed.number != self.num_observed {
            return Err(LocateError::OutOfOrder {
                number: observed.number,
            });
        }
        let starts = self.starts(observed.size, query)?;
        let mut stopwatch = Stopwatch::start(clock);
        let mut timings = observed.timings;
        if !self.has_predicted {
            self.predict()?;
            timings.regress_ms = stopwatch.lap();
        }
        self.working_from_sensor = observed.working_from_sensor;
        let mut answer = self.answer(&starts.first, query, &mut stopwatch, &mut timings)?;
        let (mut from, mut is_last) = (starts.first, true);
        for start in starts.rest() {
            if !answer.is_open_to(&start, starts.is_of_part) {
                continue;
            }
            let other = self.answer(&start, query, &mut stopwatch, &mut timings)?;
            is_last = other.is_better_than(&answer, &start);
            if is_last {
                (answer, from) = (other, start);
            } else if answer.outcome.located().is_none() {
                // Why it is not located is what the first camera says; what is left behind is of the last one.
                answer.counts = other.counts;
                is_last = true;
            }
        }
        if !is_last {
            answer = self.answer(&from, query, &mut stopwatch, &mut timings)?;
        }
        timings.total_ms += stopwatch.total();
        Ok(Report {
            outcome: answer.outcome,
            on_gpu: observed.on_gpu,
            camera: answer.camera,
            camera_source: answer.source,
            has_focal_mismatch: answer.source == CameraSource::Estimated && from.is_claimed(),
            focal_sigma_ln: answer.sigma_ln,
            counts: answer.counts,
            found_again: answer.found_again,
            pose_stats: answer.stats,
            timings,
        })
    }

    fn starts(&self, size: (u32, u32), query: &Query) -> Result<Starts, LocateError> {
        let is_checked = self.scene.has_landmarks() && self.options.live.look_again;
        Starts::new(size, query, self.scene.info(), is_checked)
    }

    /// The pose of the frame that was observed last, from one start.
    fn answer(
        &mut self,
        start: &Start,
        query: &Query,
        stopwatch: &mut Stopwatch<'_>,
        timings: &mut StageTimings,
    ) -> Result<Answer, LocateError> {
        let mut counts = self.correspond();
        let camera = start.camera.resized(&self.working_from_sensor);
        let options = PoseOptions {
            focal: start.focal,
            gravity: query.gravity,
            prior: query.prior,
            ..self.options.live.pose
        };
        let (points, lines) = (&self.points, &self.lines);
        let clock = stopwatch.clock();
        let first = pose::estimate(points, lines, &camera, &options, &mut self.pose, clock)?;
        timings.solve_ms += stopwatch.lap();
        let (solved, found_again) = self.look_again(first, &camera, &options, stopwatch.clock())?;
        timings.look_ms += stopwatch.lap();
        counts.num_point_correspondences = self.points.len();
        counts.num_line_correspondences = self.lines.len();
        let (mut solved_camera, mut source, mut sigma_ln) = (start.camera, start.source, None);
        let mut outcome = match accept(&solved, &counts, found_again.as_ref()) {
            Ok(estimate) => {
                (solved_camera, source, sigma_ln) =
                    start.solved(&camera, &self.working_from_sensor, &estimate);
                let focal_sigma_ln = self.told_focal(&estimate);
                let found = found_again.as_ref();
                Outcome::Located(self.localization(estimate, found, source, focal_sigma_ln))
            }
            Err(reason) => {
                mark(&[], self.points.len(), &mut self.is_point_inlier);
                mark(&[], self.lines.len(), &mut self.is_line_inlier);
                Outcome::NotLocated(reason)
            }
        };
        counts.num_point_inliers = count(&self.is_point_inlier);
        counts.num_line_inliers = count(&self.is_line_inlier);
        if let Outcome::Located(found) = &mut outcome {
            found.confidence = fitting(found.confidence, counts.agreeing_share());
        }
        timings.solve_ms += stopwatch.lap();
        Ok(Answer {
            outcome,
            camera: solved_camera,
            source,
            sigma_ln,
            counts,
            found_again,
            stats: solved.stats,
        })
    }

    /// Runs the scene's networks on the features of the frame that was observed last.
    fn predict(&mut self) -> Result<(), LocateError> {
        let features = self.front_end.features();
        self.scene.predict(features, &mut self.predictions)?;
        self.has_predicted = true;
        Ok(())
    }

    /// Fills the solver's lists from features and predictions.
    fn correspond(&mut self) -> Counts {
        let features = self.front_end.features();
        correspondences(
            features,
            &self.predictions,
            &self.options.live,
            &mut self.most_confident,
            &mut self.points,
            &mut self.lines,
        );
        Counts {
            num_keypoints: features.keypoints.len(),
            num_segments: features.segments.len(),
            num_point_correspondences: self.points.len(),
            num_line_correspondences: self.lines.len(),
            ..Counts::default()
        }
    }

    /// Marks what agrees with the solver's last answer, and puts the answer in the frame's own pixels.
    fn localization(
        &mut self,
        estimate: PoseEstimate,
        found: Option<&FoundAgain>,
        camera_source: CameraSource,
        focal_sigma_ln: Option<f64>,
    ) -> Localization {
        let working = self.working_from_sensor;
        Localization {
            cam_from_world: estimate.cam_from_world,
            median_error_px: self.mark_inliers() / (0.5 * (working.scale_x + working.scale_y)),
            confidence: confidence(&estimate, found, camera_source, focal_sigma_ln),
            estimate,
        }
    }
}
