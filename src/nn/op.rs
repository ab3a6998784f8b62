//! The fixed list of operations. `x` is the first input; weights are named in the graph.
//!
//! Activations are `[rows, channels]`; weights are `[out, in]` for linear layers and `[out, in, 3, 3]` for convolutions.

use super::shape::WeightId;

/// Makes an enumeration and the list of all it has, so that no list can miss one.
macro_rules! listed {
    ($(#[$of_type:meta])* pub enum $type:ident { $($(#[$of_variant:meta])* $variant:ident,)* }) => {
        $(#[$of_type])*
        pub enum $type { $($(#[$of_variant])* $variant,)* }

        impl $type {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];
        }
    };
}

listed! {
    /// Function applied to every number on the way out.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub enum Activation {
        /// `x`
        #[default]
        None,
        /// `max(x, 0)`
        Relu,
        /// `x * (1 + erf(x / sqrt 2)) / 2`, the exact form
        Gelu,
        /// `1 / (1 + exp(-x))`
        Sigmoid,
    }
}

/// How [`Op::Sample`] interpolates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Filter {
    /// 2x2 cells.
    Bilinear,
    /// 4x4 cells, the cubic convolution kernel with parameter -0.75.
    Bicubic,
}

/// Position on a grid from a coordinate: `index = scale * coordinate + offset`, where index 0 is the centre of the first
/// cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisMap {
    /// Cells per unit of the coordinate.
    pub scale: f32,
    /// Index of coordinate zero.
    pub offset: f32,
}

/// Channels of the second output of [`Op::SoftChoice`]: best similarity, second best, their difference, entropy (nats),
/// spread.
pub const CHOICE_STATISTICS: usize = 5;

/// One operation.
#[derive(Debug, Clone, PartialEq)]
pub enum Op {
    /// 3x3 convolution with a border of one zero, then `act(conv + bias + residual)`.
    ///
    /// Inputs: picture, and optionally a residual of the output's size. Output grid: `ceil(size / stride)`.
    Conv3x3 {
        /// `[out, in, 3, 3]`
        weight: WeightId,
        /// `[out]`
        bias: Option<WeightId>,
        /// 1 or 2.
        stride: usize,
        /// Applied last.
        activation: Activation,
    },
    /// Linear layer or 1x1 convolution: `act(x W^T + bias + residual)`.
    ///
    /// With `groups` > 1 output block `g` sees only input block `g`, as in a grouped convolution.
    /// Inputs: x, and optionally a residual of the output's size.
    Linear {
        /// `[out, in / groups]`
        weight: WeightId,
        /// `[out]`
        bias: Option<WeightId>,
        /// Number of blocks.
        groups: usize,
        /// Applied last.
        activation: Activation,
    },
    /// The activation alone.
    Activate {
        /// The function.
        activation: Activation,
    },
    /// `act(a + b)`
    Add {
        /// Applied last.
        activation: Activation,
    },
    /// Bilinear resize to the output's grid with half-pixel centres and clamped borders; adds the second input if there is
    /// one.
    Resize,
    /// Mean of `size` x `size` blocks, `size` apart; what does not fill a block at the right and bottom is left out.
    AvgPool {
        /// Side of a block.
        size: usize,
    },
    /// Maximum of `size` x `size` windows, `stride` apart, the first one starting `pad` before the first pixel. Outside
    /// pixels do not take part.
    MaxPool {
        /// Side of a window.
        size: usize,
        /// Step.
        stride: usize,
        /// Border.
        pad: usize,
    },
    /// Each channel minus its mean over all rows, divided by `sqrt(variance + eps)`.
    InstanceNorm {
        /// Added to the variance.
        eps: f32,
    },
    /// Space to depth: cuts a picture into `block` x `block` cells; the channels of a cell are its pixels row by row, each
    /// with all its input channels.
    Unfold {
        /// Side of a cell.
        block: usize,
    },
    /// Detector head: softmax over `block * block + 1` channels, drops the last one and puts the others back as
    /// a `block` x `block` patch of a one-channel picture.
    DetectorHeat {
        /// Side of a cell.
        block: usize,
    },
    /// `(x - mean) / sqrt(variance + eps) * gain + bias` over the channels of each row.
    LayerNorm {
        /// `[channels]`
        gain: WeightId,
        /// `[channels]`
        bias: WeightId,
        /// Added to the variance.
        eps: f32,
    },
    /// Each row divided by `max(norm, eps)`.
    L2Norm {
        /// Smallest divisor.
        eps: f32,
    },
    /// Multi-head attention: `softmax(scale * q k^T) v` per head; head `h` owns the contiguous channel block `h`.
    ///
    /// Inputs: q `[n, heads * d]`, k `[m, heads * d]`, v `[m, heads * e]`, and with `masked` a fourth one `[m, 1]`: a key
    /// takes part where it is > 0. The number of keys is the run-time number of rows of k. No key at all gives zero.
    Attention {
        /// Number of heads.
        heads: usize,
        /// Factor of the scores, normally `1 / sqrt(d)`; 1 when folded into q.
        scale: f32,
        /// Whether there is a fourth input.
        masked: bool,
    },
    /// Attention of one query per element over the element's own tokens, the tokens being keys and values of every head.
    ///
    /// Inputs: u `[n, heads * c]`, tokens `[n * tokens, c]`. Output `[n, heads * c]`: per head the mean of the tokens weighted
    /// by `softmax(scale * u_h . token)`.
    TokenPool {
        /// Number of heads.
        heads: usize,
        /// Tokens per element.
        tokens: usize,
        /// Factor of the scores.
        scale: f32,
    },
    /// Reads a picture at given positions; cells outside count as zero.
    ///
    /// Inputs: picture, positions `[n, 2]` (x, y).
    Sample {
        /// Interpolation.
        filter: Filter,
        /// Horizontal map.
        x: AxisMap,
        /// Vertical map.
        y: AxisMap,
    },
    /// Soft choice among learned anchors: `p = softmax(sharpness * x . key)`.
    ///
    /// Outputs: `sum p value` `[n, v]`, and the statistics `[n, 5]`: best `x . key`, second best, best minus second, entropy
    /// `-sum p ln p`, spread `sqrt(sum p |value - mean|^2)`. With one key the second best equals the best.
    SoftChoice {
        /// `[anchors, channels]`
        keys: WeightId,
        /// `[anchors, v]`
        values: WeightId,
        /// `[1]`
        sharpness: WeightId,
    },
    /// Keeps the rows whose logit is greater than `min_logit`, in their order; makes a new count.
    ///
    /// Inputs: x `[n, c]`, logit `[n, 1]`. Outputs: kept rows `[k, c]`, and `[k, 1]` the row number each had (exact in `f32`).
    Keep {
        /// Strict lower bound.
        min_logit: f32,
    },
}

impl Op {
    /// The weights that it needs, in the order of its fields.
    pub fn weights(&self) -> Vec<WeightId> {
        match self {
            Self::Conv3x3 { weight, bias, .. } | Self::Linear { weight, bias, .. } => {
                core::iter::once(*weight).chain(*bias).collect()
            }
            Self::LayerNorm { gain, bias, .. } => vec![*gain, *bias],
            Self::SoftChoice {
                keys,
                values,
                sharpness,
            } => vec![*keys, *values, *sharpness],
            Self::Activate { .. }
            | Self::Add { .. }
            | Self::Resize
            | Self::AvgPool { .. }
            | Self::MaxPool { .. }
            | Self::InstanceNorm { .. }
            | Self::Unfold { .. }
            | Self::DetectorHeat { .. }
            | Self::L2Norm { .. }
            | Self::Attention { .. }
            | Self::TokenPool { .. }
            | Self::Sample { .. }
            | Self::Keep { .. } => Vec::new(),
        }
    }

    /// Name for messages and listings.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Conv3x3 { .. } => "conv3x3",
            Self::Linear { .. } => "linear",
            Self::Activate { .. } => "activate",
            Self::Add { .. } => "add",
            Self::Resize => "resize",
            Self::AvgPool { .. } => "avg_pool",
            Self::MaxPool { .. } => "max_pool",
            Self::InstanceNorm { .. } => "instance_norm",
            Self::Unfold { .. } => "unfold",
            Self::DetectorHeat { .. } => "detector_heat",
            Self::LayerNorm { .. } => "layer_norm",
            Self::L2Norm { .. } => "l2_norm",
            Self::Attention { .. } => "attention",
            Self::TokenPool { .. } => "token_pool",
            Self::Sample { .. } => "sample",
            Self::SoftChoice { .. } => "soft_choice",
            Self::Keep { .. } => "keep",
        }
    }
}
