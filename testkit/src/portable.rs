//! One number over everything that must come out in the same bits natively and as wasm: elementary functions, the line
//! segment detector, the pose solver, the networks on the portable kernels with selection, sampling and decoding, and a film's
//! way to a scene.
//!
//! `tests/native` writes it down, `tests/wasm_node` computes it again and compares. A difference means that an operation
//! was used whose last digit depends on the machine. The inputs are made here from a seed with plain arithmetic.

use crate::nn_cases::{CPU_KINDS, NN_KINDS, nn_case};
use landline::features::{Extractor, ExtractorOptions, FeatureSet};
use landline::geometry::{CamFromWorld, Camera, Pixel, SceneScale};
use landline::image::GrayView;
use landline::lsd::{LsdParams, LsdScratch, detect};
use landline::math::{Rng, elementary};
use landline::models::{
    ExtractorKind, LineBranchConfig, PointBranchConfig, Preset, RegressorConfig, TensorSpec,
    V1Config,
};
use landline::nn::cpu::{CpuExecutor, Level};
use landline::nn::{WeightTensor, Weights};
use landline::pose::{LineCorrespondence, PointCorrespondence, PoseOptions, PoseScratch, estimate};
use landline::regress::{Predictions, Regressor};
use nalgebra::Vector3;
use std::fmt::Write as _;

/// One line per part: its name, how many numbers went into it, and their digest.
///
/// # Panics
///
/// When a part does not give a result at all: then there is nothing to compare.
#[must_use]
pub fn digest() -> String {
    let mut text = String::new();
    for (name, numbers) in [
        ("elementary", elementary_functions()),
        ("segments", segments()),
        ("pose", pose()),
        ("operations", operations()),
        ("networks", networks()),
    ]
    .into_iter()
    .chain(crate::portable_film::film())
    {
        assert!(!numbers.is_empty(), "{name} gave no result");
        let mut hash = Fnv::default();
        for number in &numbers {
            hash.update(&number.to_bits().to_le_bytes());
        }
        // Writing to a string cannot fail.
        let _ = write!(text, "{name} {} {:016x}; ", numbers.len(), hash.0);
    }
    text
}

