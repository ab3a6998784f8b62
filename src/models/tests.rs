//! The long form of every network in plain f64, against the graphs: what folding left out must not be missed.

mod anchored;
mod long;

use super::{
    AnchoredLineConfig, AttentionLineConfig, AttentionOutput, AttentionPointConfig,
    LineBranchConfig, LinePool, PointBranchConfig, RegressorConfig, TensorSpec, V1Config, ports,
};
use crate::nn::oracle::OracleExecutor;
use crate::nn::{Executor, Graph, WeightTensor, Weights};
use long::Long;

type Rows = Vec<Vec<f64>>;

/// Numbers in -0.5..0.5 that look random.
fn noise(state: &mut u32, n: usize) -> Vec<f32> {
    let mut next = || {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*state >> 8) as f32 / 16_777_216.0 - 0.5
    };
    (0..n).map(|_| next()).collect()
}

fn random_weights(specs: &[TensorSpec], seed: u32) -> Weights {
    let mut state = seed;
    specs
        .iter()
        .map(|t| {
            let data = noise(&mut state, t.shape.iter().product());
            (
                t.name.clone(),
                WeightTensor::f32(&t.shape, data).expect("sizes agree"),
            )
        })
        .collect()
}

fn unit_rows(seed: u32, n: usize, channels: usize) -> Rows {
    let mut state = seed;
    (0..n)
        .map(|_| {
            let row: Vec<f64> = noise(&mut state, channels)
                .into_iter()
                .map(f64::from)
                .collect();
            let norm = row.iter().map(|x| x * x).sum::<f64>().sqrt();
            row.iter().map(|x| x / norm).collect()
        })
        .collect()
}

/// Runs a graph on rows and returns an output's rows.
fn run(graph: &Graph, made: &Weights, inputs: &[(&str, &str, &Rows, usize)]) -> OracleExecutor {
    let mut net = OracleExecutor::new(graph.clone(), made.clone()).expect("weights fit");
    for (count, name, rows, per) in inputs {
        net.set_count(count, rows.len() / per).expect("fits");
        let flat: Vec<f32> = rows.iter().flatten().map(|x| *x as f32).collect();
        net.input(name).expect("input").copy_from_slice(&flat);
    }
    net.run().expect("runs");
    net
}

/// Moves the last bias of a pruning MLP so that half of the elements survive.
fn centre_logits(weights: &mut Weights, bias: &str, logits: &[f64]) {
    let mut sorted = logits.to_vec();
    sorted.sort_by(f64::total_cmp);
    let half = sorted.len() / 2;
    let middle = 0.5 * (sorted[half - 1] + sorted[half]);
    let b = weights.get(bias).expect("present").to_f32()[0];
    let tensor = WeightTensor::f32(&[1], vec![b - middle as f32]).expect("sizes agree");
    weights.insert(bias, tensor);
}

fn assert_close(what: &str, got: &[f32], expected: &[f64]) {
    assert_eq!(got.len(), expected.len(), "{what}: sizes");
    let largest = expected.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
    for (i, (g, e)) in got.iter().zip(expected).enumerate() {
        assert!(
            (f64::from(*g) - e).abs() < 5e-6 * largest,
            "{what} {i}: {g} instead of {e}"
        );
    }
}

fn point_config(descriptor_channels: usize) -> AttentionPointConfig {
    AttentionPointConfig {
        descriptor_channels,
        width: 8,
        heads: 2,
        num_layers: 2,
        mlp_hidden: 12,
        prune_hidden: 5,
        head_hidden: vec![7, 9],
        min_confidence: 0.5,
        output: AttentionOutput::Linear,
    }
}

fn line_config(descriptor_channels: usize) -> AttentionLineConfig {
    AttentionLineConfig {
        descriptor_channels,
        tokens: 4,
        width: 8,
        heads: 2,
        encoder_hidden: 10,
        num_layers: 1,
        mlp_hidden: 12,
        prune_hidden: 5,
        head_hidden: vec![7],
        min_confidence: 0.5,
        output: AttentionOutput::Linear,
    }
}

#[test]
fn point_branch_equals_its_long_form_with_and_without_input_layer() {
    for channels in [8, 6] {
        let config = point_config(channels);
        let mut weights = random_weights(&config.tensors(), 3);
        let x = unit_rows(5, 30, channels);
        let long = Long(&weights);
        let inner: Rows = if channels == 8 {
            x.clone()
        } else {
            x.iter().map(|r| long.linear("point.in", r)).collect()
        };
        let logits_of = |w: &Weights| -> Vec<f64> {
            inner
                .iter()
                .map(|r| Long(w).mlp("point.prune", 2, r)[0])
                .collect()
        };
        let logits = logits_of(&weights);
        centre_logits(&mut weights, "point.prune.1.b", &logits);
        let (logits, long) = (logits_of(&weights), Long(&weights));
        let rows: Vec<usize> = (0..30).filter(|i| logits[*i] > 0.0).collect();
        assert!(!rows.is_empty() && rows.len() < 30, "the case prunes some");
        let mut kept: Rows = rows.iter().map(|i| inner[*i].clone()).collect();
        for i in 0..2 {
            kept = long.attention_layer(&format!("point.attn.{i}"), &kept, &kept, 2);
        }
        let expected: Vec<f64> = kept
            .iter()
            .flat_map(|r| long.mlp("point.head", 3, r))
            .collect();

        let branch = PointBranchConfig::Attention(config);
        let made = branch.prepare(&mut weights.clone()).expect("prepares");
        let graph = branch.graph(40).expect("builds");
        let net = run(&graph, &made, &[(ports::POINTS, ports::DESCRIPTORS, &x, 1)]);
        assert_close(
            "logits",
            net.output(ports::LOGITS).expect("output"),
            &logits,
        );
        assert_close(
            "points",
            net.output(ports::COORDINATES).expect("output"),
            &expected,
        );
        let got: Vec<usize> = net
            .output(ports::ROWS)
            .expect("output")
            .iter()
            .map(|r| *r as usize)
            .collect();
        assert_eq!(got, rows);
    }
}

