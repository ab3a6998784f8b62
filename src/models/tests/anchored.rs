//! Branches whose coordinates come from a choice among landmarks.

use super::super::{
    AnchoredLineConfig, AnchoredPointConfig, AttentionLineConfig, AttentionOutput,
    AttentionPointConfig, LineBranchConfig, LinePool, PointBranchConfig, ports,
};
use super::{
    Long, Rows, assert_close, centre_logits, line_config, point_config, random_weights, run,
    unit_rows,
};
use crate::nn::Executor;

#[test]
fn anchored_branches_equal_their_definition() {
    for offset_hidden in [0, 4] {
        let config = AnchoredPointConfig {
            descriptor_channels: 6,
            num_anchors: 20,
            offset_hidden,
            reliability_hidden: 5,
        };
        let weights = random_weights(&config.tensors(), 23);
        let x = unit_rows(29, 15, 6);
        let expected: Vec<_> = x
            .iter()
            .map(|r| Long(&weights).anchored("point", "positions", 3, r))
            .collect();
        let branch = PointBranchConfig::Anchored(config);
        let made = branch.prepare(&mut weights.clone()).expect("prepares");
        let net = run(
            &branch.graph(15).expect("builds"),
            &made,
            &[(ports::POINTS, ports::DESCRIPTORS, &x, 1)],
        );
        let coordinates: Vec<f64> = expected.iter().flat_map(|e| e.0.clone()).collect();
        let logits: Vec<f64> = expected.iter().map(|e| e.1).collect();
        assert_close(
            "points",
            net.output(ports::COORDINATES).expect("output"),
            &coordinates,
        );
        assert_close(
            "logits",
            net.output(ports::LOGITS).expect("output"),
            &logits,
        );

        for (pool, key_channels) in [(LinePool::Mean, 6), (LinePool::Learned, 9)] {
            let config = AnchoredLineConfig {
                descriptor_channels: 6,
                tokens: 4,
                pool,
                key_channels,
                num_anchors: 20,
                offset_hidden,
                reliability_hidden: 5,
            };
            let weights = random_weights(&config.tensors(), 31);
            let tokens = unit_rows(37, 4 * 8, 6);
            let expected: Vec<_> = tokens
                .chunks_exact(4)
                .map(|t| {
                    let pooled: Vec<f64> = match weights.get("line.pool.w") {
                        None => (0..6)
                            .map(|c| t.iter().map(|r| r[c]).sum::<f64>() / 4.0)
                            .collect(),
                        Some(w) => {
                            let joined: Vec<f64> = t.iter().flatten().copied().collect();
                            w.to_f32()
                                .chunks_exact(24)
                                .map(|row| {
                                    row.iter()
                                        .zip(&joined)
                                        .map(|(w, x)| f64::from(*w) * x)
                                        .sum()
                                })
                                .collect()
                        }
                    };
                    let norm = pooled.iter().map(|v| v * v).sum::<f64>().sqrt();
                    let unit: Vec<f64> = pooled.iter().map(|v| v / norm).collect();
                    Long(&weights).anchored("line", "segments", 6, &unit)
                })
                .collect();
            let branch = LineBranchConfig::Anchored(config);
            let made = branch.prepare(&mut weights.clone()).expect("prepares");
            let net = run(
                &branch.graph(8).expect("builds"),
                &made,
                &[(ports::SEGMENTS, ports::TOKENS, &tokens, 4)],
            );
            let coordinates: Vec<f64> = expected.iter().flat_map(|e| e.0.clone()).collect();
            assert_close(
                "lines",
                net.output(ports::COORDINATES).expect("output"),
                &coordinates,
            );
        }
    }
}

const ANCHORED: AttentionOutput = AttentionOutput::Anchored {
    num_anchors: 20,
    reliability_hidden: 5,
};

fn unit(x: impl Iterator<Item = f64>) -> Vec<f64> {
    let x: Vec<f64> = x.collect();
    let norm = x.iter().map(|v| v * v).sum::<f64>().sqrt();
    x.iter().map(|v| v / norm).collect()
}

/// Coordinates and logit for a descriptor and the features that the attention layers made of it.
fn choose(long: &Long<'_>, prefix: &str, descriptor: &[f64], features: &[f64]) -> (Vec<f64>, f64) {
    let (values, width, depth) = match prefix {
        "point" => ("positions", 3, 3),
        _ => ("segments", 6, 2),
    };
    let shift = long.linear(&format!("{prefix}.query"), features);
    let query = unit(descriptor.iter().zip(&shift).map(|(d, s)| d + s));
    let (mut coordinates, logit) = long.anchored(prefix, values, width, &query);
    let offset = long.mlp(&format!("{prefix}.head"), depth, features);
    coordinates
        .iter_mut()
        .zip(offset)
        .for_each(|(c, o)| *c += o);
    (coordinates, logit)
}

