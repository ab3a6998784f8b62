//! One branch in training: its parameters, its data, its steps.
//!
//! Losses of a step, all in metres so that they weigh alike (a reprojection error becomes metres by depth / focal length):
//! scene distance and reprojection of the labelled rows, cross-entropy of the reliability over all rows. Branches without
//! landmarks take the label itself as reliable (the paper); those with landmarks take "reprojects within a few pixels", which
//! also tells them of unlabelled features. Pruning logits beside the reliability learn the label. With `paper_reduction` the scene distance is a sum, as the reference has it.

use super::buffer::{Batch, Buffer, Kind};
use super::loss::{self, Observations};
use super::net::{self, Context, Prediction};
use super::params::{AdamSettings, Leaves, Parameters, numbers};
use super::recipe::{AnchorStart, Recipe};
use super::{init, schedule};
use burn::tensor::{Device, Tensor, TensorData};
use landline::geometry::SceneScale;
use landline::landmarks::anchors::{line_anchors, point_anchors};
use landline::math::Rng;
use landline::models::landmarks::{anchored_start, fan_in};
use landline::models::{AttentionOutput, LineBranchConfig, PointBranchConfig, TensorSpec};
use landline::reconstruction::Reconstruction;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A branch of either kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BranchConfig {
    /// Keypoints to points.
    Point(PointBranchConfig),
    /// Segments to 3D segments.
    Line(LineBranchConfig),
}

impl BranchConfig {
    /// Which features go in.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Point(_) => Kind::Points,
            Self::Line(_) => Kind::Segments,
        }
    }

    /// Names and shapes of the tensors.
    pub fn tensors(&self) -> Vec<TensorSpec> {
        match self {
            Self::Point(c) => c.tensors(),
            Self::Line(c) => c.tensors(),
        }
    }

    /// Numbers in a descriptor.
    pub fn descriptor_len(&self) -> usize {
        match self {
            Self::Point(c) => c.descriptor_channels(),
            Self::Line(c) => c.descriptor_channels(),
        }
    }

    /// Number of landmarks and numbers in a key, where coordinates come from a choice among landmarks.
    pub fn choice(&mut self) -> Option<(&mut usize, usize)> {
        match self {
            Self::Point(PointBranchConfig::Anchored(c)) => {
                Some((&mut c.num_anchors, c.descriptor_channels))
            }
            Self::Line(LineBranchConfig::Anchored(c)) => Some((&mut c.num_anchors, c.key_channels)),
            Self::Point(PointBranchConfig::Attention(c)) => {
                Some((num_anchors(&mut c.output)?, c.descriptor_channels))
            }
            Self::Line(LineBranchConfig::Attention(c)) => {
                Some((num_anchors(&mut c.output)?, c.descriptor_channels))
            }
        }
    }

    /// Whether rows of one image see each other.
    pub fn has_attention(&self) -> bool {
        matches!(
            self,
            Self::Point(PointBranchConfig::Attention(_))
                | Self::Line(LineBranchConfig::Attention(_))
        )
    }
}

/// Means over a step, for the log.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct StepReport {
    /// What is minimised.
    pub total: f64,
    /// Scene distance of the labelled rows in world units, unclamped.
    pub scene: f64,
    /// Reprojection error of the labelled rows, clamped at the schedule's limit.
    pub reprojection_px: f64,
    /// Cross-entropy of the reliability.
    pub reliability: f64,
    /// Norm of the gradient.
    pub gradient: f64,
    /// Learning rate.
    pub rate: f64,
}

/// What a branch predicts for rows, read back.
#[derive(Debug, Clone, Default)]
pub struct Predicted {
    /// Centred world coordinates in world units, 3 or 6 a row.
    pub coordinates: Vec<f32>,
    /// 0..1.
    pub confidence: Vec<f32>,
    /// Pixels; for segments the sum over both ends.
    pub reprojection_px: Vec<f32>,
    /// Distance to the target in world units; 0 without one.
    pub scene: Vec<f32>,
}

/// The averages that did best on the held-out pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// Held-out score, smaller is better.
    pub score: f64,
    /// When.
    pub step: usize,
    /// In the configuration's order.
    pub values: Vec<Vec<f32>>,
}

