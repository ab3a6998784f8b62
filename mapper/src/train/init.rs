//! Start values: landmarks for the anchored branches, the reference's distributions for the attention branches.

use super::buffer::SceneFrame;
use crate::labels::{Labels, Observation};
use landline::math::Rng;
use landline::models::TensorSpec;
use nalgebra::Vector3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Sharpness of the choice at the start. Measured on RedKitchen with 2,048 untrained landmarks and a ranking by margin:
/// 80 gives 1.38 cm, 150 1.10 cm, 300 0.97 cm, 1,000 1.00 cm.
pub const START_SHARPNESS: f32 = 300.0;

/// A landmark that becomes an anchor.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    /// Unit descriptor.
    pub key: Vec<f32>,
    /// Normalised coordinates, 3 or 6.
    pub value: Vec<f32>,
}

/// Picks `count` tracks one after the other, each time the one that helps the images with the fewest picks most: an image
/// counts `1 / (1 + picks so far)`. Tracks of the longest length alone leave some views with hardly any landmark.
pub fn choose_tracks(
    observations: &[&[Observation]],
    num_images: usize,
    count: usize,
) -> Vec<usize> {
    let mut picks = vec![0u32; num_images];
    let gain = |track: usize, picks: &[u32]| -> u64 {
        let sum: f64 = observations[track]
            .iter()
            .map(|o| 1.0 / (1.0 + f64::from(picks[o.image as usize])))
            .sum();
        (sum * 1e9) as u64 // an integer orders totally
    };
    let mut queue: BinaryHeap<(u64, Reverse<usize>)> = (0..observations.len())
        .map(|t| (gain(t, &picks), Reverse(t)))
        .collect();
    let mut chosen = Vec::with_capacity(count);
    while chosen.len() < count {
        let Some((_, Reverse(track))) = queue.pop() else {
            break;
        };
        // Gains only fall, so a candidate whose fresh gain still leads is the best one.
        let fresh = gain(track, &picks);
        if queue.peek().is_some_and(|(next, _)| fresh < *next) {
            queue.push((fresh, Reverse(track)));
            continue;
        }
        for o in observations[track] {
            picks[o.image as usize] += 1;
        }
        chosen.push(track);
    }
    chosen
}

/// Point landmarks: mean descriptors and positions.
pub fn point_anchors(labels: &Labels, frame: &SceneFrame, count: usize) -> Vec<Anchor> {
    let observations: Vec<&[Observation]> = labels
        .points
        .iter()
        .map(|p| p.observations.as_slice())
        .collect();
    choose_tracks(&observations, labels.images.len(), count)
        .into_iter()
        .map(|t| {
            let track = &labels.points[t];
            Anchor {
                key: track.descriptor.clone(),
                value: normalised(&track.point_in_world, frame).to_vec(),
            }
        })
        .collect()
}

/// Segment landmarks, turned so that most observations agree with the order of the ends.
pub fn line_anchors(labels: &Labels, frame: &SceneFrame, count: usize) -> Vec<Anchor> {
    let observations: Vec<&[Observation]> = labels
        .lines
        .iter()
        .map(|l| l.observations.as_slice())
        .collect();
    choose_tracks(&observations, labels.images.len(), count)
        .into_iter()
        .map(|t| {
            let track = &labels.lines[t];
            let reversed = track
                .observations
                .iter()
                .filter(|o| {
                    let target = labels
                        .images
                        .get(o.image as usize)
                        .and_then(|i| i.segment_targets.get(o.feature as usize).copied().flatten());
                    target.is_some_and(|s| s.reversed)
                })
                .count();
            let mut ends = [track.start_in_world, track.end_in_world];
            if 2 * reversed > track.observations.len() {
                ends.swap(0, 1);
            }
            Anchor {
                key: track.descriptor.clone(),
                value: ends.iter().flat_map(|e| normalised(e, frame)).collect(),
            }
        })
        .collect()
}

fn normalised(p: &Vector3<f64>, frame: &SceneFrame) -> [f32; 3] {
    let n = (p - frame.centre()) / frame.scale;
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
    w
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

/// Start value of a tensor of an attention branch. The reference lets query, key, value and merge of a layer start as
/// copies of one another; with `residual_zero` the last layer of each attention MLP starts at zero, so that the network
/// begins as a pointwise one and stands high rates.
pub fn attention_start(
    spec: &TensorSpec,
    fan_in: usize,
    seed: u64,
    residual_zero: bool,
) -> Vec<f32> {
    let name = spec.name.as_str();
    let count: usize = spec.shape.iter().product();
    if name.contains(".ln1.") || name.contains(".ln2.") {
        return vec![if name.ends_with(".g") { 1.0 } else { 0.0 }; count];
    }
    let is_last = name.contains(".attn.") && name.contains(".ffn.1.");
    if is_last && (residual_zero || name.ends_with(".b")) {
        return vec![0.0; count];
    }
    // One seed for each tensor, so that the order of the list does not matter; shared by q, k, v, o of a layer.
    let mut key = name.to_owned();
    if name.contains(".attn.") {
        for part in [".k.", ".v.", ".o."] {
            key = key.replace(part, ".q.");
        }
    }
    let mut rng = Rng::from_seed(seed ^ fingerprint(&key));
    linear_start(spec, fan_in, &mut rng)
}

fn fingerprint(text: &str) -> u64 {
    text.bytes().fold(0xCBF2_9CE4_8422_2325, |h, b| {
        (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01B3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_are_chosen_for_the_images_that_have_few() {
        let track = |images: &[u32]| -> Vec<Observation> {
            images
                .iter()
                .map(|i| Observation {
                    image: *i,
                    feature: 0,
                })
                .collect()
        };
        // Three long tracks see images 0 to 2 only; one short track sees image 3.
        let tracks = [
            track(&[0, 1, 2]),
            track(&[0, 1, 2]),
            track(&[0, 1, 2]),
            track(&[3, 2]),
        ];
        let slices: Vec<&[Observation]> = tracks.iter().map(Vec::as_slice).collect();
        assert_eq!(choose_tracks(&slices, 4, 2), [0, 3]);
        assert_eq!(choose_tracks(&slices, 4, 9).len(), 4);
    }
}
