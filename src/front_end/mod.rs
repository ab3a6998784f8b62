//! From a frame to its features: what localisation and training share.
//!
//! * **In and out**: a [`FrameView`]; a [`FeatureSet`] of keypoints, segments and their descriptors.
//! * **Spaces and units**: pixels of the working image, which [`FrontEnd::working_from_sensor`] relates to the frame's.
//! * **Method**: grey, resize, extractor, line segments, selection, descriptors at points and along segments.
//! * **Invariants**: the same frame and options give the same features; with the portable kernels on every machine.
//! * **Cost**: all buffers are kept from frame to frame; a change of the working size builds the extractor's plan anew.

mod error;
mod stopwatch;

pub use error::FrontEndError;
pub(crate) use stopwatch::Stopwatch;

use crate::features::{Extractor, ExtractorOptions, FeatureSet, KeypointParams};
use crate::geometry::{Segment2, WorkingFromSensor};
use crate::image::{FrameView, GrayImage, GrayView, gray_from_frame, working_from_gray};
use crate::lsd::post::{self, PostParams, Rank};
use crate::lsd::{self, LsdParams, LsdScratch};
use crate::models::{ExtractorKind, Sampler};
use crate::nn::cpu::Level;
use crate::scene_file::{ExtractorFile, MAX_WORKING_SIDE};

/// How features are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrontEndOptions {
    /// Longest side of the working image in pixels.
    pub max_side: usize,
    /// Selection of keypoints.
    pub keypoints: KeypointParams,
    /// Line segment detector.
    pub lsd: LsdParams,
    /// Shorter segments are dropped; pixels of the working image.
    pub min_segment_px: f64,
    /// Most segments of a frame; the longest are kept, in the detector's order.
    pub max_segments: usize,
    /// Descriptor samples along a segment.
    pub tokens: usize,
    /// How descriptors are read.
    pub sampler: Sampler,
}

impl FrontEndOptions {
    /// Defaults for an extractor.
    pub fn new(extractor: ExtractorKind) -> Self {
        let extractor = ExtractorOptions::new(extractor);
        Self {
            max_side: 640,
            keypoints: KeypointParams {
                max_keypoints: 1024,
                ..extractor.keypoints
            },
            lsd: LsdParams::default(),
            min_segment_px: 20.0,
            max_segments: 300,
            tokens: extractor.tokens,
            sampler: extractor.sampler,
        }
    }

    /// The extractor's part of them.
    pub fn extractor(&self) -> ExtractorOptions {
        ExtractorOptions {
            keypoints: self.keypoints,
            max_segments: self.max_segments,
            tokens: self.tokens,
            sampler: self.sampler,
        }
    }

    fn post(&self) -> PostParams {
        PostParams {
            min_length_px: self.min_segment_px,
            max_count: self.max_segments,
            rank: Rank::Length,
            ..PostParams::default()
        }
    }
}

/// Milliseconds of the stages in here.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct FrontEndTimings {
    pub(crate) features_ms: f64,
    pub(crate) lines_ms: f64,
}

/// Owns the extractor and every buffer between the frame and its features.
#[derive(Debug)]
pub struct FrontEnd {
    extractor: Extractor,
    options: FrontEndOptions,
    lsd: LsdScratch,
    gray: GrayImage,
    working: GrayImage,
    segments: Vec<Segment2>,
    features: FeatureSet,
    working_from_sensor: WorkingFromSensor,
}

impl FrontEnd {
    /// Takes the extractor's weights.
    ///
    /// # Errors
    /// [`FrontEndError::Features`] when they do not fit, [`FrontEndError::Option`] for options without a meaning.
    pub fn new(file: ExtractorFile, options: FrontEndOptions) -> Result<Self, FrontEndError> {
        check(&options, file.kind)?;
        let extractor = Extractor::new(file.kind, file.weights, options.extractor())?;
        Ok(Self {
            extractor,
            options,
            lsd: LsdScratch::default(),
            gray: GrayImage::default(),
            working: GrayImage::default(),
            segments: Vec::new(),
            features: FeatureSet::default(),
            working_from_sensor: WorkingFromSensor::from_scale(1.0, 1.0),
        })
    }

    /// Uses these kernels instead of the machine's best.
    #[must_use]
    pub fn with_level(mut self, level: Level) -> Self {
        self.extractor = self.extractor.with_level(level);
        self
    }

    /// Which extractor it runs.
    pub fn extractor(&self) -> ExtractorKind {
        self.extractor.kind()
    }

    /// Changes the size of the working image. The networks are built anew at the next frame.
    ///
    /// # Errors
    /// [`FrontEndError::Option`] when no picture of that size can be processed.
    pub fn set_max_side(&mut self, max_side: usize) -> Result<(), FrontEndError> {
        let options = FrontEndOptions {
            max_side,
            ..self.options
        };
        check(&options, self.extractor.kind())?;
        self.options = options;
        Ok(())
    }

