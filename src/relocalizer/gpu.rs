//! The networks of a frame on the GPU: extractor, selection, sampling and branches with one readback, segments detected on
//! the CPU meanwhile.

use super::options::RelocalizerOptions;
use crate::features::{ExtractorOptions, Keypoint, frame_parts, write_gray, write_token_positions};
use crate::geometry::{Pixel, SceneScale, Segment2};
use crate::image::GrayView;
use crate::models::{ExtractorKind, RegressorConfig, ports};
use crate::nn::Weights;
use crate::nn::gpu::{
    FrameResult, GpuCost, GpuDevice, GpuError, GpuFrame, GpuPart, Pipelines, Timer, self_test,
};
use crate::regress::{Predictions, decode_lines, decode_points, decode_v1, network_parts};
use crate::scene_file::{ExtractorFile, SceneFile};
use std::sync::Arc;

/// A scene's networks on a device. Made once; buffers and pipelines for a picture size are made when the first picture of
/// that size comes.
pub struct GpuNetworks {
    gpu: Arc<GpuDevice>,
    pipelines: Pipelines,
    timer: Option<Timer>,
    kind: ExtractorKind,
    weights: Weights,
    options: ExtractorOptions,
    config: RegressorConfig,
    scale: SceneScale,
    branches: Vec<GpuPart>,
    frame: Option<((usize, usize), GpuFrame)>,
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
    /// Tests the device and prepares the networks. `change` must be the same that the relocalizer gets. `timer` bounds the
    /// wait for results; natively the driver blocks and none is needed.
    ///
    /// # Errors
    /// [`GpuError`]: a reason to stay on the CPU. [`GpuError::SelfTest`] when the device computes wrongly.
    pub async fn new(
        gpu: Arc<GpuDevice>,
        scene: &SceneFile,
        extractor: &ExtractorFile,
        change: impl FnOnce(&mut RelocalizerOptions),
        timer: Option<Timer>,
    ) -> Result<Self, GpuError> {
        let mut pipelines = Pipelines::new(&gpu);
        self_test(&gpu, &mut pipelines, timer.as_ref()).await?;
        let mut options = RelocalizerOptions::new(extractor.kind);
        change(&mut options);
        let options = ExtractorOptions {
            keypoints: options.keypoints,
            max_segments: options.max_segments,
            tokens: scene.config.line_tokens().unwrap_or(2),
            sampler: scene.info.sampler,
        };
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
            branches: parts
                .into_iter()
                .map(|(graph, weights)| GpuPart { graph, weights })
                .collect(),
            frame: None,
            gray: Vec::new(),
            tokens: Vec::new(),
        })
    }

    /// The device.
    pub fn device(&self) -> &Arc<GpuDevice> {
        &self.gpu
    }

    /// What a frame costs at full capacity, and the bytes of its one readback; `None` before the first frame.
    pub fn cost(&self) -> Option<(GpuCost, u64)> {
        self.frame
            .as_ref()
            .map(|(_, frame)| (frame.cost(), frame.readback_bytes()))
    }

    /// Starts extractor and selection on a picture and returns at once.
    pub(super) fn submit(&mut self, working: &GrayView<'_>) -> Result<(), GpuError> {
        let size = (working.width, working.height);
        if self
            .frame
            .as_ref()
            .is_none_or(|(made_for, _)| *made_for != size)
        {
            // The old size goes first: two of them may not fit.
            self.frame = None;
            let parts = frame_parts(
                self.kind,
                &self.weights,
                &self.options,
                size,
                self.branches.clone(),
            )
            .map_err(|error| unsupported(error.to_string()))?;
            self.frame = Some((size, GpuFrame::new(&self.gpu, &mut self.pipelines, parts)?));
        }
        self.gray.resize(working.width * working.height, 0.0);
        write_gray(working, &mut self.gray);
        match &self.frame {
            Some((_, frame)) => frame.submit(&self.gray),
            None => Err(unsupported("no frame was made".to_owned())),
        }
    }

    /// Runs the rest on these segments of the picture and waits for the results.
    pub(super) async fn finish(
        &mut self,
        segments: &[Segment2],
        keypoints: &mut Vec<Keypoint>,
        predictions: &mut Predictions,
    ) -> Result<(), GpuError> {
        let Some((_, frame)) = &mut self.frame else {
            return Err(unsupported("no picture was submitted".to_owned()));
        };
        self.tokens.clear();
        write_token_positions(segments, self.options.tokens, &mut self.tokens);
        let result = frame.finish(&self.tokens, self.timer.as_ref()).await?;
        keypoints.clear();
        keypoints.extend(result.positions.chunks_exact(2).zip(&result.scores).map(
            |(p, &score)| Keypoint {
                pixel: Pixel::new(f64::from(p[0]), f64::from(p[1])),
                score,
            },
        ));
        decode(&self.config, &self.scale, &result, predictions)
    }
}

fn unsupported(problem: String) -> GpuError {
    GpuError::Unsupported {
        network: "scene".to_owned(),
        op: "frame",
        problem,
    }
}

fn decode(
    config: &RegressorConfig,
    scale: &SceneScale,
    result: &FrameResult,
    out: &mut Predictions,
) -> Result<(), GpuError> {
    let find = |branch: usize, name: &str| -> Option<&[f32]> {
        let outputs = result.branches.get(branch)?;
        outputs
            .iter()
            .find(|(found, _)| found == name)
            .map(|(_, data)| data.as_slice())
    };
    let output = |branch: usize, name: &str| {
        find(branch, name)
            .ok_or_else(|| unsupported(format!("branch {branch} has no output `{name}`")))
    };
    out.clear();
    match config {
        RegressorConfig::Branches { line, .. } => {
            let rows = find(0, ports::ROWS);
            decode_points(
                scale,
                output(0, ports::LOGITS)?,
                output(0, ports::COORDINATES)?,
                rows,
                out,
            );
            if line.is_some() {
                let rows = find(1, ports::ROWS);
                decode_lines(
                    scale,
                    output(1, ports::LOGITS)?,
                    output(1, ports::COORDINATES)?,
                    rows,
                    out,
                );
            }
        }
        RegressorConfig::V1(v1) => {
            decode_v1(
                v1,
                scale,
                output(0, ports::POINTS_3D)?,
                output(0, ports::LINES_3D)?,
                out,
            );
        }
    }
    Ok(())
}
