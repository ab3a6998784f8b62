//! Forward passes of the branches in burn, from the same configuration that `landline::models` turns into a graph.
//!
//! `Anchored`: soft choice among keys ([`landline::models::AnchoredPointConfig`]). `Attention`: the paper's branches, with
//! its output or with that choice ([`AttentionOutput`]).
//! Dropout sits where the reference has it: in the line encoder only, on the probabilities and after its two outputs.

use super::loss::column;
use super::params::Leaves;
use burn::tensor::{Distribution, Tensor, activation};
use landline::models::{
    AnchoredLineConfig, AnchoredPointConfig, AttentionLineConfig, AttentionOutput,
    AttentionPointConfig,
};

/// Norms below count as zero, as in `landline::models`.
const UNIT_GUARD: f32 = 1e-12;
/// Keeps the root of a zero row differentiable; far below the square of any norm that counts.
const ROOT_GUARD: f32 = 1e-24;
const LAYER_NORM_EPSILON: f32 = 1e-6;
/// Dropout of the reference's line encoder while training.
pub const ENCODER_DROPOUT: f64 = 0.1;

/// What a branch predicts for every row that went in.
pub struct Prediction {
    /// Normalised scene coordinates: `[rows, 3]`, or `[rows, 6]` for start and end.
    pub coordinates: Tensor<2>,
    /// Reliability logits `[rows, 1]`.
    pub logits: Tensor<2>,
    /// Pruning logits where they are not the reliability: of points with attention and an anchored output.
    pub pruning: Option<Tensor<2>>,
}

/// Rows that belong to images of the same number of rows.
pub struct Context {
    /// Images in the batch.
    pub images: usize,
    /// 1 for rows that others may attend to, `[rows, 1]`.
    pub attended: Tensor<2>,
    /// Whether dropout is on.
    pub training: bool,
}

/// Rows divided by their norms.
pub fn unit_rows(x: Tensor<2>) -> Tensor<2> {
    let norm = x.clone().square().sum_dim(1).add_scalar(ROOT_GUARD).sqrt();
    x / norm.clamp_min(UNIT_GUARD)
}

/// The part that both anchored branches share.
fn choose(leaves: &Leaves<'_>, prefix: &str, values: &str, x: Tensor<2>) -> Prediction {
    let anchor = format!("{prefix}.anchor");
    let keys = unit_rows(leaves.get(&format!("{anchor}.keys")));
    let values = leaves.get(&format!("{anchor}.{values}"));
    let similarity = x.clone().matmul(keys.transpose());
    let scores = similarity.clone() * leaves.get(&format!("{anchor}.sharpness"));
    let weights = activation::softmax(scores.clone(), 1);
    let chosen = weights.clone().matmul(values.clone());

    // The statistics are inputs of the two small MLPs only; the choice itself learns from the coordinates.
    let similarity = similarity.inner();
    let (scores, weights) = (scores.inner(), weights.inner());
    let (values, mean) = (values.inner(), chosen.clone().inner());
    let best = similarity.clone().max_dim(1);
    let second = if values.dims()[0] > 1 {
        // Twice a maximum: the library's `topk` sorts whole rows, which took 40 % of a step.
        let is_best = (similarity.clone() - best.clone()).greater_equal_scalar(0.0);
        similarity.mask_fill(is_best, -2.0).max_dim(1)
    } else {
        best.clone()
    };
    // -sum p log p = log(sum exp(score)) - sum p score, with log p = score - max - log(sum exp(score - max)).
    let peak = scores.clone().max_dim(1);
    let peak_weight = weights.clone().max_dim(1);
    let entropy = (peak - peak_weight.log() - (weights.clone() * scores).sum_dim(1)).clamp_min(0.0);
    let mean_square = weights.matmul(values.square().sum_dim(1));
    let spread = (mean_square - mean.square().sum_dim(1))
        .clamp_min(0.0)
        .sqrt();
    let difference = best.clone() - second.clone();
    let statistics = Tensor::cat(vec![best, second, difference, entropy, spread], 1);
    let statistics = if x.is_autodiff() {
        Tensor::from_inner(statistics)
    } else {
        statistics
    };
    let input = Tensor::cat(vec![x, statistics], 1);
    let mlp = |name: &str| {
        let name = format!("{prefix}.{name}");
        let hidden = activation::relu(leaves.linear(&format!("{name}.0"), input.clone()));
        leaves.linear(&format!("{name}.1"), hidden)
    };
    let coordinates = if leaves.has(&format!("{prefix}.offset.0.w")) {
        chosen + mlp("offset")
    } else {
        chosen
    };
    Prediction {
        coordinates,
        logits: mlp("reliability"),
        pruning: None,
    }
}

