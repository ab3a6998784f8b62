//! PL2Map and the paper's network from the original checkpoints.

use crate::golden::{Golden, relative_error};
use landline::features::{FeatureSet, Keypoint};
use landline::geometry::{Pixel, SceneScale, Segment2};
use landline::models::{
    ExtractorKind, LineBranchConfig, PointBranchConfig, RegressorConfig, ports,
};
use landline::nn::cpu::CpuExecutor;
use landline::nn::gpu::{AdapterChoice, GpuDevice, GpuExecutor, Pipelines};
use landline::nn::oracle::OracleExecutor;
use landline::nn::{Executor, Graph, Weights};
use landline::regress::{Predictions, Regressor};
use landline::scene_file::{Precision, SceneFile, SceneInfo};
use landline_mapper::import::{ImportOptions, Imported, import};
use landline_testkit::shared_data;
use std::path::Path;

/// Agreement asked of a forward pass in f32.
const TOLERANCE: f32 = 1e-4;

fn regressor(path: &Path, options: &ImportOptions) -> (RegressorConfig, Weights) {
    let bytes = std::fs::read(path).expect("the checkpoint is readable");
    match import(&bytes, options).expect("the checkpoint converts") {
        Imported::Regressor { config, weights } => (config, weights),
        Imported::Extractor(file) => panic!("taken for {:?}", file.kind),
    }
}

/// All executors that are here; a machine without a GPU adapter has two.
fn executors(graph: &Graph, weights: &Weights) -> Vec<(&'static str, Box<dyn Executor>)> {
    let cpu = CpuExecutor::new(graph.clone(), weights.clone()).expect("weights fit");
    let oracle = OracleExecutor::new(graph.clone(), weights.clone()).expect("weights fit");
    let mut all: Vec<(&str, Box<dyn Executor>)> =
        vec![("cpu", Box::new(cpu)), ("oracle", Box::new(oracle))];
    if let Ok(gpu) = pollster::block_on(GpuDevice::request(AdapterChoice::Any)) {
        let (graph, weights) = (graph.clone(), weights.clone());
        let on_gpu = GpuExecutor::new(&gpu, &mut Pipelines::new(&gpu), graph, weights);
        all.push(("gpu", Box::new(on_gpu.expect("weights fit"))));
    }
    all
}

fn check(what: &str, got: &[f32], expected: &[f32]) {
    let error = relative_error(got, expected);
    println!("{what}: {error:.1e}");
    assert!(error < TOLERANCE, "{what}: {error}");
}

fn rows_of(mask: &[f32]) -> Vec<f32> {
    let kept = mask.iter().enumerate().filter(|(_, m)| **m != 0.0);
    kept.map(|(i, _)| i as f32).collect()
}

/// Features whose positions do not matter.
fn features(golden: &Golden) -> FeatureSet {
    let channels = golden.shape("points_descriptors")[1];
    let (num, tokens) = (
        golden.shape("lines_descriptors")[1],
        golden.shape("lines_descriptors")[2],
    );
    let keypoint = Keypoint {
        pixel: Pixel::new(0.0, 0.0),
        score: 0.0,
    };
    let segment = Segment2 {
        start: Pixel::new(0.0, 0.0),
        end: Pixel::new(1.0, 0.0),
        width_px: 1.0,
        precision: 0.125,
        neg_log10_nfa: 1.0,
    };
    FeatureSet {
        keypoints: vec![keypoint; golden.shape("points_descriptors")[2]],
        descriptors_nd: golden.rows("points_descriptors"),
        segments: vec![segment; num],
        segment_descriptors_nsd: golden.get("lines_descriptors").to_vec(),
        descriptor_channels: channels,
        tokens,
    }
}

#[test]
fn proposed_agrees_with_the_reference() {
    let Some(dir) = shared_data("data/golden/regressor") else {
        return;
    };
    let golden = Golden::read(&dir.join("proposed_io.safetensors"));
    let options = ImportOptions {
        min_point_confidence: Some(0.5),
        min_line_confidence: Some(0.45),
        ..ImportOptions::default()
    };
    let (config, weights) = regressor(&dir.join("proposed.pth.tar"), &options);
    let RegressorConfig::Branches {
        point: PointBranchConfig::Attention(p),
        line: Some(LineBranchConfig::Attention(l)),
    } = &config
    else {
        panic!("{config:?}")
    };
    assert_eq!(
        (p.width, p.heads, p.num_layers, l.num_layers),
        (64, 4, 5, 1)
    );
    assert_eq!(p.head_hidden, [96, 128, 128, 96]);
    assert_eq!(l.head_hidden, [96, 128, 96]);
    let set = features(&golden);
    let (num_points, num_segments) = (set.keypoints.len(), set.segments.len());

    let mut left = weights.clone();
    let point = PointBranchConfig::Attention(p.clone());
    let made = point.prepare(&mut left).expect("prepares");
    let graph = point.graph(num_points + 7).expect("builds");
    for (name, mut net) in executors(&graph, &made) {
        net.set_count(ports::POINTS, num_points).expect("fits");
        net.input(ports::DESCRIPTORS)
            .expect("input")
            .copy_from_slice(&set.descriptors_nd);
        net.run().expect("runs");
        check(
            &format!("{name} point logits"),
            net.output(ports::LOGITS).expect("output"),
            golden.get("points_prune_logits"),
        );
        assert_eq!(
            net.output(ports::ROWS).expect("output"),
            rows_of(golden.get("points_keep"))
        );
        check(
            &format!("{name} points"),
            net.output(ports::COORDINATES).expect("output"),
            &golden.rows("points3d"),
        );
    }

    let line = LineBranchConfig::Attention(l.clone());
    let made = line.prepare(&mut left).expect("prepares");
    let graph = line.graph(num_segments).expect("builds");
    for (name, mut net) in executors(&graph, &made) {
        net.input(ports::TOKENS)
            .expect("input")
            .copy_from_slice(&set.segment_descriptors_nsd);
        net.run().expect("runs");
        check(
            &format!("{name} line logits"),
            net.output(ports::LOGITS).expect("output"),
            golden.get("lines_prune_logits"),
        );
        assert_eq!(
            net.output(ports::ROWS).expect("output"),
            rows_of(golden.get("lines_keep"))
        );
        check(
            &format!("{name} lines"),
            net.output(ports::COORDINATES).expect("output"),
            &golden.rows("lines3d"),
        );
    }
    assert!(left.is_empty(), "a tensor belongs to no branch");

    // The same through the regressor: rows, scale, order.
    let scale = SceneScale {
        centre: [1.0, 2.0, 3.0].into(),
        scale: 2.0,
    };
    let mut regressor = Regressor::new(&config, weights, scale, 64, 16).expect("weights fit");
    let mut out = Predictions::default();
    regressor.run(&set, &mut out).expect("runs");
    let kept = golden.rows("points3d");
    assert_eq!(out.points.len(), kept.len() / 3);
    let first = out.points[0].point_in_world;
    assert!((first.x - (1.0 + 2.0 * f64::from(kept[0]))).abs() < 1e-4);
    assert_eq!(out.segments.len(), golden.rows("lines3d").len() / 6);
}

