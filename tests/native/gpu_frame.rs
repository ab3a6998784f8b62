//! A whole frame on the GPU against the same networks, selection and samplers on the CPU.

use landline::{
    features::{Extractor, ExtractorOptions, FeatureSet, frame_parts},
    geometry::{Pixel, Segment2},
    image::GrayImage,
    math::Rng,
    models::{
        AnchoredLineConfig, AnchoredPointConfig, ExtractorKind, LineBranchConfig, LinePool,
        PointBranchConfig, TensorSpec, ports,
    },
    nn::{
        Executor, WeightTensor, Weights,
        cpu::CpuExecutor,
        gpu::{AdapterChoice, FrameResult, GpuDevice, GpuFrame, GpuPart, Pipelines},
    },
};
use landline_testkit::skip_without_gpu;

/// Small random weights; scaled by the number of inputs so that activations neither vanish nor grow.
pub(crate) fn random_weights(specs: &[TensorSpec], rng: &mut Rng) -> Weights {
    let mut weights = Weights::new();
    for spec in specs {
        let fan_in: usize = spec.shape.iter().skip(1).product();
        let bound = (6.0 / fan_in as f64).sqrt().min(1.0);
        let len = spec.shape.iter().product();
        let data = if spec.name.ends_with("sharpness") {
            vec![20.0]
        } else {
            (0..len).map(|_| rng.range(-bound, bound) as f32).collect()
        };
        weights.insert(
            spec.name.clone(),
            WeightTensor::f32(&spec.shape, data).expect("lengths agree"),
        );
    }
    weights
}

/// A picture with structure at several scales.
pub(crate) fn picture(width: usize, height: usize, rng: &mut Rng) -> GrayImage {
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

fn segments(num: usize, width: usize, height: usize, rng: &mut Rng) -> Vec<Segment2> {
    let mut pixel = || Pixel::new(rng.range(0.0, width as f64), rng.range(0.0, height as f64));
    (0..num)
        .map(|_| Segment2 {
            start: pixel(),
            end: pixel(),
            width_px: 1.0,
            precision: 0.1,
            neg_log10_nfa: 10.0,
        })
        .collect()
}

fn branches() -> (PointBranchConfig, LineBranchConfig) {
    let point = AnchoredPointConfig {
        descriptor_channels: 64,
        num_anchors: 100,
        offset_hidden: 16,
        reliability_hidden: 16,
    };
    let line = AnchoredLineConfig {
        descriptor_channels: 64,
        tokens: 12,
        pool: LinePool::Mean,
        key_channels: 64,
        num_anchors: 40,
        offset_hidden: 0,
        reliability_hidden: 16,
    };
    (
        PointBranchConfig::Anchored(point),
        LineBranchConfig::Anchored(line),
    )
}

/// Features and regressed coordinates by the CPU.
fn on_cpu(
    extractor: &mut Extractor,
    parts: &[GpuPart],
    gray: &GrayImage,
    segments: &[Segment2],
) -> (FeatureSet, Vec<Vec<f32>>) {
    let mut features = FeatureSet::default();
    extractor
        .extract(&gray.view(), segments, &mut features)
        .expect("extracts");
    let inputs = [
        (
            ports::POINTS,
            features.keypoints.len(),
            ports::DESCRIPTORS,
            &features.descriptors_nd,
        ),
        (
            ports::SEGMENTS,
            segments.len(),
            ports::TOKENS,
            &features.segment_descriptors_nsd,
        ),
    ];
    let coordinates = parts
        .iter()
        .zip(inputs)
        .map(|(part, (count, num, name, data))| {
            let mut network =
                CpuExecutor::new(part.graph.clone(), part.weights.clone()).expect("loads");
            network.set_count(count, num).expect("within capacity");
            network
                .input(name)
                .expect("has input")
                .copy_from_slice(data);
            network.run().expect("runs");
            network
                .output(ports::COORDINATES)
                .expect("has output")
                .to_vec()
        })
        .collect();
    (features, coordinates)
}

fn named<'a>(outputs: &'a [(String, Vec<f32>)], name: &str) -> &'a [f32] {
    &outputs
        .iter()
        .find(|(found, _)| found == name)
        .expect("the branch has this output")
        .1
}

