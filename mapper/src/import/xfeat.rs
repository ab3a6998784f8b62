//! XFeat's published weights.

use super::checkpoint::Checkpoint;
use super::{Converter, ImportError, fold_norm};
use landline::models::ExtractorKind;
use landline::nn::Weights;

/// Batch norms of the reference.
const EPS: f64 = 1e-5;

/// Folds the batch norms, which stand before the activations.
pub(super) fn convert(checkpoint: Checkpoint) -> Result<Weights, ImportError> {
    let mut c = Converter::new("XFeat", checkpoint);
    let groups = [
        ("block1", "block1"),
        ("block2", "block2"),
        ("block3", "block3"),
        ("block4", "block4"),
        ("block5", "block5"),
        ("block_fusion", "fusion"),
        ("heatmap_head", "reliability"),
        ("keypoint_head", "keypoint"),
    ];
    for spec in ExtractorKind::Xfeat.tensors() {
        let Some(name) = spec.name.strip_suffix(".w") else {
            continue;
        };
        let shape = spec.shape;
        let (out, bias_name) = (shape[0], format!("{name}.b"));
        if name == "skip" {
            let w = c.take_shaped("skip1.1.weight", &shape)?;
            let b = c.take_shaped("skip1.1.bias", &[out])?;
            c.put("skip.w".to_owned(), &shape, w)?;
            c.put(bias_name, &[out], b)?;
            continue;
        }
        let (group, index) = name.split_once('.').unwrap_or((name, ""));
        let foreign = groups
            .iter()
            .find(|(_, ours)| *ours == group)
            .map_or(group, |(theirs, _)| theirs);
        let foreign = format!("{foreign}.{index}");
        // "Basic" layers are convolution, norm, activation; the last layer of a head is a plain convolution with bias.
        let plain = c.tensors.contains_key(&format!("{foreign}.weight"));
        let (w, b) = if plain {
            (
                c.take_shaped(&format!("{foreign}.weight"), &shape)?,
                c.take_shaped(&format!("{foreign}.bias"), &[out])?,
            )
        } else {
            let w = c.take_shaped(&format!("{foreign}.layer.0.weight"), &shape)?;
            let (gain, shift) = c.batch_norm(&format!("{foreign}.layer.1"), out, EPS, false)?;
            fold_norm(&w, None, &gain, &shift)
        };
        c.put(format!("{name}.w"), &shape, w)?;
        c.put(bias_name, &[out], b)?;
    }
    // The refinement of matches, a network of its own that is not used here.
    c.finish(&["fine_matcher."])
}
