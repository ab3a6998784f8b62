//! Start values: landmarks for the anchored branches, the reference's distributions for the attention branches.

use landline::geometry::SceneScale;
use landline::math::Rng;
use landline::models::TensorSpec;
use landline::nn::CHOICE_STATISTICS;
use landline::reconstruction::{Observation, Reconstruction, cover};
use nalgebra::Vector3;
use std::ops::Range;

/// Sharpness of the choice at the start. Measured on RedKitchen with 2,048 untrained landmarks and a ranking by margin:
/// 80 gives 1.38 cm, 150 1.10 cm, 300 0.97 cm, 1,000 1.00 cm.
pub const START_SHARPNESS: f32 = 300.0;

/// Position of "best minus second best" among the statistics of a choice.
const MARGIN_STATISTIC: usize = 2;
/// Logit of the reliability at the start: this times the margin plus the bias.
const START_MARGIN_FACTOR: f32 = 20.0;
const START_RELIABILITY_BIAS: f32 = -2.0;

/// A landmark that becomes an anchor.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    /// Unit descriptor.
    pub key: Vec<f32>,
    /// Normalised coordinates, 3 or 6.
    pub value: Vec<f32>,
}

/// Observations in pictures that are not held out: landmarks must not know those.
fn kept(observations: &[Observation], held: &Range<usize>) -> Vec<Observation> {
    let seen = observations.iter().copied();
    seen.filter(|o| !held.contains(&(o.view as usize)))
        .collect()
}

/// Unit mean of the rows that `row` finds for the observations, each row possibly of several descriptors.
fn mean_key<'a>(
    observations: &[Observation],
    len: usize,
    row: impl Fn(&Observation) -> Option<&'a [f32]>,
) -> Vec<f32> {
    let mut key = vec![0.0f32; len];
    for descriptor in observations
        .iter()
        .filter_map(&row)
        .flat_map(|r| r.chunks_exact(len))
    {
        for (k, d) in key.iter_mut().zip(descriptor) {
            *k += d;
        }
    }
    let norm = key.iter().map(|k| k * k).sum::<f32>().sqrt().max(1e-12);
    key.iter_mut().for_each(|k| *k /= norm);
    key
}

/// Point landmarks: mean descriptors and positions, of tracks outside the held-out pictures.
pub fn point_anchors(
    map: &Reconstruction,
    held: &Range<usize>,
    scale: &SceneScale,
    count: usize,
) -> Vec<Anchor> {
    let observations: Vec<Vec<Observation>> = map
        .points
        .iter()
        .map(|p| kept(&p.observations, held))
        .collect();
    let slices: Vec<&[Observation]> = observations.iter().map(Vec::as_slice).collect();
    let error = |t: usize| map.points[t].mean_error_px;
    cover(&slices, error, map.views.len(), count)
        .into_iter()
        .map(|t| Anchor {
            key: mean_key(&observations[t], map.descriptor_channels(), |o| {
                let view = map.views.get(o.view as usize)?;
                view.features.descriptor(o.feature as usize)
            }),
            value: normalised(map.points[t].point_in_world, scale).to_vec(),
        })
        .collect()
}

/// Segment landmarks, turned so that most observations agree with the order of the ends.
pub fn line_anchors(
    map: &Reconstruction,
    held: &Range<usize>,
    scale: &SceneScale,
    count: usize,
) -> Vec<Anchor> {
    let observations: Vec<Vec<Observation>> = map
        .lines
        .iter()
        .map(|l| kept(&l.observations, held))
        .collect();
    let slices: Vec<&[Observation]> = observations.iter().map(Vec::as_slice).collect();
    let error = |t: usize| map.lines[t].mean_error_px;
    cover(&slices, error, map.views.len(), count)
        .into_iter()
        .map(|t| {
            let track = &map.lines[t];
            let is_reversed = |o: &&Observation| map.is_reversed(track, **o);
            let reversed = observations[t].iter().filter(is_reversed).count();
            let mut ends = [track.start_in_world, track.end_in_world];
            if 2 * reversed > observations[t].len() {
                ends.swap(0, 1);
            }
            Anchor {
                key: mean_key(&observations[t], map.descriptor_channels(), |o| {
                    let view = map.views.get(o.view as usize)?;
                    view.features.segment_descriptors(o.feature as usize)
                }),
                value: ends.iter().flat_map(|e| normalised(*e, scale)).collect(),
            }
        })
        .collect()
}

/// Anchors that know nothing of the scene: the start without landmarks, to measure what they are worth.
pub fn random_anchors(
    count: usize,
    key_len: usize,
    value_len: usize,
    rng: &mut Rng,
) -> Vec<Anchor> {
    (0..count)
        .map(|_| Anchor {
            key: (0..key_len).map(|_| rng.normal() as f32).collect(),
            value: (0..value_len).map(|_| rng.normal() as f32).collect(),
        })
        .collect()
}

fn normalised(p: Vector3<f64>, scale: &SceneScale) -> [f32; 3] {
    let n = scale.network_from_world(p);
    [n.x as f32, n.y as f32, n.z as f32]
}

