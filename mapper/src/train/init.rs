//! Start values: noise in place of landmarks, the reference's distributions for the attention branches. Those of branches that
//! begin as their landmarks are in [`landline::models::landmarks`].

use landline::math::Rng;
use landline::models::TensorSpec;
use landline::models::landmarks::{Anchor, anchored_start, linear_start};

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