/// Share of the CPU's keypoints that the GPU found too, and the largest difference of their coordinates.
fn compare(features: &FeatureSet, coordinates: &[f32], found: &FrameResult) -> (f64, f32) {
    let gpu_coordinates = named(&found.branches[0], ports::COORDINATES);
    let (mut common, mut worst) = (0, 0.0_f32);
    for (row, keypoint) in features.keypoints.iter().enumerate() {
        let near = |p: &[f32]| {
            (f64::from(p[0]) - keypoint.pixel.x).abs() < 0.01
                && (f64::from(p[1]) - keypoint.pixel.y).abs() < 0.01
        };
        if let Some(other) = found.positions.chunks_exact(2).position(near) {
            common += 1;
            for axis in 0..3 {
                worst = worst
                    .max((coordinates[3 * row + axis] - gpu_coordinates[3 * other + axis]).abs());
            }
        }
    }
    (
        common as f64 / features.keypoints.len().max(1) as f64,
        worst,
    )
}

fn check(kind: ExtractorKind, width: usize, height: usize, min_heat: f32, max_keypoints: usize) {
    let gpu = match pollster::block_on(GpuDevice::request(AdapterChoice::Any)) {
        Ok(gpu) => gpu,
        Err(error) => return skip_without_gpu(&error.to_string()),
    };
    let mut rng = Rng::from_seed(11);
    let weights = random_weights(&kind.tensors(), &mut rng);
    let mut options = ExtractorOptions {
        max_segments: 30,
        ..ExtractorOptions::new(kind)
    };
    options.keypoints.min_heat = min_heat;
    options.keypoints.max_keypoints = max_keypoints;
    let (point, line) = branches();
    let parts: Vec<GpuPart> = if kind == ExtractorKind::Xfeat {
        vec![
            GpuPart {
                graph: point.graph(max_keypoints).expect("builds"),
                weights: point
                    .prepare(&mut random_weights(&point.tensors(), &mut rng))
                    .expect("prepares"),
            },
            GpuPart {
                graph: line.graph(30).expect("builds"),
                weights: line
                    .prepare(&mut random_weights(&line.tensors(), &mut rng))
                    .expect("prepares"),
            },
        ]
    } else {
        Vec::new()
    };
    let mut extractor = Extractor::new(kind, weights.clone(), options).expect("makes");
    let built =
        frame_parts(kind, &weights, &options, (width, height), parts.clone()).expect("fits");
    let mut frame = GpuFrame::new(&gpu, &mut Pipelines::new(&gpu), built).expect("loads");
    let made = gpu.num_objects_created();
    for num_segments in [7, 0, 30] {
        let gray = picture(width, height, &mut rng);
        let segments = segments(num_segments, width, height, &mut rng);
        let (features, coordinates) = on_cpu(&mut extractor, &parts, &gray, &segments);
        let mut input = vec![0.0; width * height];
        landline::features::write_gray(&gray.view(), &mut input);
        let mut tokens = Vec::new();
        landline::features::write_token_positions(&segments, options.tokens, &mut tokens);
        frame.submit(&input).expect("submits");
        let found = pollster::block_on(frame.finish(&tokens, None)).expect("finishes");
        assert!(
            features.keypoints.len() > 50,
            "only {} keypoints",
            features.keypoints.len()
        );
        assert_eq!(found.scores.len(), features.keypoints.len());
        let ordered = found
            .positions
            .chunks_exact(2)
            .map(|p| (p[1], p[0]))
            .collect::<Vec<_>>();
        assert!(
            ordered.windows(2).all(|pair| pair[0] < pair[1]),
            "keypoints are not in the order of rows"
        );
        if parts.is_empty() {
            let near = |k: &landline::features::Keypoint| {
                found
                    .positions
                    .chunks_exact(2)
                    .any(|p| f64::from(p[0]) == k.pixel.x && f64::from(p[1]) == k.pixel.y)
            };
            let common = features.keypoints.iter().filter(|k| near(k)).count();
            assert!(
                common as f64 >= 0.99 * features.keypoints.len() as f64,
                "{common} keypoints in common"
            );
            continue;
        }
        let (common, worst) = compare(&features, &coordinates[0], &found);
        assert!(common >= 0.99, "{common} of the keypoints in common");
        assert!(worst < 1e-3, "points off by {worst}");
        let lines = named(&found.branches[1], ports::COORDINATES);
        assert_eq!(lines.len(), 6 * num_segments);
        let worst = lines
            .iter()
            .zip(&coordinates[1])
            .fold(0.0_f32, |w, (a, b)| w.max((a - b).abs()));
        assert!(worst < 1e-3, "lines off by {worst}");
    }
    assert_eq!(gpu.num_objects_created(), made, "a frame made objects");
    assert!(
        frame.readback_bytes() < 50_000,
        "{} bytes read back",
        frame.readback_bytes()
    );
}