/// Anchored point branch on unit descriptors `[rows, descriptor]`.
pub fn anchored_points(_: &AnchoredPointConfig, leaves: &Leaves<'_>, x: Tensor<2>) -> Prediction {
    choose(leaves, "point", "positions", x)
}

/// Anchored line branch on tokens `[rows, tokens * descriptor]`.
pub fn anchored_lines(
    config: &AnchoredLineConfig,
    leaves: &Leaves<'_>,
    tokens: Tensor<2>,
) -> Prediction {
    let pooled = if leaves.has("line.pool.w") {
        tokens.matmul(leaves.get("line.pool.w").transpose())
    } else {
        mean_token(tokens, config.tokens, config.descriptor_channels)
    };
    choose(leaves, "line", "segments", unit_rows(pooled))
}

/// `[rows, tokens * channels]` to the mean token `[rows, channels]`.
fn mean_token(x: Tensor<2>, tokens: usize, channels: usize) -> Tensor<2> {
    let rows = x.dims()[0];
    x.reshape([rows, tokens, channels])
        .mean_dim(1)
        .reshape([rows, channels])
}

/// `[images * n, width]` to `[images, heads, n, width / heads]`; heads are contiguous blocks of channels.
fn split_heads(x: Tensor<2>, images: usize, heads: usize) -> Tensor<4> {
    let [rows, width] = x.dims();
    x.reshape([images, rows / images, heads, width / heads])
        .swap_dims(1, 2)
}

/// Self-attention layer: `x + MLP([x ; merge(attention(x))])`.
fn attend(leaves: &Leaves<'_>, name: &str, heads: usize, x: Tensor<2>, c: &Context) -> Tensor<2> {
    let [rows, width] = x.dims();
    let part = |p: &str| {
        split_heads(
            leaves.linear(&format!("{name}.{p}"), x.clone()),
            c.images,
            heads,
        )
    };
    let (q, k, v) = (part("q"), part("k"), part("v"));
    let scale = ((width / heads) as f64).sqrt();
    let closed = (c.attended.clone().neg().add_scalar(1.0)).mul_scalar(-1e9);
    let closed = closed.reshape([c.images, 1, 1, rows / c.images]);
    let scores = q.matmul(k.swap_dims(2, 3)).div_scalar(scale) + closed;
    // Where nothing is attended to, the softmax is flat; nothing is then the message, as in the executors.
    let open = c
        .attended
        .clone()
        .reshape([c.images, 1, 1, rows / c.images]);
    let message = (activation::softmax(scores, 3) * open).matmul(v);
    let message = message.swap_dims(1, 2).reshape([rows, width]);
    let message = leaves.linear(&format!("{name}.o"), message);
    let hidden = leaves.linear(
        &format!("{name}.ffn.0"),
        Tensor::cat(vec![x.clone(), message], 1),
    );
    x + leaves.linear(&format!("{name}.ffn.1"), activation::relu(hidden))
}

/// Linear layers `NAME.0..` with ReLU between them.
fn mlp(leaves: &Leaves<'_>, name: &str, x: Tensor<2>) -> Tensor<2> {
    let mut y = x;
    let mut i = 0;
    loop {
        y = leaves.linear(&format!("{name}.{i}"), y);
        i += 1;
        if !leaves.has(&format!("{name}.{i}.w")) {
            return y;
        }
        y = activation::relu(y);
    }
}

/// The point branch with attention. All rows go through the head; with the paper's output, rows that are not attended to
/// are for the caller to ignore.
pub fn attention_points(
    config: &AttentionPointConfig,
    leaves: &Leaves<'_>,
    descriptors: Tensor<2>,
    context: impl FnOnce(Option<&Tensor<2>>) -> Context,
) -> Prediction {
    let mut x = if leaves.has("point.in.w") {
        leaves.linear("point.in", descriptors.clone())
    } else {
        descriptors.clone()
    };
    let pruning = leaves
        .has("point.prune.0.w")
        .then(|| mlp(leaves, "point.prune", x.clone()));
    let context = context(pruning.as_ref());
    for i in 0..config.num_layers {
        x = attend(
            leaves,
            &format!("point.attn.{i}"),
            config.heads,
            x,
            &context,
        );
    }
    let head = mlp(leaves, "point.head", x.clone());
    match (config.output, pruning) {
        (AttentionOutput::Linear, Some(logits)) => Prediction {
            coordinates: head,
            logits,
            pruning: None,
        },
        (_, pruning) => {
            let query = unit_rows(descriptors + leaves.linear("point.query", x));
            let chosen = choose(leaves, "point", "positions", query);
            Prediction {
                coordinates: chosen.coordinates + head,
                pruning,
                ..chosen
            }
        }
    }
}

