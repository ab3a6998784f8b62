//! Branches that choose among landmarks before any training: at the start such a branch is its landmarks, and that is a scene
//! already.

use super::config::{LineBranchConfig, PointBranchConfig, Preset, RegressorConfig, TensorSpec};
use super::error::ModelError;
use crate::math::Rng;
use crate::nn::{CHOICE_STATISTICS, WeightTensor, Weights};

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

/// Start value of a tensor of an anchored branch.
///
/// With fewer anchors than the configuration says the tensor is too short; the caller shrinks the configuration first.
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
pub fn linear_start(spec: &TensorSpec, fan_in: usize, rng: &mut Rng) -> Vec<f32> {
    let count: usize = spec.shape.iter().product();
    let bound = 1.0 / (fan_in as f64).sqrt();
    (0..count)
        .map(|_| rng.range(-bound, bound) as f32)
        .collect()
}

/// Numbers in the value of a point's anchor.
const POINT_VALUE: usize = 3;
/// Numbers in the value of a segment's anchor: start and end.
const SEGMENT_VALUE: usize = 6;

/// A whole regressor of preset `compact` that nobody trained, for descriptors of `descriptor_channels`, and its tensors. Without
/// segments it has no line branch. The same anchors give the same tensors.
///
/// # Errors
/// [`ModelError::Size`] without points, [`ModelError::Mismatch`] for an anchor of another length.
pub fn untrained(
    descriptor_channels: usize,
    points: &[Anchor],
    segments: &[Anchor],
) -> Result<(RegressorConfig, Weights), ModelError> {
    let RegressorConfig::Branches { mut point, line } =
        RegressorConfig::preset(Preset::Compact, descriptor_channels)
    else {
        unreachable!("all presets have two branches");
    };
    let mut weights = Weights::new();
    if let PointBranchConfig::Anchored(c) = &mut point {
        c.num_anchors = points.len();
        check(points, c.descriptor_channels, POINT_VALUE)?;
    }
    point.validate()?;
    fill(&mut weights, &point.tensors(), points)?;
    let mut line = line.filter(|_| !segments.is_empty());
    if let Some(line) = &mut line {
        if let LineBranchConfig::Anchored(c) = line {
            c.num_anchors = segments.len();
            check(segments, c.key_channels, SEGMENT_VALUE)?;
        }
        line.validate()?;
        fill(&mut weights, &line.tensors(), segments)?;
    }
    Ok((RegressorConfig::Branches { point, line }, weights))
}

fn check(anchors: &[Anchor], key: usize, value: usize) -> Result<(), ModelError> {
    match anchors
        .iter()
        .find(|a| a.key.len() != key || a.value.len() != value)
    {
        None => Ok(()),
        Some(odd) => Err(ModelError::Mismatch(format!(
            "a landmark has a key of {} numbers and a value of {}; {key} and {value} are expected",
            odd.key.len(),
            odd.value.len()
        ))),
    }
}

fn fill(weights: &mut Weights, specs: &[TensorSpec], anchors: &[Anchor]) -> Result<(), ModelError> {
    let mut rng = Rng::from_seed(0);
    for spec in specs {
        let values = anchored_start(spec, fan_in(spec, specs), anchors, &mut rng);
        weights.insert(spec.name.clone(), WeightTensor::f32(&spec.shape, values)?);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::ports;
    use crate::nn::{Executor as _, cpu::CpuExecutor};

    fn anchors(key: usize, value: usize) -> Vec<Anchor> {
        (0..3)
            .map(|i| Anchor {
                key: (0..key).map(|k| f32::from(u8::from(k == i))).collect(),
                value: (0..value).map(|v| (10 * i + v) as f32).collect(),
            })
            .collect()
    }

    #[test]
    fn a_keypoint_that_looks_like_a_landmark_is_where_the_landmark_is() {
        let points = anchors(64, 3);
        let (config, mut weights) = untrained(64, &points, &[]).expect("fits");
        config.check_weights(&weights).expect("all tensors");
        let RegressorConfig::Branches { point, line } = config else {
            panic!("branches");
        };
        assert!(line.is_none());
        let made = point.prepare(&mut weights).expect("prepares");
        let mut run = CpuExecutor::new(point.graph(3).expect("builds"), made).expect("fits");
        run.set_count(ports::POINTS, 3).expect("in capacity");
        let keys: Vec<f32> = points.iter().flat_map(|a| a.key.clone()).collect();
        run.input(ports::DESCRIPTORS)
            .expect("an input")
            .copy_from_slice(&keys);
        run.run().expect("runs");
        let expected: Vec<f32> = points.iter().flat_map(|a| a.value.clone()).collect();
        let found = run.output(ports::COORDINATES).expect("an output");
        for (f, e) in found.iter().zip(&expected) {
            assert!((f - e).abs() < 1e-4, "{found:?}");
        }
        // What fits one landmark and no other is reliable.
        let logits = run.output(ports::LOGITS).expect("an output");
        assert!(logits.iter().all(|l| *l > 1.0), "{logits:?}");
    }

    #[test]
    fn landmarks_of_both_kinds_fill_every_tensor() {
        let (config, weights) = untrained(64, &anchors(64, 3), &anchors(64, 6)).expect("fits");
        config.check_weights(&weights).expect("all tensors");
        let again = untrained(64, &anchors(64, 3), &anchors(64, 6)).expect("fits");
        assert_eq!(again.0, config);
    }

    #[test]
    fn no_landmark_and_misshapen_ones_are_refused() {
        assert!(matches!(
            untrained(64, &[], &[]),
            Err(ModelError::Size {
                field: "num_anchors",
                ..
            })
        ));
        for (points, segments) in [
            (anchors(63, 3), anchors(64, 6)),
            (anchors(64, 2), Vec::new()),
            (anchors(64, 3), anchors(64, 3)),
        ] {
            let refused = untrained(64, &points, &segments);
            assert!(matches!(refused, Err(ModelError::Mismatch(_))));
        }
    }
}
