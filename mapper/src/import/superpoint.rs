//! SuperPoint: the first release and the open re-training with batch norm.

use super::checkpoint::Checkpoint;
use super::{Converter, ImportError, fold_norm};
use landline::models::ExtractorKind;
use landline::nn::Weights;

/// Batch norms of the open re-training.
const EPS: f64 = 1e-3;

/// The first release: a renaming.
pub(super) fn convert_v1(checkpoint: Checkpoint) -> Result<Weights, ImportError> {
    let names = [
        ("conv1a", "encoder.0"),
        ("conv1b", "encoder.1"),
        ("conv2a", "encoder.2"),
        ("conv2b", "encoder.3"),
        ("conv3a", "encoder.4"),
        ("conv3b", "encoder.5"),
        ("conv4a", "encoder.6"),
        ("conv4b", "encoder.7"),
        ("convPa", "detector.0"),
        ("convPb", "detector.1"),
        ("convDa", "descriptor.0"),
        ("convDb", "descriptor.1"),
    ];
    let mut c = Converter::new("SuperPoint", checkpoint);
    for spec in ExtractorKind::SuperPointV1.tensors() {
        let found = names.iter().find_map(|(theirs, ours)| {
            let part = spec.name.strip_prefix(ours)?.strip_prefix('.')?;
            let part = if part == "w" { "weight" } else { "bias" };
            Some(format!("{theirs}.{part}"))
        });
        let foreign = found.unwrap_or_else(|| spec.name.clone());
        let data = c.take_shaped(&foreign, &spec.shape)?;
        c.put(spec.name, &spec.shape, data)?;
    }
    c.finish(&[])
}

/// The open re-training. Its batch norms stand after the activations and stay as channel-wise layers, but for the last layer
/// of each head, which has no activation and takes its norm in.
///
/// A first layer with several equal input channels (a colour or two-band variant) is summed over them.
pub(super) fn convert_open(checkpoint: Checkpoint) -> Result<Weights, ImportError> {
    let mut c = Converter::new("SuperPoint (open)", checkpoint);
    for spec in ExtractorKind::SuperPointOpen.tensors() {
        let Some(name) = spec
            .name
            .strip_suffix(".w")
            .filter(|n| !n.ends_with(".post"))
        else {
            continue;
        };
        let shape = spec.shape;
        let out = shape[0];
        let foreign = match name.split_once('.') {
            Some(("encoder", i)) => {
                let i: usize = i.parse().unwrap_or(0);
                format!("backbone.{}.{}", i / 2, i % 2)
            }
            _ => name.to_owned(),
        };
        let weight_name = format!("{foreign}.conv.weight");
        if name == "encoder.0" {
            sum_input_channels(&mut c, &weight_name);
        }
        let w = c.take_shaped(&weight_name, &shape)?;
        let b = c.take_shaped(&format!("{foreign}.conv.bias"), &[out])?;
        let (gain, shift) = c.batch_norm(&format!("{foreign}.bn"), out, EPS, true)?;
        if name.ends_with(".1") && !name.starts_with("encoder") {
            let (w, b) = fold_norm(&w, Some(&b), &gain, &shift);
            c.put(format!("{name}.w"), &shape, w)?;
            c.put(format!("{name}.b"), &[out], b)?;
        } else {
            c.put(format!("{name}.w"), &shape, w)?;
            c.put(format!("{name}.b"), &[out], b)?;
            let narrow = |v: &[f64]| v.iter().map(|x| *x as f32).collect();
            c.put(format!("{name}.post.w"), &[out, 1], narrow(&gain))?;
            c.put(format!("{name}.post.b"), &[out], narrow(&shift))?;
        }
    }
    c.finish(&[])
}

/// A grey picture in every input channel is the sum of the channels' kernels on one.
fn sum_input_channels(c: &mut Converter, name: &str) {
    if let Some(tensor) = c.tensors.get_mut(name)
        && let &[out, input, 3, 3] = tensor.shape.as_slice()
        && input > 1
    {
        let summed = tensor
            .data
            .chunks_exact(9 * input)
            .flat_map(|kernel| (0..9).map(|i| kernel.iter().skip(i).step_by(9).sum::<f32>()))
            .collect();
        tensor.data = summed;
        tensor.shape = vec![out, 1, 3, 3];
    }
}
