//! A whole frame on the GPU against the same networks, selection and samplers on the CPU.

use landline::{
    features::{Extractor, ExtractorOptions, FeatureSet, frame_parts},
    geometry::{Pixel, Segment2},
    image::GrayImage,
    math::Rng,
    models::{
        AnchoredLineConfig, AnchoredPointConfig, ExtractorKind, LineBranchConfig, LinePool,
        PointBranchConfig, ports,
    },
    nn::{
        Activation, AxisMap, Dense, Executor, Filter, GraphBuilder, WeightTensor, Weights,
        cpu::CpuExecutor,
        gpu::{
            AdapterChoice, FrameParts, FramePorts, FrameResult, GpuDevice, GpuError, GpuFrame,
            GpuPart, GpuSelect, PictureParts, Pipelines, WeightStorage,
        },
    },
};
use landline_testkit::{gpu_or_skip, random_picture, scaled_weights};
use std::sync::Arc;

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

fn load(gpu: &Arc<GpuDevice>, parts: FrameParts) -> GpuFrame {
    let mut pipelines = Pipelines::new(gpu);
    pollster::block_on(GpuFrame::new(gpu, &mut pipelines, parts)).expect("loads")
}

fn check(kind: ExtractorKind, width: usize, height: usize, min_heat: f32, max_keypoints: usize) {
    let Some(gpu) = gpu_or_skip(GpuDevice::request(AdapterChoice::Any)) else {
        return;
    };
    let mut rng = Rng::from_seed(11);
    let weights = scaled_weights(&kind.tensors(), &mut rng);
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
                    .prepare(&mut scaled_weights(&point.tensors(), &mut rng))
                    .expect("prepares"),
            },
            GpuPart {
                graph: line.graph(30).expect("builds"),
                weights: line
                    .prepare(&mut scaled_weights(&line.tensors(), &mut rng))
                    .expect("prepares"),
            },
        ]
    } else {
        Vec::new()
    };
    let mut extractor = Extractor::new(kind, weights.clone(), options).expect("makes");
    let size = (width, height);
    let storage = WeightStorage::Exact;
    let built = frame_parts(kind, &weights, &options, size, parts.clone(), storage).expect("fits");
    let mut frame = load(&gpu, built);
    let made = gpu.num_objects_created();
    for num_segments in [7, 0, 30] {
        let gray = random_picture(width, height, &mut rng);
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
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
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

/// Names of the tiny frame's tensors.
const TINY: FramePorts = FramePorts {
    gray: "gray",
    features: "features",
    cells: "cells",
    positions: "positions",
    samples: "samples",
    descriptors: "descriptors",
    tokens: "tokens",
    points: "points",
    segments: "segments",
};
const TINY_SIDE: usize = 16;
const TINY_TOKENS: usize = 3;
const TINY_SEGMENTS: usize = 5;

/// A frame with everything that a real one has, small enough to run by the thousand on a software device.
fn tiny_parts(side: usize) -> FrameParts {
    let part = |g: GraphBuilder| {
        let graph = g.finish().expect("a valid graph");
        let weights = scaled_weights(graph.weights(), &mut Rng::from_seed(8));
        GpuPart { graph, weights }
    };
    let mut g = GraphBuilder::new("tiny extractor");
    let x = g.input_grid(TINY.gray, side, side, 1);
    let maps = g.conv3x3(x, Dense::new("maps", 8).activation(Activation::Relu));
    let heat = g.linear(maps, Dense::new("heat", 1).activation(Activation::Sigmoid));
    g.output("heat", heat);
    let cells = g.avg_pool(maps, 8);
    let features = g.l2_norm(cells, 1e-12);
    g.output(TINY.features, features);
    let extractor = part(g);
    let sampler = |capacity: usize| {
        let mut g = GraphBuilder::new("tiny sampler");
        let samples = g.count(TINY.samples, capacity);
        let cells = g.input_grid(TINY.cells, side / 8, side / 8, 8);
        let at = g.input_rows(TINY.positions, samples, 2);
        let axis = AxisMap {
            scale: 0.125,
            offset: -0.5,
        };
        let read = g.sample(cells, at, Filter::Bilinear, axis, axis);
        let unit = g.l2_norm(read, 1e-12);
        g.output(TINY.descriptors, unit);
        part(g)
    };
    let mut g = GraphBuilder::new("tiny branch");
    let points = g.count(TINY.points, 20);
    let segments = g.count(TINY.segments, TINY_SEGMENTS);
    let x = g.input_rows(TINY.descriptors, points, 8);
    let t = g.input_tokens(TINY.tokens, segments, TINY_TOKENS, 8);
    let attended = g.attention([x, t, t], 2, 0.5, None);
    let y = g.linear(attended, Dense::new("y", 3));
    g.output("coordinates", y);
    let branch = part(g);
    FrameParts {
        picture: PictureParts {
            extractor,
            select: GpuSelect {
                heat: "heat",
                reliability: None,
                radius: 1,
                min_heat: 0.0,
                border: 0,
                capacity: 20,
                scale: [1.0, 1.0],
            },
            point_sampler: sampler(20),
            line_sampler: Some(sampler(TINY_SEGMENTS * TINY_TOKENS)),
        },
        tokens: TINY_TOKENS,
        branches: vec![branch],
        ports: TINY,
        storage: WeightStorage::Exact,
        reads_descriptors: true,
    }
}

fn tiny_picture(side: usize) -> Vec<f32> {
    let mut rng = Rng::from_seed(5);
    (0..side * side).map(|_| rng.uniform() as f32).collect()
}

fn run_tiny(frame: &mut GpuFrame, side: usize, num_segments: usize) -> FrameResult {
    frame.submit(&tiny_picture(side)).expect("submits");
    let at = vec![0.4 * side as f32; 2 * TINY_TOKENS * num_segments];
    pollster::block_on(frame.finish(&at, None)).expect("finishes")
}

#[test]
fn two_thousand_frames_make_no_objects_and_all_answer_alike() {
    let Some(gpu) = gpu_or_skip(GpuDevice::request(AdapterChoice::Any)) else {
        return;
    };
    let mut frame = load(&gpu, tiny_parts(TINY_SIDE));
    let expected = [0, 2, 5].map(|n| run_tiny(&mut frame, TINY_SIDE, n));
    assert_eq!(expected[0].scores.len(), 20, "the picture has keypoints");
    assert_ne!(expected[1], expected[0], "segments matter");
    for (result, segments) in expected.iter().zip([0, 2, 5]) {
        let lengths = result.descriptors.each_ref().map(Vec::len);
        assert_eq!(lengths, [20 * 8, segments * TINY_TOKENS * 8]);
    }
    let (made, alive) = (gpu.num_objects_created(), gpu.num_objects_alive());
    assert!(alive.is_some_and(|n| n > 0));
    for i in 0..2000 {
        let found = run_tiny(&mut frame, TINY_SIDE, [0, 2, 5][i % 3]);
        assert_eq!(found, expected[i % 3], "frame {i}");
    }
    assert_eq!(gpu.num_objects_created(), made);
    assert_eq!(
        gpu.num_objects_alive(),
        alive,
        "by the driver layer's own books"
    );
    assert_eq!(gpu.check(), Ok(()));
}

#[test]
fn bad_input_is_refused_before_it_reaches_the_device() {
    let Some(gpu) = gpu_or_skip(GpuDevice::request(AdapterChoice::Any)) else {
        return;
    };
    let mut frame = load(&gpu, tiny_parts(TINY_SIDE));
    let expected = run_tiny(&mut frame, TINY_SIDE, TINY_SEGMENTS);
    assert_eq!(frame.max_segments(), TINY_SEGMENTS);

    // More segments than there is room for.
    frame.submit(&tiny_picture(TINY_SIDE)).expect("submits");
    let at = vec![1.0; 2 * TINY_TOKENS * (TINY_SEGMENTS + 1)];
    let error = pollster::block_on(frame.finish(&at, None)).expect_err("too many segments");
    assert!(matches!(error, GpuError::Network(_)), "{error}");

    // A picture of another size than announced, smaller and larger.
    for side in [8, 24] {
        let error = frame.submit(&tiny_picture(side)).expect_err("another size");
        assert!(matches!(error, GpuError::Unsupported { .. }), "{error}");
    }

    // A flat picture: no keypoint.
    frame
        .submit(&[0.5; TINY_SIDE * TINY_SIDE])
        .expect("submits");
    pollster::block_on(frame.finish(&[], None)).expect("no keypoint and no segment are valid");

    // Announced sizes may change, and back; what is kept on the device still works.
    let mut pipelines = Pipelines::new(&gpu);
    for side in [24, TINY_SIDE] {
        let picture = tiny_parts(side).picture;
        pollster::block_on(frame.resize(&mut pipelines, picture)).expect("another size");
        run_tiny(&mut frame, side, 1);
    }
    assert_eq!(run_tiny(&mut frame, TINY_SIDE, TINY_SEGMENTS), expected);
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}

/// What a frame asks of a device, for every extractor and scene preset: numbers that stand in docs/benchmarks/gpu.md too.
#[test]
fn a_frame_costs_what_the_table_says() {
    use landline::models::{Preset, RegressorConfig, V1Config};
    use landline::regress::network_parts;
    let table = include_str!("../../docs/benchmarks/gpu.md");
    let mut rng = Rng::from_seed(1);
    let xfeat = ExtractorKind::Xfeat;
    let superpoint = ExtractorKind::SuperPointV1;
    let preset =
        |preset, kind: ExtractorKind| RegressorConfig::preset(preset, kind.descriptor_channels());
    let rows = [
        (xfeat, "compact", preset(Preset::Compact, xfeat)),
        (xfeat, "standard", preset(Preset::Standard, xfeat)),
        (xfeat, "paper", preset(Preset::Paper, xfeat)),
        (superpoint, "paper", preset(Preset::Paper, superpoint)),
        (superpoint, "v1", RegressorConfig::V1(V1Config::paper())),
    ];
    let mut missing = Vec::new();
    for (kind, name, config) in rows {
        // As in files of 16 bits.
        let weights = in_16_bits(&scaled_weights(&kind.tensors(), &mut rng));
        let mut options = ExtractorOptions {
            max_segments: 300,
            ..ExtractorOptions::new(kind)
        };
        options.keypoints.max_keypoints = 1024;
        let scene_weights = in_16_bits(&scaled_weights(&config.tensors(), &mut rng));
        let made = network_parts(&config, scene_weights, 1024, 300).expect("prepares");
        let branches = made
            .into_iter()
            .map(|(graph, weights)| GpuPart { graph, weights })
            .collect();
        let size = (640, 480);
        let storage = WeightStorage::Exact;
        let parts = frame_parts(kind, &weights, &options, size, branches, storage).expect("fits");
        let (cost, readback_bytes) = parts.cost().expect("lowers");
        let mb = |bytes: u64| bytes as f64 / 1e6;
        let row = format!(
            "| {} | {name} | {} | {:.0} | {:.1} | {:.1} | {:.2} | {:.1} | {:.1} | {:.1} |",
            kind.name(),
            cost.dispatches,
            mb(cost.bytes_moved),
            mb(cost.weight_bytes_read),
            mb(cost.bytes_copied),
            2.0 * cost.macs as f64 / 1e9,
            mb(cost.arena_bytes),
            mb(cost.weight_bytes),
            readback_bytes as f64 / 1e3,
        );
        assert!(readback_bytes < 50_000, "{readback_bytes} bytes read back");
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

/// The same weights rounded to 16 bits, as a file in that precision has them.
fn in_16_bits(weights: &Weights) -> Weights {
    let rounded = weights.iter().map(|(name, tensor)| {
        let numbers = tensor.to_f32().into_iter().map(half::f16::from_f32);
        let tensor = WeightTensor::f16(tensor.shape(), numbers.collect()).expect("lengths agree");
        (name.to_owned(), tensor)
    });
    rounded.collect()
}
