//! Two steps of training, export, the file read back: the executor that ships must compute what the trainer does.

use crate::room;
use landline::models::{ExtractorKind, Preset, RegressorConfig};
use landline::nn::{WeightTensor, Weights};
use landline::regress::{Predictions, Regressor};
use landline::scene_file::{Precision, SceneFile, SceneInfo};
use landline_mapper::labels::Labels;
use landline_mapper::train::buffer::Buffer;
use landline_mapper::train::run::{Control, RunOptions, Trained, train};
use landline_mapper::train::session::{BranchConfig, Predicted, Session};
use landline_mapper::train::{cpu_device, recipe};
use nalgebra::Vector3;
use std::path::PathBuf;

/// Largest difference of coordinates in metres and of confidences. Both sides are single precision with sums in another order;
/// the choice multiplies a similarity's last digits by its sharpness.
const TOLERANCE: f64 = 2e-4;

pub(crate) fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("landline-train-{name}-{}", std::process::id()));
    // Of an earlier process with the same number.
    drop(std::fs::remove_dir_all(&folder));
    folder
}

pub(crate) fn options(preset: Preset, steps: usize, network: &[&str]) -> RunOptions {
    RunOptions {
        preset,
        seed: 5,
        minutes: None,
        steps: Some(steps),
        anchors: Some(64),
        lines: true,
        hold_out_every: 0,
        overrides: vec!["images=2".to_owned(), "rows=64".to_owned()],
        network: network.iter().map(|s| (*s).to_owned()).collect(),
    }
}

/// What the trainer's own forward pass makes of a picture with the delivered tensors.
fn predicted(
    labels: &Labels,
    trained: &Trained,
    preset: Preset,
    config: BranchConfig,
) -> Predicted {
    let kind = config.kind();
    let names: Vec<String> = config.tensors().into_iter().map(|s| s.name).collect();
    let values: Vec<Vec<f32>> = names
        .iter()
        .map(|name| {
            let found = trained.tensors.iter().find(|(spec, _)| spec.name == *name);
            found.expect("delivered").1.clone()
        })
        .collect();
    let recipe = recipe::recipe(preset, kind);
    let session = Session::new(
        config,
        recipe,
        &labels.map,
        &(0..0),
        trained.scale,
        1,
        &cpu_device(),
    )
    .with_averages(&values);
    let targets = labels.targets();
    let first = labels.pictures(&targets).take(1);
    let buffer = Buffer::new(kind, &labels.map, first, &trained.scale);
    session.predict(&buffer, 0)
}

fn check(name: &str, preset: Preset, network: &[&str]) {
    let labels = room::labels(4);
    let folder = folder(name);
    let control = Control {
        resume: false,
        stop: &|_| false,
    };
    let options = options(preset, 2, network);
    let trained =
        train(&labels, &options, &folder, &control, &cpu_device()).expect("trains two steps");
    let mut weights = Weights::new();
    for (spec, values) in &trained.tensors {
        let tensor = WeightTensor::f32(&spec.shape, values.clone()).expect("finite");
        weights.insert(spec.name.clone(), tensor);
    }
    let scene = SceneFile {
        info: SceneInfo {
            scale: trained.scale,
            ..SceneInfo::new(ExtractorKind::Xfeat, "0".repeat(64))
        },
        config: trained.config.clone(),
        weights,
        landmarks: None,
    };
    let bytes = scene.to_bytes(Precision::F32).expect("can be written");
    let scene = SceneFile::from_bytes(&bytes).expect("can be read");
    let mut regressor = Regressor::new(
        &scene.config,
        scene.weights.clone(),
        scene.info.scale,
        200,
        60,
    )
    .expect("fits");
    let mut out = Predictions::default();
    regressor
        .run(&labels.map.views[0].features, &mut out)
        .expect("runs");
    let RegressorConfig::Branches { point, line } = trained.config.clone() else {
        panic!("a preset has branches");
    };
    let compare =
        |what: &str, row: usize, found: &[Vector3<f64>], confidence: f32, p: &Predicted| {
            for (i, end) in found.iter().enumerate() {
                let at = (row * found.len() + i) * 3;
                let expected: Vec<f64> = p.coordinates[at..at + 3]
                    .iter()
                    .map(|v| f64::from(*v))
                    .collect();
                let off = (end - trained.scale.centre - Vector3::from_vec(expected)).norm();
                assert!(off < TOLERANCE, "{name}: {what} {row} is {off} m off");
            }
            let off = f64::from((confidence - p.confidence[row]).abs());
            assert!(
                off < TOLERANCE,
                "{name}: confidence of {what} {row} is {off} off"
            );
        };
    let p = predicted(&labels, &trained, preset, BranchConfig::Point(point));
    for (row, found) in out.point_rows.iter().zip(&out.points) {
        compare("point", *row, &[found.point_in_world], found.confidence, &p);
    }
    let l = predicted(
        &labels,
        &trained,
        preset,
        BranchConfig::Line(line.expect("lines")),
    );
    for (row, found) in out.segment_rows.iter().zip(&out.segments) {
        let ends = [found.start_in_world, found.end_in_world];
        compare("segment", *row, &ends, found.confidence, &l);
    }
    assert!(
        out.points.len() > 5 && out.segments.len() > 5,
        "{name}: {} points and {} segments are too few to tell",
        out.points.len(),
        out.segments.len()
    );
    std::fs::remove_dir_all(&folder).expect("made by the run");
}

#[test]
fn compact() {
    check("compact", Preset::Compact, &[]);
}

#[test]
fn standard_with_either_output() {
    let small = ["point.width=16", "point.head_hidden=[24]", "line.width=16"];
    // Half of the points are attended to.
    let with = |more: &[&'static str]| [&small[..], more].concat();
    check(
        "standard",
        Preset::Standard,
        &with(&["point.min_confidence=0.5"]),
    );
    let linear = [
        "point.output={\"kind\":\"linear\"}",
        "line.output={\"kind\":\"linear\"}",
        "point.min_confidence=0.5",
    ];
    check("linear", Preset::Standard, &with(&linear));
}

#[test]
fn paper() {
    check("paper", Preset::Paper, &["point.min_confidence=0.5"]);
}
