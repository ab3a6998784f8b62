//! The networks of a frame on the GPU: extractor, selection, sampling and branches with one readback, segments detected on
//! the CPU meanwhile.
//!
//! What a frame may be:
//! * of another size than the last: extractor and samplers are made anew within that call, the branches stay;
//! * without keypoints, without segments, or both: the networks run on what there is;
//! * with more segments than `max_segments`: the front end has kept the longest, as for the CPU, before the device sees them.
//!
//! None of these makes the driver complain. What does is a [`GpuError`], and the CPU answers the frame.

use crate::features::{
    ExtractorOptions, FeatureSet, Keypoint, frame_parts, picture_parts, write_gray,
    write_token_positions,
};
use crate::front_end::FrontEndOptions;
use crate::geometry::{Pixel, SceneScale};
use crate::image::GrayView;
use crate::models::{ExtractorKind, RegressorConfig};
use crate::nn::Weights;
use crate::nn::gpu::{
    FrameParts, GpuCost, GpuDevice, GpuError, GpuFrame, GpuPart, Pipelines, Timer, WeightStorage,
    self_test,
};
use crate::regress::{Predictions, decode, network_parts};
use crate::scene_file::{ExtractorFile, SceneFile};
use std::sync::Arc;

/// A scene's networks on a device. Made once; what depends on the picture's size is made when the first picture comes, and
/// anew when one of another size does.
pub struct GpuNetworks {
    gpu: Arc<GpuDevice>,
    pipelines: Pipelines,
    timer: Option<Timer>,
    kind: ExtractorKind,
    weights: Weights,
    options: ExtractorOptions,
    config: RegressorConfig,
    scale: SceneScale,
    storage: WeightStorage,
    /// The second look needs them on the CPU.
    reads_descriptors: bool,
    /// Until the first picture comes.
    branches: Vec<GpuPart>,
    frame: Option<GpuFrame>,
    size: (usize, usize),
    gray: Vec<f32>,
    tokens: Vec<f32>,
}

impl core::fmt::Debug for GpuNetworks {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("GpuNetworks")
            .field("gpu", &self.gpu)
            .finish_non_exhaustive()
    }
}

impl GpuNetworks {
    /// Tests the device and prepares the networks, with the options of the relocalizer that they are for. `timer` bounds the
    /// wait for results; natively the driver blocks and none is needed.
    ///
    /// # Errors
    /// [`GpuError`]: a reason to stay on the CPU. [`GpuError::SelfTest`] when the device computes wrongly.
    pub async fn new(
        gpu: Arc<GpuDevice>,
        scene: &SceneFile,
        extractor: &ExtractorFile,
        options: &FrontEndOptions,
        timer: Option<Timer>,
    ) -> Result<Self, GpuError> {
        let mut pipelines = Pipelines::new(&gpu);
        let storage = self_test(&gpu, &mut pipelines, timer.as_ref()).await?;
        let options = options.extractor();
        let parts = network_parts(
            &scene.config,
            scene.weights.clone(),
            options.keypoints.max_keypoints,
            options.max_segments,
        )
        .map_err(|error| unsupported(error.to_string()))?;
        Ok(Self {
            gpu,
            pipelines,
            timer,
            kind: extractor.kind,
            weights: extractor.weights.clone(),
            options,
            config: scene.config.clone(),
            scale: scene.info.scale,
            storage,
            reads_descriptors: scene.landmarks.is_some(),
            branches: parts
                .into_iter()
                .map(|(graph, weights)| GpuPart { graph, weights })
                .collect(),
            frame: None,
            size: (0, 0),
            gray: Vec::new(),
            tokens: Vec::new(),
        })
    }

    /// Refuses options that these networks were not prepared with.
    pub(super) fn check_options(&self, options: &FrontEndOptions) -> Result<(), GpuError> {
        if self.options == options.extractor() {
            return Ok(());
        }
        Err(unsupported(format!(
            "prepared with {:?}, the relocalizer has {:?}",
            self.options,
            options.extractor()
        )))
    }

    /// The device.
    pub fn device(&self) -> &Arc<GpuDevice> {
        &self.gpu
    }

    /// How the weights are stored: what the self-test has shown to work.
    pub fn storage(&self) -> WeightStorage {
        self.storage
    }

    /// What a frame costs at full capacity, and the bytes of its one readback; `None` before the first frame.
    pub fn cost(&self) -> Option<(GpuCost, u64)> {
        self.frame
            .as_ref()
            .map(|frame| (frame.cost(), frame.readback_bytes()))
    }

    /// Makes everything for pictures of this size, if it is not there yet.
    async fn prepare(&mut self, size: (usize, usize)) -> Result<(), GpuError> {
        if self.frame.is_some() && self.size == size {
            return Ok(());
        }
        let failed = |error: crate::features::FeatureError| unsupported(error.to_string());
        let (kind, weights, options) = (self.kind, &self.weights, &self.options);
        if let Some(frame) = &mut self.frame {
            let parts = picture_parts(kind, weights, options, size).map_err(failed)?;
            frame.resize(&mut self.pipelines, parts).await?;
        } else {
            let branches = std::mem::take(&mut self.branches);
            let parts = FrameParts {
                reads_descriptors: self.reads_descriptors,
                ..frame_parts(kind, weights, options, size, branches, self.storage)
                    .map_err(failed)?
            };
            let frame = GpuFrame::new(&self.gpu, &mut self.pipelines, parts).await?;
            self.frame = Some(frame);
        }
        self.size = size;
        Ok(())
    }

    /// Starts extractor and selection on a picture and returns at once, unless its size is new.
    pub(super) async fn submit(&mut self, working: &GrayView<'_>) -> Result<(), GpuError> {
        self.prepare((working.width, working.height)).await?;
        self.gray.resize(working.width * working.height, 0.0);
        write_gray(working, &mut self.gray);
        match &self.frame {
            Some(frame) => frame.submit(&self.gray),
            None => Err(unsupported("no frame was made".to_owned())),
        }
    }

    /// Runs the rest on the segments of the features and waits for the results; keypoints come into the features, and
    /// descriptors where the scene has landmarks.
    pub(super) async fn finish(
        &mut self,
        features: &mut FeatureSet,
        predictions: &mut Predictions,
    ) -> Result<(), GpuError> {
        let Some(frame) = &mut self.frame else {
            return Err(unsupported("no picture was submitted".to_owned()));
        };
        self.tokens.clear();
        write_token_positions(&features.segments, self.options.tokens, &mut self.tokens);
        let result = frame.finish(&self.tokens, self.timer.as_ref()).await?;
        features.keypoints.clear();
        features
            .keypoints
            .extend(
                result
                    .positions
                    .chunks_exact(2)
                    .zip(&result.scores)
                    .map(|(p, &score)| Keypoint {
                        pixel: Pixel::new(f64::from(p[0]), f64::from(p[1])),
                        score,
                    }),
            );
        features.descriptor_channels = self.kind.descriptor_channels();
        features.tokens = self.options.tokens;
        [features.descriptors_nd, features.segment_descriptors_nsd] = result.descriptors;
        predictions.clear();
        for (index, outputs) in result.branches.iter().enumerate() {
            let output = |name: &str| {
                let found = outputs.iter().find(|(found, _)| found == name)?;
                Some(found.1.as_slice())
            };
            decode(&self.config, index, &self.scale, output, predictions)
                .map_err(|error| unsupported(error.to_string()))?;
        }
        Ok(())
    }
}

fn unsupported(problem: String) -> GpuError {
    GpuError::Unsupported {
        network: "scene".to_owned(),
        op: "frame",
        problem,
    }
}