fn layer_norm(leaves: &Leaves<'_>, name: &str, x: Tensor<2>) -> Tensor<2> {
    let mean = x.clone().mean_dim(1);
    let centred = x - mean;
    let variance = centred.clone().square().mean_dim(1);
    centred / variance.add_scalar(LAYER_NORM_EPSILON).sqrt() * leaves.get(&format!("{name}.g"))
        + leaves.get(&format!("{name}.b"))
}

fn dropout<const D: usize>(x: Tensor<D>, training: bool) -> Tensor<D> {
    if !training {
        return x;
    }
    let keep = x.random_like(Distribution::Bernoulli(1.0 - ENCODER_DROPOUT));
    x * keep.div_scalar(1.0 - ENCODER_DROPOUT)
}

/// One post-norm transformer layer over the tokens of each segment; the output is that of the first token.
fn encode_lines(
    config: &AttentionLineConfig,
    leaves: &Leaves<'_>,
    tokens: Tensor<2>,
    training: bool,
) -> Tensor<2> {
    let rows = tokens.dims()[0];
    let (t, heads, width) = (config.tokens, config.heads, config.width);
    let flat = tokens.reshape([rows * t, config.descriptor_channels]);
    let x = if leaves.has("line.in.w") {
        leaves.linear("line.in", flat)
    } else {
        flat
    };
    let first = x
        .clone()
        .reshape([rows, t, width])
        .narrow(1, 0, 1)
        .reshape([rows, width]);
    let split = |x: Tensor<2>, n: usize| x.reshape([rows, n, heads, width / heads]).swap_dims(1, 2);
    let q = split(leaves.linear("line.enc.q", first.clone()), 1);
    let k = split(leaves.linear("line.enc.k", x.clone()), t);
    let v = split(leaves.linear("line.enc.v", x), t);
    let scale = ((width / heads) as f64).sqrt();
    let weights = activation::softmax(q.matmul(k.swap_dims(2, 3)).div_scalar(scale), 3);
    let message = dropout(weights, training).matmul(v);
    let message = message.swap_dims(1, 2).reshape([rows, width]);
    let message = dropout(leaves.linear("line.enc.o", message), training);
    let y = layer_norm(leaves, "line.enc.ln1", first + message);
    let hidden = activation::gelu(leaves.linear("line.enc.ff1", y.clone()));
    let out = dropout(leaves.linear("line.enc.ff2", hidden), training);
    layer_norm(leaves, "line.enc.ln2", y + out)
}

/// The paper's line branch on tokens `[rows, tokens * descriptor]`: encoder, attention among all, pruning, head.
pub fn attention_lines(
    config: &AttentionLineConfig,
    leaves: &Leaves<'_>,
    tokens: Tensor<2>,
    context: &Context,
) -> Prediction {
    let pooled = unit_rows(mean_token(
        tokens.clone(),
        config.tokens,
        config.descriptor_channels,
    ));
    let mut x = encode_lines(config, leaves, tokens, context.training);
    for i in 0..config.num_layers {
        x = attend(leaves, &format!("line.attn.{i}"), config.heads, x, context);
    }
    let head = mlp(leaves, "line.head", x.clone());
    match config.output {
        AttentionOutput::Linear => Prediction {
            logits: mlp(leaves, "line.prune", x),
            coordinates: head,
            pruning: None,
        },
        AttentionOutput::Anchored { .. } => {
            let query = unit_rows(pooled + leaves.linear("line.query", x));
            let chosen = choose(leaves, "line", "segments", query);
            Prediction {
                coordinates: chosen.coordinates + head,
                ..chosen
            }
        }
    }
}

/// 1 for every row.
pub fn all_rows(rows: usize, device: &burn::tensor::Device) -> Tensor<2> {
    column(&vec![1.0; rows], device)
}