/// The rate falls straight to zero from here on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoolDown {
    /// First step.
    pub from_step: usize,
    /// Rate at that step.
    pub from_rate: f64,
}

/// A branch in training.
#[derive(Clone)]
pub struct Session {
    /// What is trained.
    pub config: BranchConfig,
    /// How.
    pub recipe: Recipe,
    /// Normalisation of coordinates.
    pub scale: SceneScale,
    /// World units that the losses take for a metre.
    metre: f64,
    /// Steps done.
    pub step: usize,
    /// What the run will deliver, if pictures are held out.
    pub best: Option<Best>,
    /// Judgements in a row without progress.
    pub stale: usize,
    /// Set when the rest of the run is cut short.
    pub cool_down: Option<CoolDown>,
    seed: u64,
    parameters: Parameters,
    adam: AdamSettings,
}

/// Part of a run that an early cool-down takes.
const COOL_DOWN_SHARE: f64 = 0.1;
/// A run does not cool down before this part of it.
const COOL_FROM: f64 = 0.4;
/// Relative gain on the held-out pictures that counts as progress.
const LEAST_PROGRESS: f64 = 0.02;
/// Judgements without progress after which a run cools down.
const MAX_STALE: usize = 3;

fn num_anchors(output: &mut AttentionOutput) -> Option<&mut usize> {
    match output {
        AttentionOutput::Anchored { num_anchors, .. } => Some(num_anchors),
        AttentionOutput::Linear => None,
    }
}

fn cool_down_len(steps: usize) -> usize {
    ((steps as f64 * COOL_DOWN_SHARE) as usize).max(1)
}

fn target_len(kind: Kind) -> usize {
    match kind {
        Kind::Points => 3,
        Kind::Segments => 6,
    }
}

impl Session {
    /// A branch at its start, which knows nothing of the `held` pictures. Configurations with landmarks are shrunk to those
    /// that there are.
    pub fn new(
        mut config: BranchConfig,
        recipe: Recipe,
        map: &Reconstruction,
        held: &Range<usize>,
        scale: SceneScale,
        seed: u64,
        device: &Device,
    ) -> Self {
        let mut rng = Rng::from_seed(seed);
        let kind = config.kind();
        let anchors = config.choice().map(|(num_anchors, key_len)| {
            let anchors = match (recipe.anchor_start, kind) {
                (AnchorStart::Random, _) => {
                    init::random_anchors(*num_anchors, key_len, target_len(kind), &mut rng)
                }
                (_, Kind::Points) => point_anchors(map, held, &scale, *num_anchors),
                (_, Kind::Segments) => line_anchors(map, held, &scale, *num_anchors),
            };
            *num_anchors = anchors.len();
            anchors
        });
        let specs = config.tensors();
        let start = |spec: &TensorSpec| {
            let fan_in = fan_in(spec, &specs);
            if config.has_attention() {
                let start = init::AttentionStart {
                    specs: &specs,
                    seed,
                    residual_zero: !recipe.paper_reduction,
                    anchors: anchors.as_deref(),
                };
                init::attention_start(spec, fan_in, &start)
            } else {
                anchored_start(spec, fan_in, anchors.as_deref().unwrap_or(&[]), &mut rng)
            }
        };
        let mut parameters = Parameters::new(specs.clone(), device, start);
        for (name, factor) in &recipe.rate_factors {
            parameters.scale_rate(name, *factor);
        }
        let adam = AdamSettings {
            beta_1: 0.9,
            beta_2: if recipe.paper_reduction { 0.999 } else { 0.99 },
            epsilon: 1e-8,
            weight_decay: recipe.weight_decay,
            max_gradient_norm: recipe.max_gradient_norm,
        };
        Self {
            config,
            recipe,
            scale,
            metre: scale.nominal_metre(map.units),
            step: 0,
            best: None,
            stale: 0,
            cool_down: None,
            seed,
            parameters,
            adam,
        }
    }

    /// The trained tensors.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The trained tensors, to restore them.
    pub fn parameters_mut(&mut self) -> &mut Parameters {
        &mut self.parameters
    }

