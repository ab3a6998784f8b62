//! One frame in, located or not out.
//!
//! * **In and out**: a [`FrameView`](crate::image::FrameView) and what is known about it, a [`Query`]; a [`Report`]. That a
//!   frame is not located is a result with a reason, not an error. What earlier frames tell comes with the query:
//!   [`crate::session`] remembers it.
//! * **Spaces and units**: the caller deals in pixels of the frame and in the world; detection, extraction and the solver work
//!   in pixels of the working image, so that thresholds mean the same for every camera.
//! * **Method**: the front end, the scene's two branches, correspondences, solver, the second look where the scene has
//!   landmarks, a rule of acceptance. With the networks on
//!   a device a frame is taken in three steps, so that the next one's networks run while its pose is solved:
//!   `Relocalizer::begin`, `Relocalizer::observe`, [`Relocalizer::solve`].
//! * **Invariants**: the same frame, query, options and seed give the same pose, whatever came before; with the portable
//!   kernels, the only ones in the browser, on every machine. The core reads no clock of its own.
//! * **Cost**: all buffers are kept from frame to frame; a change of the working size builds the extractor's plan anew.

mod accept;
#[cfg(feature = "webgpu")]
mod backend;
#[cfg(feature = "webgpu")]
mod calibration;
mod confidence;
mod correspond;
#[cfg(feature = "webgpu")]
mod device;
mod error;
mod explain;
#[cfg(feature = "webgpu")]
mod gpu;
mod last_frame;
mod loaded;
mod options;
mod result;
mod second_look;
mod start;
mod steps;
mod timings;

pub use correspond::correspondences;
#[cfg(feature = "webgpu")]
pub use device::Device;
pub use error::{CreateError, LocateError};
#[cfg(feature = "webgpu")]
pub use gpu::GpuNetworks;
pub use loaded::LoadedScene;
pub use options::{CameraSource, FocalBelief, LiveOptions, Query, RelocalizerOptions};
pub use result::{Counts, Localization, NotLocated, Outcome, Report};
pub use steps::{Begun, Observed};
pub use timings::StageTimings;

use crate::features::FeatureSet;
use crate::front_end::FrontEnd;
use crate::geometry::WorkingFromSensor;
use crate::math::order::Best;
use crate::pose::{LineCorrespondence, PointCorrespondence, PoseScratch};
use crate::regress::Predictions;
use crate::scene_file::{ExtractorFile, SceneFile, SceneInfo};

/// Finds cameras in one scene.
#[derive(Debug)]
pub struct Relocalizer {
    scene: LoadedScene,
    options: RelocalizerOptions,
    front_end: FrontEnd,
    predictions: Predictions,
    /// Whether they are of the scene and of the frame that was observed last.
    has_predicted: bool,
    most_confident: Best,
    points: Vec<PointCorrespondence>,
    lines: Vec<LineCorrespondence>,
    is_point_inlier: Vec<bool>,
    is_line_inlier: Vec<bool>,
    errors_px: Vec<f64>,
    pose: PoseScratch,
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
        let mut options = RelocalizerOptions::for_scene(&scene);
        change(&mut options);
        options.check(&scene)?;
        let loaded = LoadedScene::new(scene, &options)?;
        Self::with(loaded, extractor, options)
    }

    /// Without a scene: what it sees is found nowhere until [`Self::exchange`] brings one. `change` may alter the extractor's
    /// usual options, which those of the scenes have to agree with.
    ///
    /// # Errors
    /// [`CreateError`] when an option has no meaning.
    pub fn without_scene(
        extractor: ExtractorFile,
        change: impl FnOnce(&mut RelocalizerOptions),
    ) -> Result<Self, CreateError> {
        let mut options = RelocalizerOptions::for_extractor(extractor.kind);
        change(&mut options);
        options.live.check()?;
        let nothing = LoadedScene::none(&extractor);
        Self::with(nothing, extractor, options)
    }

    fn with(
        scene: LoadedScene,
        extractor: ExtractorFile,
        options: RelocalizerOptions,
    ) -> Result<Self, CreateError> {
        let front_end = FrontEnd::new(extractor, options.front_end)?.with_level(options.kernels);
        Ok(Self {
            scene,
            options,
            front_end,
            predictions: Predictions::default(),
            has_predicted: false,
            most_confident: Best::default(),
            points: Vec::new(),
            lines: Vec::new(),
            is_point_inlier: Vec::new(),
            is_line_inlier: Vec::new(),
            errors_px: Vec::new(),
            pose: PoseScratch::default(),
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
        self.scene.info()
    }

    /// Whether the scene has landmarks to look for again.
    pub fn has_landmarks(&self) -> bool {
        self.scene.has_landmarks()
    }

    /// Takes another scene and hands the one before back. The frame that was observed last may be solved in it: its features
    /// are there already. Networks on a device were of the scene before; they run on the CPU from here on.
    ///
    /// # Errors
    /// [`CreateError::Scene`] when the scene was taught with another extractor; nothing has changed then.
    pub fn exchange(&mut self, scene: &mut LoadedScene) -> Result<(), CreateError> {
        scene.check_extractor_of(&self.scene)?;
        core::mem::swap(&mut self.scene, scene);
        self.has_predicted = false;
        #[cfg(feature = "webgpu")]
        {
            self.backend = backend::Backend::default();
        }
        Ok(())
    }

    /// Features of the frame that was observed last, in pixels of its working image.
    pub fn features(&self) -> &FeatureSet {
        self.front_end.features()
    }

    /// The options in use.
    pub fn options(&self) -> &RelocalizerOptions {
        &self.options
    }

    /// Changes what may change between frames.
    ///
    /// # Errors
    /// [`CreateError`] when an option has no meaning; nothing has changed then.
    pub fn set_live(&mut self, live: LiveOptions) -> Result<(), CreateError> {
        live.check()?;
        self.options.live = live;
        Ok(())
    }

    /// Changes the longest side of the working image. The extractor's plan is built anew at the next frame.
    ///
    /// # Errors
    /// [`CreateError`] when no picture of that size can be processed; nothing has changed then.
    pub fn set_max_side(&mut self, max_side: usize) -> Result<(), CreateError> {
        self.front_end.set_max_side(max_side)?;
        self.options.front_end.max_side = max_side;
        Ok(())
    }
}