    /// Features of a frame, in pixels of the working image.
    ///
    /// # Errors
    /// [`FrontEndError`] for a frame whose size and bytes disagree, or that is too small.
    pub fn run(&mut self, frame: &FrameView<'_>) -> Result<&FeatureSet, FrontEndError> {
        let mut no_clock = || 0.0;
        self.prepare(frame)?;
        self.run_prepared(&mut Stopwatch::start(&mut no_clock), true)?;
        Ok(&self.features)
    }

    /// First half of [`Self::run`], for callers that want to see the picture before it costs anything: the grey working image
    /// of a frame.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn look(&mut self, frame: &FrameView<'_>) -> Result<GrayView<'_>, FrontEndError> {
        self.prepare(frame)?;
        Ok(self.working.view())
    }

    /// Second half: features of the frame that was looked at last, in pixels of the working image.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn run_looked_at(&mut self) -> Result<&FeatureSet, FrontEndError> {
        self.run_prepared(&mut Stopwatch::start(&mut || 0.0), true)?;
        Ok(&self.features)
    }

    /// [`Self::run`] with segments from elsewhere, in pixels of the frame, in place of detected ones: all of them, in their
    /// order. They must not be more than the options allow.
    ///
    /// # Errors
    /// As [`Self::run`], and when there are too many segments.
    pub fn run_with_segments(
        &mut self,
        frame: &FrameView<'_>,
        segments: &[Segment2],
    ) -> Result<&FeatureSet, FrontEndError> {
        self.prepare(frame)?;
        self.segments.clear();
        let working = self.working_from_sensor;
        self.segments
            .extend(segments.iter().map(|s| s.mapped(&working)));
        self.run_prepared(&mut Stopwatch::start(&mut || 0.0), false)?;
        Ok(&self.features)
    }

    /// Features of the frame that [`Self::prepare`] took; `with_segments` unless [`Self::detect`] has run for it.
    pub(crate) fn run_prepared(
        &mut self,
        stopwatch: &mut Stopwatch<'_>,
        with_segments: bool,
    ) -> Result<FrontEndTimings, FrontEndError> {
        let mut timings = FrontEndTimings::default();
        self.extractor.run_dense(&self.working.view())?;
        timings.features_ms = stopwatch.lap();
        if with_segments {
            self.detect()?;
            timings.lines_ms = stopwatch.lap();
        }
        self.extractor.select(&mut self.features.keypoints)?;
        self.extractor
            .describe(&self.segments, &mut self.features)?;
        timings.features_ms += stopwatch.lap();
        Ok(timings)
    }

    /// The picture that was prepared last, in grey.
    pub(crate) fn picture(&self) -> &GrayImage {
        &self.gray
    }

    /// Grey and working image of a frame.
    pub(crate) fn prepare(&mut self, frame: &FrameView<'_>) -> Result<(), FrontEndError> {
        gray_from_frame(frame, &mut self.gray)?;
        self.working_from_sensor =
            working_from_gray(&self.gray.view(), self.options.max_side, &mut self.working)?;
        let min_side = self.extractor.kind().min_side();
        if self.working.width < min_side || self.working.height < min_side {
            return Err(FrontEndError::FrameTooSmall {
                width: frame.width,
                height: frame.height,
                working_width: self.working.width,
                working_height: self.working.height,
                min_side,
            });
        }
        Ok(())
    }

    /// Segments of the working image.
    pub(crate) fn detect(&mut self) -> Result<(), FrontEndError> {
        let found = lsd::detect(&self.working.view(), &self.options.lsd, &mut self.lsd)?;
        self.segments.clear();
        self.segments.extend_from_slice(found);
        post::apply(&mut self.segments, &self.options.post());
        Ok(())
    }

    /// The working image of the last frame.
    #[cfg(feature = "webgpu")]
    pub(crate) fn working(&self) -> GrayView<'_> {
        self.working.view()
    }

    /// The features of the last frame, to be filled from elsewhere: its segments stand in them, descriptors do not.
    #[cfg(feature = "webgpu")]
    pub(crate) fn features_without_descriptors(&mut self) -> &mut FeatureSet {
        self.features.clear();
        self.features.segments.extend_from_slice(&self.segments);
        &mut self.features
    }

    /// Features of the last frame, in pixels of the working image.
    pub fn features(&self) -> &FeatureSet {
        &self.features
    }

    /// From the last frame to its working image.
    pub fn working_from_sensor(&self) -> WorkingFromSensor {
        self.working_from_sensor
    }
}

fn check(options: &FrontEndOptions, extractor: ExtractorKind) -> Result<(), FrontEndError> {
    let min_side = extractor.min_side();
    if !(min_side..=MAX_WORKING_SIDE as usize).contains(&options.max_side) {
        return Err(FrontEndError::Option {
            name: "max_side",
            value: options.max_side as f64,
            expected: "between the extractor's smallest side (32 for XFeat) and 2048",
        });
    }
    if options.min_segment_px.is_nan() || options.min_segment_px < 0.0 {
        return Err(FrontEndError::Option {
            name: "min_segment_px",
            value: options.min_segment_px,
            expected: "zero or positive",
        });
    }
    options.lsd.check().map_err(|_| FrontEndError::Option {
        name: "lsd",
        value: options.lsd.scale,
        expected: "parameters in the detector's ranges",
    })
}