#[test]
fn line_branch_with_one_query_equals_the_full_encoder() {
    for channels in [8, 6] {
        let config = line_config(channels);
        let mut weights = random_weights(&config.tensors(), 7);
        let tokens = unit_rows(11, 4 * 12, channels);
        let long = Long(&weights);
        let mut l: Rows = tokens
            .chunks_exact(4)
            .map(|t| long.line_encoder(&t.to_vec(), 2, channels != 8))
            .collect();
        l = long.attention_layer("line.attn.0", &l, &l, 2);
        let logits_of = |w: &Weights| -> Vec<f64> {
            l.iter()
                .map(|r| Long(w).mlp("line.prune", 2, r)[0])
                .collect()
        };
        let logits = logits_of(&weights);
        centre_logits(&mut weights, "line.prune.1.b", &logits);
        let (logits, long) = (logits_of(&weights), Long(&weights));
        let expected: Vec<f64> = (0..12)
            .filter(|i| logits[*i] > 0.0)
            .flat_map(|i| long.mlp("line.head", 2, &l[i]))
            .collect();

        let branch = LineBranchConfig::Attention(config);
        let made = branch.prepare(&mut weights.clone()).expect("prepares");
        let graph = branch.graph(12).expect("builds");
        let net = run(
            &graph,
            &made,
            &[(ports::SEGMENTS, ports::TOKENS, &tokens, 4)],
        );
        assert_close(
            "logits",
            net.output(ports::LOGITS).expect("output"),
            &logits,
        );
        assert_close(
            "lines",
            net.output(ports::COORDINATES).expect("output"),
            &expected,
        );
    }
}

fn v1_config() -> V1Config {
    V1Config {
        descriptor_channels: 8,
        tokens: 4,
        width: 8,
        heads: 2,
        encoder_hidden: 10,
        num_layers: 3,
        mlp_hidden: 12,
        point_head_hidden: vec![7],
        line_head_hidden: vec![9],
        ..V1Config::paper()
    }
}

#[test]
fn v1_equals_its_long_form_also_without_points_or_segments() {
    let config = v1_config();
    let weights = random_weights(&config.tensors(), 13);
    let long = Long(&weights);
    let made = config.prepare(&mut weights.clone()).expect("prepares");
    let graph = config.graph(20, 10).expect("builds");
    // Without sources the attention sum is empty, so the message is the bias of the merge.
    for (num_points, num_segments) in [(9, 5), (9, 0), (0, 5), (1, 1)] {
        let mut p = unit_rows(17, num_points, 8);
        let tokens = unit_rows(19, 4 * num_segments, 8);
        let mut l: Rows = tokens
            .chunks_exact(4)
            .map(|t| long.line_encoder(&t.to_vec(), 2, false))
            .collect();
        let x = p.clone();
        for i in 0..3 {
            let name = format!("joint.attn.{i}");
            let (for_p, for_l) = if i % 2 == 0 { (&p, &l) } else { (&l, &p) };
            let new_p = long.attention_layer(&name, &p, for_p, 2);
            let new_l = long.attention_layer(&name, &l, for_l, 2);
            (p, l) = (new_p, new_l);
        }
        let points: Vec<f64> = p
            .iter()
            .flat_map(|r| long.mlp("point.head", 2, r))
            .collect();
        let lines: Vec<f64> = l.iter().flat_map(|r| long.mlp("line.head", 2, r)).collect();
        let net = run(
            &graph,
            &made,
            &[
                (ports::POINTS, ports::DESCRIPTORS, &x, 1),
                (ports::SEGMENTS, ports::TOKENS, &tokens, 4),
            ],
        );
        let what = format!("{num_points} points, {num_segments} segments");
        assert_close(
            &what,
            net.output(ports::POINTS_3D).expect("output"),
            &points,
        );
        assert_close(&what, net.output(ports::LINES_3D).expect("output"), &lines);
    }
}