#[test]
fn v1_agrees_with_the_reference() {
    let Some(dir) = shared_data("data/golden/regressor") else {
        return;
    };
    let golden = Golden::read(&dir.join("v1_io.safetensors"));
    let (config, mut weights) = regressor(&dir.join("v1.pth.tar"), &ImportOptions::default());
    let RegressorConfig::V1(v1) = &config else {
        panic!("{config:?}")
    };
    let set = features(&golden);
    let made = v1.prepare(&mut weights).expect("prepares");
    assert!(weights.is_empty(), "a tensor is not used");
    let graph = v1.graph(50, 9).expect("builds");
    for (name, mut net) in executors(&graph, &made) {
        net.set_count(ports::POINTS, set.keypoints.len())
            .expect("fits");
        net.input(ports::DESCRIPTORS)
            .expect("input")
            .copy_from_slice(&set.descriptors_nd);
        net.input(ports::TOKENS)
            .expect("input")
            .copy_from_slice(&set.segment_descriptors_nsd);
        net.run().expect("runs");
        check(
            &format!("{name} points"),
            net.output(ports::POINTS_3D).expect("output"),
            &golden.rows("points3d"),
        );
        check(
            &format!("{name} lines"),
            net.output(ports::LINES_3D).expect("output"),
            &golden.rows("lines3d"),
        );
    }
}

/// Share of the smaller list that both have, and the largest distance of common ones relative to the size of the scene.
fn agreement(a: &Predictions, b: &Predictions) -> (f64, f64) {
    let size = a
        .points
        .iter()
        .map(|p| p.point_in_world.norm())
        .fold(0.0, f64::max);
    let mut common = 0;
    let mut farthest = 0.0_f64;
    for (row, point) in a.point_rows.iter().zip(&a.points) {
        if let Some(other) = b.point_rows.iter().position(|r| r == row) {
            common += 1;
            let apart = point.point_in_world - b.points[other].point_in_world;
            farthest = farthest.max(apart.norm() / size);
        }
    }
    let fewer = a.points.len().min(b.points.len()).max(1);
    (f64::from(common) / fewer as f64, farthest)
}

/// What storing in 16 or 8 bits costs the networks of the reference, whose weights are random: trained ones are evened out by
/// their many elements no less.
#[test]
fn stored_precisions_stay_close_to_the_full_network() {
    let Some(dir) = shared_data("data/golden/regressor") else {
        return;
    };
    for name in ["proposed", "v1"] {
        let golden = Golden::read(&dir.join(format!("{name}_io.safetensors")));
        let options = ImportOptions {
            min_point_confidence: Some(0.0),
            min_line_confidence: Some(0.0),
            ..ImportOptions::default()
        };
        let (config, weights) = regressor(&dir.join(format!("{name}.pth.tar")), &options);
        let set = features(&golden);
        let scene = SceneFile {
            info: SceneInfo::new(ExtractorKind::Xfeat, "0".repeat(64)),
            config,
            weights,
            landmarks: None,
        };
        let run = |precision: Precision| {
            let bytes = scene.to_bytes(precision).expect("writes");
            let read = SceneFile::from_bytes(&bytes).expect("reads its own file");
            let scale = SceneScale::default();
            let mut regressor =
                Regressor::new(&read.config, read.weights, scale, 64, 16).expect("weights fit");
            let mut out = Predictions::default();
            regressor.run(&set, &mut out).expect("runs");
            (out, bytes.len())
        };
        let (full, full_len) = run(Precision::F32);
        for (precision, most_bytes, most_apart) in
            [(Precision::F16, 0.55, 2e-3), (Precision::Int8, 0.33, 3e-2)]
        {
            let (out, len) = run(precision);
            let (common, apart) = agreement(&full, &out);
            let share = len as f64 / full_len as f64;
            println!(
                "{name} {precision:?}: {share:.2} of the bytes, {common:.3} kept, {apart:.1e} apart"
            );
            assert!(share < most_bytes, "{name} {precision:?}: {share}");
            assert!(common == 1.0, "{name} {precision:?}: {common}");
            assert!(apart < most_apart, "{name} {precision:?}: {apart}");
        }
    }
}