/// Start value of a tensor of an anchored branch.
///
/// # Panics
/// When there are fewer anchors than the configuration says; the caller shrinks the configuration first.
pub fn anchored_start(
    spec: &TensorSpec,
    fan_in: usize,
    anchors: &[Anchor],
    rng: &mut Rng,
) -> Vec<f32> {
    let name = spec.name.as_str();
    if name.ends_with("anchor.keys") {
        return anchors.iter().flat_map(|a| a.key.iter().copied()).collect();
    }
    if name.ends_with("anchor.positions") || name.ends_with("anchor.segments") {
        return anchors
            .iter()
            .flat_map(|a| a.value.iter().copied())
            .collect();
    }
    if name.ends_with("anchor.sharpness") {
        return vec![START_SHARPNESS];
    }
    if name.ends_with("pool.w") {
        // The mean of the tokens.
        let [out, input] = [spec.shape[0], spec.shape[1]];
        let mut w = vec![0.0; out * input];
        let tokens = input / out;
        for (channel, row) in w.chunks_exact_mut(input).enumerate() {
            for token in row.chunks_exact_mut(out) {
                token[channel] = 1.0 / tokens as f32;
            }
        }
        return w;
    }
    let mut w = linear_start(spec, fan_in, rng);
    // The offset begins at zero: at the start the branch is the landmarks.
    if name.contains(".offset.1.") {
        w.fill(0.0);
    }
    if name.contains(".reliability.") {
        start_reliability(spec, &mut w);
    }
    w
}

/// The reliability begins as a ranking by the margin between the best and the second best landmark: its first hidden number
/// is that margin, and the others have no say yet.
fn start_reliability(spec: &TensorSpec, w: &mut [f32]) {
    let columns = spec.shape.last().copied().unwrap_or(0);
    if spec.name.ends_with(".0.w") {
        let margin = columns - CHOICE_STATISTICS + MARGIN_STATISTIC;
        for (column, v) in w.iter_mut().take(columns).enumerate() {
            *v = if column == margin { 1.0 } else { 0.0 };
        }
    } else if spec.name.ends_with(".0.b") {
        w[0] = 0.0;
    } else if spec.name.ends_with(".1.w") {
        w.fill(0.0);
        w[0] = START_MARGIN_FACTOR;
    } else {
        w.fill(START_RELIABILITY_BIAS);
    }
}

/// Inputs of the linear layer that a tensor belongs to: for a bias those of the matrix beside it.
pub fn fan_in(spec: &TensorSpec, all: &[TensorSpec]) -> usize {
    let matrix = match spec.name.strip_suffix(".b") {
        Some(layer) => all
            .iter()
            .find(|s| s.name.strip_suffix(".w") == Some(layer)),
        None => Some(spec),
    };
    matrix.and_then(|s| s.shape.get(1).copied()).unwrap_or(1)
}

/// Uniform in plus or minus the inverse root of the inputs, as torch's linear layers.
fn linear_start(spec: &TensorSpec, fan_in: usize, rng: &mut Rng) -> Vec<f32> {
    let count: usize = spec.shape.iter().product();
    let bound = 1.0 / (fan_in as f64).sqrt();
    (0..count)
        .map(|_| rng.range(-bound, bound) as f32)
        .collect()
}

/// How an attention branch starts.
pub struct AttentionStart<'a> {
    /// All tensors of the branch.
    pub specs: &'a [TensorSpec],
    /// Of everything random.
    pub seed: u64,
    /// The last layer of each attention MLP starts at zero, so that the network begins as a pointwise one and stands high
    /// rates.
    pub residual_zero: bool,
    /// Landmarks of an anchored output. Its shift and its offset start at zero: the branch begins as the landmarks.
    pub anchors: Option<&'a [Anchor]>,
}

/// Start value of a tensor of an attention branch. The reference lets query, key, value and merge of a layer start as
/// copies of one another.
pub fn attention_start(spec: &TensorSpec, fan_in: usize, start: &AttentionStart<'_>) -> Vec<f32> {
    let name = spec.name.as_str();
    let count: usize = spec.shape.iter().product();
    if name.contains(".ln1.") || name.contains(".ln2.") {
        return vec![if name.ends_with(".g") { 1.0 } else { 0.0 }; count];
    }
    if let Some(anchors) = start.anchors {
        if name.contains(".anchor.") || name.contains(".reliability.") {
            let mut rng = Rng::from_seed(start.seed ^ fingerprint(name));
            return anchored_start(spec, fan_in, anchors, &mut rng);
        }
        if name.contains(".query.") || is_last_of_head(name, start.specs) {
            return vec![0.0; count];
        }
    }
    let is_last = name.contains(".attn.") && name.contains(".ffn.1.");
    if is_last && (start.residual_zero || name.ends_with(".b")) {
        return vec![0.0; count];
    }
    // One seed for each tensor, so that the order of the list does not matter; shared by q, k, v, o of a layer.
    let mut key = name.to_owned();
    if name.contains(".attn.") {
        for part in [".k.", ".v.", ".o."] {
            key = key.replace(part, ".q.");
        }
    }
    let mut rng = Rng::from_seed(start.seed ^ fingerprint(&key));
    linear_start(spec, fan_in, &mut rng)
}

/// Whether a tensor belongs to the layer of its head that no other follows.
fn is_last_of_head(name: &str, specs: &[TensorSpec]) -> bool {
    let Some((prefix, layer)) = name.split_once(".head.") else {
        return false;
    };
    let layer = layer
        .split('.')
        .next()
        .and_then(|l| l.parse::<usize>().ok());
    layer.is_some_and(|layer| {
        let next = format!("{prefix}.head.{}.w", layer + 1);
        specs.iter().all(|s| s.name != next)
    })
}

fn fingerprint(text: &str) -> u64 {
    text.bytes().fold(0xCBF2_9CE4_8422_2325, |h, b| {
        (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01B3)
    })
}
