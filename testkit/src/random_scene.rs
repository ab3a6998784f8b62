//! Scenes whose networks have random weights: they place nothing, but what one backend says of them another must say too.

use landline::image::GrayImage;
use landline::math::Rng;
use landline::models::{ExtractorKind, RegressorConfig, TensorSpec};
use landline::nn::{WeightTensor, Weights};
use landline::scene_file::{ExtractorFile, SceneFile, SceneInfo};

/// Random weights, scaled by the number of inputs so that activations neither vanish nor grow. Sharpness values are 20.
///
/// # Panics
///
/// Never: the lengths are those of the shapes.
#[must_use]
pub fn scaled_weights(specs: &[TensorSpec], rng: &mut Rng) -> Weights {
    let of_spec = |spec: &TensorSpec| {
        let fan_in: usize = spec.shape.iter().skip(1).product();
        let bound = (6.0 / fan_in as f64).sqrt().min(1.0);
        let len = spec.shape.iter().product();
        let data = if spec.name.ends_with("sharpness") {
            vec![20.0]
        } else {
            (0..len).map(|_| rng.range(-bound, bound) as f32).collect()
        };
        let tensor = WeightTensor::f32(&spec.shape, data).expect("lengths agree");
        (spec.name.clone(), tensor)
    };
    specs.iter().map(of_spec).collect()
}

/// A scene of this configuration and the extractor that belongs to it.
#[must_use]
pub fn random_scene(kind: ExtractorKind, config: RegressorConfig) -> (SceneFile, ExtractorFile) {
    let mut rng = Rng::from_seed(21);
    let sha256 = "ab".repeat(32);
    let scene = SceneFile {
        info: SceneInfo::new(kind, sha256.clone()),
        weights: scaled_weights(&config.tensors(), &mut rng),
        landmarks: None,
        config,
    };
    let extractor = ExtractorFile {
        kind,
        source_sha256: sha256,
        source: "random".to_owned(),
        licence: "none".to_owned(),
        weights: scaled_weights(&kind.tensors(), &mut rng),
    };
    (scene, extractor)
}

/// A picture with structure at several scales.
#[must_use]
pub fn random_picture(width: usize, height: usize, rng: &mut Rng) -> GrayImage {
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let wave =
                (0.31 * x as f64).sin() * (0.17 * y as f64).cos() + (0.05 * (x * y) as f64).sin();
            data.push((128.0 + 40.0 * wave + rng.range(-30.0, 30.0)).clamp(0.0, 255.0) as u8);
        }
    }
    GrayImage {
        data,
        width,
        height,
    }
}