/// FNV-1a, 64 bits: tiny, and good enough to tell two lists of numbers apart.
struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    fn update(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

fn elementary_functions() -> Vec<f64> {
    let mut rng = Rng::from_seed(1);
    let mut numbers = Vec::new();
    for _ in 0..2000 {
        let x = rng.range(-20.0, 20.0);
        let unit = rng.range(-1.0, 1.0);
        let positive = rng.range(1e-6, 1e6);
        numbers.extend([
            elementary::sin(x),
            elementary::cos(x),
            elementary::tan(x),
            elementary::acos(unit),
            elementary::atan(x),
            elementary::atan2(x, unit),
            elementary::exp(x),
            elementary::ln(positive),
            elementary::ln_1p(positive),
            elementary::cbrt(x),
            elementary::hypot(x, unit),
        ]);
    }
    numbers
}

/// Overlapping tilted rectangles with a little noise.
fn segments() -> Vec<f64> {
    let (width, height) = (320_usize, 240_usize);
    let levels = rectangles(width, height);
    let mut scratch = LsdScratch::default();
    let view = GrayView::tight(&levels, width, height);
    let found = detect(&view, &LsdParams::default(), &mut scratch);
    found
        .unwrap_or_default()
        .iter()
        .flat_map(|segment| {
            [
                segment.start.x,
                segment.start.y,
                segment.end.x,
                segment.end.y,
                segment.width_px,
                segment.neg_log10_nfa,
            ]
        })
        .collect()
}

fn rectangles(width: usize, height: usize) -> Vec<u8> {
    let mut rng = Rng::from_seed(2);
    let mut levels = vec![90.0_f64; width * height];
    for _ in 0..25 {
        let center_x = rng.range(0.0, width as f64);
        let center_y = rng.range(0.0, height as f64);
        let (half_width, half_height) = (rng.range(8.0, 60.0), rng.range(8.0, 60.0));
        let angle = rng.range(0.0, 3.0);
        let (sin, cos) = (elementary::sin(angle), elementary::cos(angle));
        let level = rng.range(20.0, 235.0);
        for (at, pixel) in levels.iter_mut().enumerate() {
            let x = (at % width) as f64 + 0.5 - center_x;
            let y = (at / width) as f64 + 0.5 - center_y;
            let is_inside =
                (cos * x + sin * y).abs() < half_width && (cos * y - sin * x).abs() < half_height;
            if is_inside {
                *pixel = level;
            }
        }
    }
    levels
        .iter()
        .map(|level| (level + rng.range(-6.0, 6.0)).clamp(0.0, 255.0) as u8)
        .collect()
}

/// Outputs of every operation on random shapes.
fn operations() -> Vec<f64> {
    let mut numbers = Vec::new();
    for kind in NN_KINDS.into_iter().chain(CPU_KINDS) {
        for seed in 0..12 {
            let case = nn_case(kind, seed);
            let made =
                CpuExecutor::with_level(case.graph.clone(), case.weights.clone(), Level::Portable);
            let Ok(outputs) = made.and_then(|mut cpu| case.run(&mut cpu)) else {
                return Vec::new();
            };
            numbers.extend(
                outputs
                    .iter()
                    .flat_map(|(_, output)| output)
                    .map(|x| f64::from(*x)),
            );
        }
    }
    numbers
}

/// Weights that keep the size of what goes through them.
fn even_weights(specs: Vec<TensorSpec>, rng: &mut Rng) -> Weights {
    let mut weights = Weights::new();
    for spec in specs {
        let len: usize = spec.shape.iter().product();
        let per_output = len / spec.shape.first().copied().unwrap_or(1).max(1);
        // For numbers even in -1..1 a layer with ReLU keeps the size with a factor of the root of 6 over its inputs.
        let factor = (6.0 / per_output.max(1) as f64).sqrt().min(1.0);
        let numbers = if spec.name.ends_with(".sharpness") {
            vec![20.0; len]
        } else {
            let one = |_| (factor * rng.range(-1.0, 1.0)) as f32;
            (0..len).map(one).collect()
        };
        if let Ok(tensor) = WeightTensor::f32(&spec.shape, numbers) {
            weights.insert(spec.name, tensor);
        }
    }
    weights
}

/// Keypoints, descriptors, scene points and segments of a picture, by XFeat and by every family of regressors.
fn networks() -> Vec<f64> {
    let mut rng = Rng::from_seed(5);
    let (width, height) = (130, 100);
    let levels = rectangles(width, height);
    let view = GrayView::tight(&levels, width, height);
    let kind = ExtractorKind::Xfeat;
    let mut options = ExtractorOptions::new(kind);
    options.keypoints.min_heat = 0.01;
    options.keypoints.max_keypoints = 200;
    let mut scratch = LsdScratch::default();
    let segments = detect(&view, &LsdParams::default(), &mut scratch).unwrap_or_default();
    let mut features = FeatureSet::default();
    let weights = even_weights(kind.tensors(), &mut rng);
    let extracted = Extractor::new(kind, weights, options).and_then(|extractor| {
        extractor
            .with_level(Level::Portable)
            .extract(&view, segments, &mut features)
    });
    if extracted.is_err() || features.keypoints.is_empty() || features.segments.is_empty() {
        return Vec::new();
    }
    let mut numbers: Vec<f64> = features
        .keypoints
        .iter()
        .flat_map(|keypoint| {
            [
                keypoint.pixel.x,
                keypoint.pixel.y,
                f64::from(keypoint.score),
            ]
        })
        .collect();
    let descriptors = features.descriptors_nd.iter();
    numbers.extend(
        descriptors
            .chain(&features.segment_descriptors_nsd)
            .map(|x| f64::from(*x)),
    );
    for config in regressors(kind.descriptor_channels()) {
        let weights = even_weights(config.tensors(), &mut rng);
        let scale = SceneScale::default();
        let mut predictions = Predictions::default();
        let run = Regressor::with_level(&config, weights, scale, 200, 512, Level::Portable)
            .and_then(|mut regressor| regressor.run(&features, &mut predictions));
        if run.is_err() || predictions.points.is_empty() || predictions.segments.is_empty() {
            return Vec::new();
        }
        for point in &predictions.points {
            numbers.extend(point.point_in_world.iter());
            numbers.push(f64::from(point.confidence));
        }
        for segment in &predictions.segments {
            numbers.extend(segment.start_in_world.iter());
            numbers.extend(segment.end_in_world.iter());
            numbers.push(f64::from(segment.confidence));
        }
    }
    numbers
}

/// A small regressor of each family, all of which keep everything.
fn regressors(descriptor_channels: usize) -> [RegressorConfig; 3] {
    let mut attention = RegressorConfig::preset(Preset::Standard, descriptor_channels);
    let mut anchored = RegressorConfig::preset(Preset::Compact, descriptor_channels);
    for config in [&mut attention, &mut anchored] {
        let RegressorConfig::Branches { point, line } = config else {
            continue;
        };
        match point {
            PointBranchConfig::Attention(c) => c.min_confidence = 0.0,
            PointBranchConfig::Anchored(c) => c.num_anchors = 100,
        }
        match line {
            Some(LineBranchConfig::Attention(c)) => c.min_confidence = 0.0,
            Some(LineBranchConfig::Anchored(c)) => c.num_anchors = 50,
            None => {}
        }
    }
    let v1 = V1Config {
        descriptor_channels,
        width: descriptor_channels,
        encoder_hidden: 128,
        mlp_hidden: 128,
        point_head_hidden: vec![64],
        line_head_hidden: vec![64],
        min_point_confidence: 0.0,
        min_line_confidence: 0.0,
        ..V1Config::paper()
    };
    [attention, anchored, RegressorConfig::V1(v1)]
}

/// Points and lines with noise, a third of them wrong.
fn pose() -> Vec<f64> {
    let mut rng = Rng::from_seed(3);
    let camera = Camera::centered(640, 480, 520.0);
    let truth =
        CamFromWorld::from_quaternion_wxyz([0.9, 0.2, -0.3, 0.1], Vector3::new(0.3, -0.2, 0.5));
    let world_from_cam = truth.inverse();
    let observe = |rng: &mut Rng| -> (Pixel, Vector3<f64>) {
        let pixel = Pixel {
            x: rng.range(0.0, 640.0),
            y: rng.range(0.0, 480.0),
        };
        let bearing = camera.bearing_from_pixel(pixel).unwrap_or(Vector3::z());
        let point_in_world = world_from_cam.transform_point(&(bearing * rng.range(1.5, 6.0)));
        let is_outlier = rng.below(3) == 0;
        let noise_m = if is_outlier { 2.0 } else { 0.01 };
        let noise = Vector3::from_fn(|_, _| rng.range(-noise_m, noise_m));
        (pixel, point_in_world + noise)
    };
    let points: Vec<PointCorrespondence> = (0..150)
        .map(|_| {
            let (pixel, point_in_world) = observe(&mut rng);
            PointCorrespondence {
                pixel,
                point_in_world,
                confidence: 0.7,
                sigma_m: 0.0,
                sigma_px: 0.0,
            }
        })
        .collect();
    let lines: Vec<LineCorrespondence> = (0..60)
        .map(|_| {
            let (start, start_in_world) = observe(&mut rng);
            let (end, end_in_world) = observe(&mut rng);
            LineCorrespondence {
                start,
                end,
                start_in_world,
                end_in_world,
                confidence: 0.6,
                sigma_m: 0.0,
                sigma_px: 0.0,
            }
        })
        .collect();
    let mut scratch = PoseScratch::default();
    let options = PoseOptions {
        seed: 4,
        ..PoseOptions::default()
    };
    let outcome = estimate(
        &points,
        &lines,
        &camera,
        &options,
        &mut scratch,
        &mut || 0.0,
    );
    let Some(estimate) = outcome.ok().and_then(|outcome| outcome.estimate) else {
        return Vec::new();
    };
    let transform = estimate.cam_from_world;
    let mut numbers: Vec<f64> = transform.rotation.iter().copied().collect();
    numbers.extend(transform.translation.iter());
    numbers.extend(estimate.covariance.iter());
    numbers.extend([estimate.score, f64::from(estimate.num_point_inliers)]);
    numbers
}