#[test]
fn xfeat_and_compact_agree_with_the_cpu() {
    check(ExtractorKind::Xfeat, 160, 128, 0.012, 200);
}

#[test]
fn xfeat_agrees_with_the_cpu_where_it_resizes() {
    check(ExtractorKind::Xfeat, 150, 100, 0.012, 100);
}

#[test]
fn xfeat_agrees_when_nothing_is_left_out() {
    check(ExtractorKind::Xfeat, 96, 64, 0.0, 900);
}

#[test]
fn superpoint_selects_the_same_keypoints() {
    check(ExtractorKind::SuperPointOpen, 96, 72, 0.0, 60);
}

/// What a frame asks of a device, for every scene preset: numbers that stand in docs/benchmarks/gpu.md too.
#[test]
fn a_frame_costs_what_the_table_says() {
    use landline::models::{Preset, RegressorConfig};
    use landline::regress::network_parts;
    let gpu = match pollster::block_on(GpuDevice::request(AdapterChoice::Any)) {
        Ok(gpu) => gpu,
        Err(error) => return skip_without_gpu(&error.to_string()),
    };
    let table = include_str!("../../docs/benchmarks/gpu.md");
    let mut rng = Rng::from_seed(1);
    let kind = ExtractorKind::Xfeat;
    let weights = random_weights(&kind.tensors(), &mut rng);
    let mut options = ExtractorOptions {
        max_segments: 300,
        ..ExtractorOptions::new(kind)
    };
    options.keypoints.max_keypoints = 1024;
    let mut missing = Vec::new();
    for preset in [Preset::Compact, Preset::Standard, Preset::Paper] {
        let config = RegressorConfig::preset(preset, 64);
        let made = network_parts(
            &config,
            random_weights(&config.tensors(), &mut rng),
            1024,
            300,
        )
        .expect("prepares");
        let branches = made
            .into_iter()
            .map(|(graph, weights)| GpuPart { graph, weights })
            .collect();
        let parts = frame_parts(kind, &weights, &options, (640, 480), branches).expect("fits");
        let frame = GpuFrame::new(&gpu, &mut Pipelines::new(&gpu), parts).expect("loads");
        let cost = frame.cost();
        let row = format!(
            "| {} | {} | {:.0} | {:.2} | {:.1} | {:.1} | {:.1} |",
            preset.name(),
            cost.dispatches,
            cost.bytes_moved as f64 / 1e6,
            2.0 * cost.macs as f64 / 1e9,
            cost.arena_bytes as f64 / 1e6,
            cost.weight_bytes as f64 / 1e6,
            frame.readback_bytes() as f64 / 1e3,
        );
        if !table.contains(&row) {
            missing.push(row);
        }
    }
    assert!(
        missing.is_empty(),
        "docs/benchmarks/gpu.md lacks\n{}",
        missing.join("\n")
    );
}