    fn rng_of_step(&self, salt: u64) -> Rng {
        // A generator for each step: a resumed run draws what an uninterrupted one would have drawn.
        let step = (self.step as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Rng::from_seed(self.seed ^ step ^ salt)
    }

    fn draw(&self, buffer: &Buffer<'_>) -> Batch {
        let mut rng = self.rng_of_step(0);
        let mut batch = if self.config.has_attention() {
            buffer.draw_images(self.recipe.images, self.recipe.rows, &mut rng)
        } else {
            buffer.draw_rows(self.recipe.rows, &mut rng)
        };
        let descriptor = self.config.descriptor_len();
        batch.disturb(
            self.config.kind(),
            descriptor,
            self.recipe.descriptor_noise,
            &mut rng,
        );
        batch
    }

    /// Steps in all, fewer once the run cools down early.
    pub fn end(&self) -> usize {
        let steps = self.recipe.steps;
        self.cool_down
            .map_or(steps, |c| (c.from_step + cool_down_len(steps)).min(steps))
    }

    /// Progress in 0..1 that schedules go by.
    fn progress(&self) -> f64 {
        match self.cool_down {
            Some(c) => {
                let len = cool_down_len(self.recipe.steps) as f64;
                1.0 - COOL_DOWN_SHARE * (1.0 - (self.step - c.from_step) as f64 / len)
            }
            None => self.step as f64 / self.recipe.steps.max(1) as f64,
        }
    }

    fn rate(&self, num_images: usize) -> f64 {
        let r = &self.recipe;
        if let Some(c) = self.cool_down {
            let len = cool_down_len(r.steps) as f64;
            return c.from_rate * (1.0 - (self.step - c.from_step) as f64 / len).max(0.0);
        }
        if r.halving_rate {
            let epoch_len = num_images.max(1);
            schedule::halving(self.step / epoch_len, r.steps / epoch_len, r.rate)
        } else {
            schedule::one_cycle(self.progress(), r.rate, r.warm_up, 1e-3)
        }
    }

    /// Takes note of a judgement on the held-out pictures: keeps the averages if they are the best so far, and begins to cool
    /// down when there was no progress for a while.
    pub fn judged(&mut self, score: f64, num_images: usize) {
        let (before, is_better) = match &self.best {
            Some(best) => (best.score, score < best.score),
            None => (f64::INFINITY, true),
        };
        let is_progress = self.best.is_none() || score < (1.0 - LEAST_PROGRESS) * before;
        self.stale = if is_progress { 0 } else { self.stale + 1 };
        if is_better {
            self.best = Some(Best {
                score,
                step: self.step,
                values: self.parameters.average_values(),
            });
        }
        let t = self.progress();
        let may_cool = self.cool_down.is_none() && !self.recipe.halving_rate;
        if may_cool && self.stale >= MAX_STALE && (COOL_FROM..1.0 - COOL_DOWN_SHARE).contains(&t) {
            self.cool_down = Some(CoolDown {
                from_step: self.step,
                from_rate: self.rate(num_images),
            });
        }
    }

    /// The same branch with other averages, for evaluation.
    #[must_use]
    pub fn with_averages(&self, values: &[Vec<f32>]) -> Self {
        let mut out = self.clone();
        out.parameters = self.parameters.with_averages(values);
        out
    }

    /// What the run delivers: the best on the held-out pictures, or the averages where none are.
    pub fn result(&self) -> Vec<Vec<f32>> {
        match &self.best {
            Some(best) => best.values.clone(),
            None => self.parameters.average_values(),
        }
    }

    fn forward(&self, leaves: &Leaves<'_>, inputs: Tensor<2>, context: Context) -> Prediction {
        match &self.config {
            BranchConfig::Point(PointBranchConfig::Anchored(c)) => {
                net::anchored_points(c, leaves, inputs)
            }
            BranchConfig::Line(LineBranchConfig::Anchored(c)) => {
                net::anchored_lines(c, leaves, inputs)
            }
            BranchConfig::Point(PointBranchConfig::Attention(c)) => {
                net::attention_points(c, leaves, inputs, |_| context)
            }
            BranchConfig::Line(LineBranchConfig::Attention(c)) => {
                net::attention_lines(c, leaves, inputs, &context)
            }
        }
    }

    /// Whether the points that others attend to are chosen by a pruning MLP.
    fn has_pruning(&self) -> bool {
        self.config.kind() == Kind::Points && self.parameters.has("point.prune.0.w")
    }

    /// Whether coordinates come from a choice among landmarks.
    fn has_landmarks(&self) -> bool {
        let prefix = match self.config.kind() {
            Kind::Points => "point",
            Kind::Segments => "line",
        };
        self.parameters.has(&format!("{prefix}.anchor.keys"))
    }

    /// Network coordinates in metres, as the losses have them; in a world of arbitrary units in nominal ones.
    fn metres(&self, coordinates: Tensor<2>) -> Tensor<2> {
        coordinates.mul_scalar(self.scale.scale / self.metre)
    }

    fn reprojection(&self, coordinates: Tensor<2>, o: &Observations) -> [Tensor<2>; 3] {
        match self.config.kind() {
            Kind::Points => loss::point_reprojection(coordinates, o),
            Kind::Segments => loss::segment_reprojection(coordinates, o),
        }
    }

    /// Distance of predicted coordinates to the target. Segments: of both ends from the target's infinite line, plus a
    /// tenth of the distance of the ends, because a solver does not care where on its line a segment lies.
    fn scene_distance(&self, prediction: Tensor<2>, target: Tensor<2>) -> Tensor<2> {
        if self.config.kind() == Kind::Points || self.recipe.paper_reduction {
            return loss::distance(prediction, target);
        }
        let start = target.clone().narrow(1, 0, 3);
        let along = target.clone().narrow(1, 3, 3) - start.clone();
        let along = net::unit_rows(along);
        let off = |column: usize| {
            let d = prediction.clone().narrow(1, column, 3) - start.clone();
            let parallel = (d.clone() * along.clone()).sum_dim(1);
            let across = d - along.clone() * parallel;
            let zero = across.zeros_like();
            loss::distance(across, zero)
        };
        let ends = loss::distance(prediction.clone(), target);
        (off(0) + off(3)).mul_scalar(0.5) + ends.mul_scalar(0.1)
    }

    /// One step on rows of the buffer.
    pub fn train_step(&mut self, buffer: &Buffer<'_>) -> StepReport {
        let t = self.progress();
        let batch = self.draw(buffer);
        let device = self.parameters.device().clone().autodiff();
        self.parameters
            .device()
            .seed(self.rng_of_step(1).next_u64());
        let (report, gradients) = {
            let leaves = self.parameters.leaves();
            let (total, report) = self.losses(&leaves, &batch, buffer.input_len(), t, &device);
            let gradients = total.backward();
            (report, leaves.gradients(gradients))
        };
        let rate = self.rate(buffer.num_images());
        // The average starts when the rate has begun to fall; before, it would drag the start values along.
        let decay = if t < 0.2 {
            0.0
        } else {
            self.recipe.average_decay
        };
        let gradient = self.parameters.step(gradients, rate, &self.adam, decay);
        self.step += 1;
        StepReport {
            gradient,
            rate,
            ..report
        }
    }

    fn losses(
        &self,
        leaves: &Leaves<'_>,
        batch: &Batch,
        input_len: usize,
        t: f64,
        device: &Device,
    ) -> (Tensor<1>, StepReport) {
        let r = &self.recipe;
        let rows = batch.rows();
        let inputs = Tensor::from_data(
            TensorData::new(batch.inputs.clone(), [rows, input_len]),
            device,
        );
        let target_len = batch.targets.len() / rows;
        let targets = Tensor::from_data(
            TensorData::new(batch.targets.clone(), [rows, target_len]),
            device,
        );
        let has_target = loss::column(&batch.has_target, device);
        let is_real = loss::column(&batch.is_real, device);
        let o = batch.observations.to_device(device);
        let context = Context {
            images: if self.config.has_attention() {
                r.images
            } else {
                1
            },
            // The paper's training: points attend to what has a label, segments to all.
            attended: if self.has_pruning() {
                has_target.clone()
            } else {
                is_real.clone()
            },
            training: true,
        };
        let prediction = self.forward(leaves, inputs, context);
        let metres = self.metres(prediction.coordinates);
        let distance = self.scene_distance(metres.clone(), targets);
        let [error_px, depth, usable] = self.reprojection(metres, &o);
        let limit = schedule::clamp_px(
            t,
            r.reprojection_clamp_px[0] - r.reprojection_clamp_px[1],
            r.reprojection_clamp_px[1],
        );
        let clamped_px = loss::clamped(error_px.clone(), limit);
        let kept = has_target.clone() * usable.clone();
        let scene_rows = match r.scene_clamp_m {
            Some(limit) => loss::clamped(distance.clone(), limit),
            None => distance.clone(),
        };
        let [scene_sum, scene_count] = loss::weighted(scene_rows, has_target.clone());
        let scene = if r.paper_reduction {
            scene_sum
        } else {
            scene_sum / scene_count
        };
        let reprojection = if t < r.reprojection_start {
            scene.zeros_like()
        } else if r.paper_reduction {
            loss::weighted_mean(clamped_px.clone(), kept.clone())
        } else {
            let metres_per_px = depth.detach() / o.focal_px.clone();
            loss::weighted_mean(clamped_px.clone() * metres_per_px, kept.clone())
        };
        let reliable = if self.has_landmarks() {
            error_px.detach().lower_equal_scalar(r.reliable_px).float() * usable
        } else {
            has_target.clone()
        };
        let entropy = |logits: Tensor<2>, target: Tensor<2>| {
            loss::weighted_mean(loss::cross_entropy(logits, target), is_real.clone())
        };
        let mut reliability = entropy(prediction.logits, reliable);
        if let Some(logits) = prediction.pruning {
            reliability = reliability + entropy(logits, has_target.clone());
        }
        let total = scene.mul_scalar(r.scene_weight)
            + reprojection.mul_scalar(r.reprojection_weight)
            + reliability.clone().mul_scalar(r.reliability_weight);
        let number = |x: Tensor<1>| f64::from(x.into_scalar::<f32>());
        let report = StepReport {
            total: number(total.clone().inner()),
            scene: self.metre * number(loss::weighted_mean(distance, has_target).inner()),
            reprojection_px: number(loss::weighted_mean(clamped_px, kept).inner()),
            reliability: number(reliability.inner()),
            ..StepReport::default()
        };
        (total, report)
    }

    /// What the averaged parameters predict for the rows of one image.
    pub fn predict(&self, buffer: &Buffer<'_>, image: usize) -> Predicted {
        let rows: Vec<usize> = buffer.image_rows(image).collect();
        if rows.is_empty() {
            return Predicted::default();
        }
        let batch = buffer.rows(rows);
        let device = self.parameters.device();
        let count = batch.rows();
        let inputs = Tensor::from_data(
            TensorData::new(batch.inputs.clone(), [count, buffer.input_len()]),
            device,
        );
        let leaves = self.parameters.averages();
        let context = Context {
            images: 1,
            attended: net::all_rows(count, device),
            training: false,
        };
        // Pruned points are not attended to either.
        let prediction = match &self.config {
            BranchConfig::Point(PointBranchConfig::Attention(c)) => {
                net::attention_points(c, &leaves, inputs, |logits| match logits {
                    Some(logits) => Context {
                        attended: burn::tensor::activation::sigmoid(logits.clone())
                            .greater_scalar(c.min_confidence)
                            .float(),
                        ..context
                    },
                    None => context,
                })
            }
            _ => self.forward(&leaves, inputs, context),
        };
        let metres = self.metres(prediction.coordinates);
        let target_len = batch.targets.len() / count;
        let targets =
            Tensor::from_data(TensorData::new(batch.targets, [count, target_len]), device);
        let distance =
            self.scene_distance(metres.clone(), targets) * loss::column(&batch.has_target, device);
        let [error, _, usable] =
            self.reprojection(metres.clone(), &batch.observations.to_device(device));
        let unusable = usable.neg().add_scalar(1.0).mul_scalar(loss::MAX_ERROR_PX);
        Predicted {
            coordinates: numbers(&metres.mul_scalar(self.metre)),
            confidence: numbers(&burn::tensor::activation::sigmoid(prediction.logits)),
            reprojection_px: numbers(&(error + unusable)),
            scene: numbers(&distance.mul_scalar(self.metre)),
        }
    }
}
