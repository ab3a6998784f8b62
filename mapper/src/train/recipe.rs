//! The recipes behind the presets: how each branch is trained.

use super::buffer::Kind;
use landline::models::Preset;
use serde::{Deserialize, Serialize};

/// Where landmarks come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnchorStart {
    /// The best tracks of the labels.
    Landmarks,
    /// Noise; to measure what the landmarks are worth.
    Random,
}

/// How a branch is trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Steps in all.
    pub steps: usize,
    /// Images in a batch; with attention only.
    pub images: usize,
    /// Rows in a batch, or of each image with attention.
    pub rows: usize,
    /// Peak learning rate.
    pub rate: f64,
    /// Part of the run in which the rate rises.
    pub warm_up: f64,
    /// Factors on the rate of tensors whose name ends so.
    pub rate_factors: Vec<(String, f64)>,
    /// Added to every descriptor number.
    pub descriptor_noise: f64,
    /// Whether the image-space variants of the pictures are learned from, where the labels have some.
    pub variants: bool,
    /// Where landmarks come from.
    pub anchor_start: AnchorStart,
    /// Decoupled weight decay of matrices.
    pub weight_decay: f32,
    /// Largest norm of the gradient.
    pub max_gradient_norm: Option<f32>,
    /// Decay of the running average; 0 for none.
    pub average_decay: f64,
    /// Weight of the scene distance.
    pub scene_weight: f64,
    /// The scene distance is `limit * tanh(d / limit)`; `None` leaves it straight.
    pub scene_clamp_m: Option<f64>,
    /// Weight of the reprojection error in metres.
    pub reprojection_weight: f64,
    /// Clamp of the reprojection error in pixels: beginning, end.
    pub reprojection_clamp_px: [f64; 2],
    /// Part of the run without the reprojection loss.
    pub reprojection_start: f64,
    /// Weight of the reliability.
    pub reliability_weight: f64,
    /// Anchored branches: a row is reliable when it reprojects within this.
    pub reliable_px: f64,
    /// Sums, pixels and no clamp of the distance, as the paper's code.
    pub paper_reduction: bool,
    /// The paper's step-wise rate instead of one cycle.
    pub halving_rate: bool,
}

/// The recipe of a preset's branch, before `--steps` or `--minutes` change its length.
pub fn recipe(preset: Preset, kind: Kind) -> Recipe {
    match preset {
        Preset::Compact => compact(kind),
        Preset::Standard => standard(kind),
        Preset::Paper => paper(kind),
    }
}

/// Factors on the rate of a branch whose own rate is `1 / relative` times that of the reliability.
///
/// A landmark is chosen by few rows of a batch, so its gradient is mostly noise, which Adam scales up to full steps: at the
/// rate of the reliability, positions wander by more centimetres than training could gain.
fn landmark_rates(relative: f64) -> Vec<(String, f64)> {
    [
        ("anchor.sharpness", 25.0),
        ("anchor.keys", 0.05),
        ("anchor.positions", 0.02),
        ("anchor.segments", 0.02),
    ]
    .map(|(name, factor)| (name.to_owned(), factor * relative))
    .to_vec()
}

/// Landmarks refined: rows drawn over all pictures, clamped losses in metres.
fn compact(kind: Kind) -> Recipe {
    Recipe {
        steps: 600,
        images: 1,
        rows: match kind {
            Kind::Points => 2048,
            Kind::Segments => 1024,
        },
        rate: 2e-3,
        warm_up: 0.05,
        rate_factors: landmark_rates(1.0),
        descriptor_noise: 0.03,
        variants: true,
        anchor_start: AnchorStart::Landmarks,
        weight_decay: 0.0,
        max_gradient_norm: None,
        average_decay: 0.99,
        scene_weight: 1.0,
        scene_clamp_m: Some(0.1),
        reprojection_weight: 1.0,
        reprojection_clamp_px: [20.0, 4.0],
        reprojection_start: 0.0,
        reliability_weight: 1.0,
        reliable_px: 6.0,
        paper_reduction: false,
        halving_rate: false,
    }
}

/// Attention sized for a CPU: many pictures a step, a subset of their features, strong descriptor noise.
fn standard(kind: Kind) -> Recipe {
    Recipe {
        images: 16,
        rows: match kind {
            Kind::Points => 192,
            Kind::Segments => 96,
        },
        steps: match kind {
            Kind::Points => 1500,
            Kind::Segments => 1000,
        },
        rate: 1e-3,
        rate_factors: landmark_rates(2.0),
        descriptor_noise: 0.06,
        weight_decay: 1e-4,
        max_gradient_norm: Some(1.0),
        average_decay: 0.999,
        reprojection_start: 0.05,
        ..compact(kind)
    }
}

/// As printed in the paper and set in its code: one picture a step, Adam, sums, halving rate.
fn paper(kind: Kind) -> Recipe {
    Recipe {
        images: 1,
        rows: match kind {
            Kind::Points => 2048,
            Kind::Segments => 512,
        },
        steps: 2_500_000,
        rate: 2e-4,
        warm_up: 0.0,
        rate_factors: Vec::new(),
        descriptor_noise: 0.0,
        variants: true,
        anchor_start: AnchorStart::Landmarks,
        weight_decay: 0.0,
        max_gradient_norm: None,
        average_decay: 0.0,
        scene_weight: 1.0,
        scene_clamp_m: None,
        reprojection_weight: 1.0,
        reprojection_clamp_px: [51.0, 1.0],
        reprojection_start: 0.05,
        reliability_weight: 1.0,
        reliable_px: 6.0,
        paper_reduction: true,
        halving_rate: true,
    }
}