#[test]
fn points_that_are_pruned_are_located_but_not_attended_to() {
    // A threshold of 0.52 lies at a logit of 0.080.
    for min_confidence in [0.52, 0.0] {
        let config = AttentionPointConfig {
            output: ANCHORED,
            min_confidence,
            ..point_config(6)
        };
        let mut weights = random_weights(&config.tensors(), 41);
        assert_eq!(
            weights.get("point.prune.0.w").is_some(),
            min_confidence > 0.0
        );
        let x = unit_rows(43, 30, 6);
        let inner: Rows = x
            .iter()
            .map(|r| Long(&weights).linear("point.in", r))
            .collect();
        let mut open = vec![true; 30];
        if min_confidence > 0.0 {
            let logits: Vec<f64> = inner
                .iter()
                .map(|r| Long(&weights).mlp("point.prune", 2, r)[0])
                .collect();
            centre_logits(&mut weights, "point.prune.1.b", &logits);
            let long = Long(&weights);
            let limit = (0.52f64 / 0.48).ln();
            open = inner
                .iter()
                .map(|r| long.mlp("point.prune", 2, r)[0] > limit)
                .collect();
            let num = open.iter().filter(|o| **o).count();
            assert!((1..15).contains(&num), "the case prunes: {num} of 30 left");
        }
        let long = Long(&weights);
        let mut features = inner;
        for i in 0..2 {
            let source: Rows = features
                .iter()
                .zip(&open)
                .filter(|(_, o)| **o)
                .map(|(r, _)| r.clone())
                .collect();
            features = long.attention_layer(&format!("point.attn.{i}"), &features, &source, 2);
        }
        let expected: Vec<_> = x
            .iter()
            .zip(&features)
            .map(|(d, f)| choose(&long, "point", d, f))
            .collect();

        let branch = PointBranchConfig::Attention(config);
        let made = branch.prepare(&mut weights.clone()).expect("prepares");
        let net = run(
            &branch.graph(40).expect("builds"),
            &made,
            &[(ports::POINTS, ports::DESCRIPTORS, &x, 1)],
        );
        let coordinates: Vec<f64> = expected.iter().flat_map(|e| e.0.clone()).collect();
        let logits: Vec<f64> = expected.iter().map(|e| e.1).collect();
        let got = net.output(ports::COORDINATES).expect("output");
        assert_close("points", got, &coordinates);
        assert_close(
            "logits",
            net.output(ports::LOGITS).expect("output"),
            &logits,
        );
    }
}

#[test]
fn segments_choose_and_are_pruned_by_their_reliability() {
    let config = AttentionLineConfig {
        output: ANCHORED,
        ..line_config(6)
    };
    let mut weights = random_weights(&config.tensors(), 47);
    let tokens = unit_rows(53, 4 * 8, 6);
    let choices = |long: &Long<'_>| -> Vec<(Vec<f64>, f64)> {
        let encoded: Rows = tokens
            .chunks_exact(4)
            .map(|t| long.line_encoder(&t.to_vec(), 2, true))
            .collect();
        let features = long.attention_layer("line.attn.0", &encoded, &encoded, 2);
        let descriptors = tokens
            .chunks_exact(4)
            .map(|t| unit((0..6).map(|c| t.iter().map(|r| r[c]).sum::<f64>() / 4.0)));
        descriptors
            .zip(&features)
            .map(|(d, f)| choose(long, "line", &d, f))
            .collect()
    };
    let logits: Vec<f64> = choices(&Long(&weights)).iter().map(|c| c.1).collect();
    centre_logits(&mut weights, "line.reliability.1.b", &logits);
    let expected = choices(&Long(&weights));
    let rows: Vec<usize> = (0..8).filter(|i| expected[*i].1 > 0.0).collect();
    assert!(!rows.is_empty() && rows.len() < 8, "the case prunes some");

    let branch = LineBranchConfig::Attention(config);
    let made = branch.prepare(&mut weights.clone()).expect("prepares");
    let net = run(
        &branch.graph(12).expect("builds"),
        &made,
        &[(ports::SEGMENTS, ports::TOKENS, &tokens, 4)],
    );
    let logits: Vec<f64> = expected.iter().map(|e| e.1).collect();
    assert_close(
        "logits",
        net.output(ports::LOGITS).expect("output"),
        &logits,
    );
    let got: Vec<usize> = net
        .output(ports::ROWS)
        .expect("output")
        .iter()
        .map(|r| *r as usize)
        .collect();
    assert_eq!(got, rows);
    let coordinates: Vec<f64> = rows.iter().flat_map(|i| expected[*i].0.clone()).collect();
    let got = net.output(ports::COORDINATES).expect("output");
    assert_close("segments", got, &coordinates);
}