#[test]
fn key_biases_do_not_matter() {
    let config = v1_config();
    let weights = random_weights(&config.tensors(), 41);
    let mut other = weights.clone();
    let names: Vec<String> = weights
        .iter()
        .map(|(name, _)| name.to_owned())
        .filter(|name| name.ends_with(".k.b"))
        .collect();
    assert_eq!(names.len(), 4, "three layers and the line encoder");
    let (long, x) = (Long(&weights), unit_rows(43, 6, 8));
    let before = long.attention_layer("joint.attn.0", &x, &x, 2);
    for name in names {
        other.insert(
            name,
            WeightTensor::f32(&[8], vec![3.0, -1.0, 0.5, 2.0, 0.0, 7.0, 1.0, 4.0]).expect("sizes"),
        );
    }
    let after = Long(&other).attention_layer("joint.attn.0", &x, &x, 2);
    for (a, b) in before.iter().flatten().zip(after.iter().flatten()) {
        assert!((a - b).abs() < 1e-12, "{a} {b}");
    }
    let made = config.prepare(&mut weights.clone()).expect("prepares");
    assert_eq!(made, config.prepare(&mut other).expect("prepares"));
}

#[test]
fn order_of_points_and_segments_only_orders_the_output() {
    let config = point_config(8);
    let weights = random_weights(&config.tensors(), 47);
    let branch = PointBranchConfig::Attention(config);
    let made = branch.prepare(&mut weights.clone()).expect("prepares");
    let graph = branch.graph(16).expect("builds");
    let x = unit_rows(53, 16, 8);
    let reversed: Rows = x.iter().rev().cloned().collect();
    let net = run(&graph, &made, &[(ports::POINTS, ports::DESCRIPTORS, &x, 1)]);
    let other = run(
        &graph,
        &made,
        &[(ports::POINTS, ports::DESCRIPTORS, &reversed, 1)],
    );
    let backwards: Vec<f64> = other
        .output(ports::COORDINATES)
        .expect("output")
        .chunks_exact(3)
        .rev()
        .flatten()
        .map(|v| f64::from(*v))
        .collect();
    assert_close(
        "points",
        net.output(ports::COORDINATES).expect("output"),
        &backwards,
    );
}

#[test]
fn a_reversed_segment_is_another_segment_to_the_paper_and_the_same_one_to_the_mean() {
    let tokens = unit_rows(59, 4, 8);
    let reversed: Rows = tokens.iter().rev().cloned().collect();
    let mut config = line_config(8);
    config.min_confidence = 0.0;
    let anchored = AnchoredLineConfig {
        descriptor_channels: 8,
        tokens: 4,
        pool: LinePool::Mean,
        key_channels: 8,
        num_anchors: 10,
        offset_hidden: 0,
        reliability_hidden: 3,
    };
    for (branch, same) in [
        (LineBranchConfig::Attention(config), false),
        (LineBranchConfig::Anchored(anchored), true),
    ] {
        let made = branch
            .prepare(&mut random_weights(&branch.tensors(), 61))
            .expect("prepares");
        let graph = branch.graph(1).expect("builds");
        let out = |rows: &Rows| {
            let net = run(&graph, &made, &[(ports::SEGMENTS, ports::TOKENS, rows, 4)]);
            net.output(ports::COORDINATES).expect("output").to_vec()
        };
        let (a, b) = (out(&tokens), out(&reversed));
        let differs = a.iter().zip(&b).any(|(a, b)| (a - b).abs() > 1e-3);
        assert_ne!(differs, same, "{a:?} {b:?}");
    }
}

#[test]
fn none_and_one_survivor_are_fine() {
    let mut config = point_config(8);
    config.min_confidence = 0.999_999;
    let branch = PointBranchConfig::Attention(config);
    let specs = branch.tensors();
    let mut weights = random_weights(&specs, 67);
    let x = unit_rows(71, 6, 8);
    let made = branch.prepare(&mut weights.clone()).expect("prepares");
    let graph = branch.graph(6).expect("builds");
    let net = run(&graph, &made, &[(ports::POINTS, ports::DESCRIPTORS, &x, 1)]);
    assert!(net.output(ports::COORDINATES).expect("output").is_empty());
    assert_eq!(net.output(ports::LOGITS).expect("output").len(), 6);
    // A large bias keeps all of one point.
    weights.insert(
        "point.prune.1.b",
        WeightTensor::f32(&[1], vec![50.0]).expect("sizes"),
    );
    let made = branch.prepare(&mut weights).expect("prepares");
    let one = vec![x[0].clone()];
    let net = run(
        &graph,
        &made,
        &[(ports::POINTS, ports::DESCRIPTORS, &one, 1)],
    );
    assert_eq!(net.output(ports::COORDINATES).expect("output").len(), 3);
}

#[test]
fn a_configuration_says_what_it_is() {
    let v1 = RegressorConfig::V1(v1_config());
    assert_eq!(v1.variant().name(), "v1");
    assert_eq!(v1.line_tokens(), Some(4));
    let points_only = RegressorConfig::Branches {
        point: PointBranchConfig::Attention(point_config(8)),
        line: None,
    };
    assert_eq!(points_only.line_tokens(), None);
    assert!(
        points_only
            .tensors()
            .iter()
            .all(|t| t.name.starts_with("point."))
    );
}
