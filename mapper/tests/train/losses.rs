//! Each loss against numbers worked out by hand, alone and in a step of the paper's recipe.

use crate::room;
use burn::tensor::{Tensor, TensorData};
use landline::geometry::{SceneScale, Units};
use landline::models::{Preset, RegressorConfig};
use landline_mapper::labels::Labels;
use landline_mapper::train::buffer::{Buffer, Kind};
use landline_mapper::train::loss::{self, ObservationRows};
use landline_mapper::train::params::numbers;
use landline_mapper::train::session::{BranchConfig, Session, StepReport};
use landline_mapper::train::{cpu_device, recipe};

fn rows<const N: usize>(values: &[[f32; N]]) -> Tensor<2> {
    let flat: Vec<f32> = values.iter().flatten().copied().collect();
    Tensor::from_data(TensorData::new(flat, [values.len(), N]), &cpu_device())
}

fn close(found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len());
    for (f, e) in found.iter().zip(expected) {
        assert!(
            (f - e).abs() <= 2e-5 * e.abs().max(1.0),
            "{found:?} instead of {expected:?}"
        );
    }
}

/// A camera at the origin that looks along z, focal length 100.
fn at_origin(observed: Vec<f32>, count: usize) -> loss::Observations {
    ObservationRows {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0].repeat(count),
        translation: vec![0.0; 3 * count],
        focal_px: vec![100.0; count],
        observed,
    }
    .to_device(&cpu_device())
}

#[test]
fn distances() {
    let d = loss::distance(
        rows(&[[1.0, 2.0, 2.0], [0.0; 3]]),
        rows(&[[0.0; 3], [3.0, 0.0, 4.0]]),
    );
    close(&numbers(&d), &[3.0, 5.0]);
    // Over all six numbers of a segment: sqrt(9 + 16).
    let d = loss::distance(rows(&[[0.0, 0.0, 3.0, 4.0, 0.0, 0.0]]), rows(&[[0.0; 6]]));
    close(&numbers(&d), &[5.0]);
}

#[test]
fn reprojection_of_points() {
    // (0.2, -0.1, 2) projects to (0.1, -0.05); observed at (0.07, -0.01): (3, -4) pixels off. One point is behind the camera.
    let o = at_origin(vec![0.07, -0.01, 0.0, 0.0], 2);
    let [error, depth, usable] =
        loss::point_reprojection(rows(&[[0.2, -0.1, 2.0], [0.0, 0.0, -1.0]]), &o);
    close(&numbers(&error)[..1], &[5.0]);
    close(&numbers(&depth), &[2.0, -1.0]);
    close(&numbers(&usable), &[1.0, 0.0]);
    // 1,000 pixels are the limit: 0.3 / 0.1 * 100 = 300 counts, 1.1 / 0.1 * 100 = 1,100 does not.
    let o = at_origin(vec![0.0; 4], 2);
    let [error, _, usable] =
        loss::point_reprojection(rows(&[[0.3, 0.0, 0.1], [1.1, 0.0, 0.1]]), &o);
    close(&numbers(&error), &[300.0, 1100.0]);
    close(&numbers(&usable), &[1.0, 0.0]);
}

#[test]
fn reprojection_of_segments() {
    // The observed line is y = 0.1 at depth one. The ends project to y = 0.12 and y = 0.07: 2 and 3 pixels off; where they lie
    // along the line does not matter.
    let o = at_origin(vec![0.0, 1.0, -0.1], 1);
    let ends = [[0.3, 0.24, 2.0, -5.0, 0.28, 4.0]];
    let [error, depth, usable] = loss::segment_reprojection(rows(&ends), &o);
    close(&numbers(&error), &[5.0]);
    close(&numbers(&depth), &[3.0]);
    close(&numbers(&usable), &[1.0]);
    let [_, _, usable] = loss::segment_reprojection(rows(&[[0.0, 0.2, 2.0, 0.0, 0.2, 0.05]]), &o);
    close(&numbers(&usable), &[0.0]);
}

#[test]
fn clamp_cross_entropy_and_means() {
    // 2 tanh(1) and 2 tanh(5).
    close(
        &numbers(&loss::clamped(rows(&[[2.0], [10.0]]), 2.0)),
        &[1.523_188_3, 1.999_818_4],
    );
    // ln 2; ln(1 + e^-2) for the right side, 2 more for the wrong one; and no overflow.
    let entropy = loss::cross_entropy(
        rows(&[[0.0], [2.0], [2.0], [-90.0]]),
        rows(&[[1.0], [1.0], [0.0], [1.0]]),
    );
    close(
        &numbers(&entropy),
        &[std::f32::consts::LN_2, 0.126_928, 2.126_928, 90.0],
    );
    let mean = loss::weighted_mean(rows(&[[1.0], [5.0], [9.0]]), rows(&[[1.0], [1.0], [0.0]]));
    close(&numbers(&mean), &[3.0]);
    close(
        &numbers(&loss::weighted_mean(rows(&[[1.0]]), rows(&[[0.0]]))),
        &[0.0],
    );
}

/// The report of a step of the paper's recipe in the middle of the run, by a network whose every weight is zero, so that it
/// answers with its last biases: these coordinates and this logit.
fn constant_step(
    labels: &Labels,
    kind: Kind,
    coordinates: &[f32],
    logit: f32,
    network_unit: f64,
) -> StepReport {
    let RegressorConfig::Branches { point, line } = RegressorConfig::preset(Preset::Paper, room::D)
    else {
        panic!("the preset has branches");
    };
    let config = match kind {
        Kind::Points => BranchConfig::Point(point),
        Kind::Segments => BranchConfig::Line(line.expect("the preset has lines")),
    };
    let mut recipe = recipe::recipe(Preset::Paper, kind);
    recipe.steps = 10;
    let scale = SceneScale {
        scale: network_unit,
        ..SceneScale::default()
    };
    let device = cpu_device();
    let mut session = Session::new(config, recipe, &labels.map, &(0..0), scale, 1, &device);
    let prefix = match kind {
        Kind::Points => "point",
        Kind::Segments => "line",
    };
    let last = session
        .parameters()
        .specs()
        .filter_map(|s| s.name.strip_prefix(&format!("{prefix}.head.")))
        .filter_map(|s| s.strip_suffix(".b"))
        .max()
        .expect("there is a head")
        .to_owned();
    let (state, _) = session.parameters().state();
    let take = |name: &str| {
        let len = state
            .iter()
            .find(|(n, _)| n == name)
            .map(|(_, v)| v.len())?;
        Some(if name.ends_with(&format!("{prefix}.head.{last}.b")) {
            coordinates.iter().map(|c| c / 2.0).collect()
        } else if name.ends_with(&format!("{prefix}.prune.1.b")) {
            vec![logit]
        } else {
            vec![0.0; len]
        })
    };
    session
        .parameters_mut()
        .restore(take, 0)
        .expect("own state");
    session.step = 6;
    let targets = labels.targets();
    let buffer = Buffer::new(kind, &labels.map, labels.pictures(&targets), &scale);
    session.train_step(&buffer)
}

/// The clamp at t = 0.6: sqrt(1 - 0.36) * 50 + 1.
const CLAMP: f64 = 41.0;

fn expect(report: &StepReport, distances: &[f64], pixels: &[f64], num: usize, logit: f64) {
    let n = distances.len() as f64;
    let sum: f64 = distances.iter().sum();
    let clamped = pixels
        .iter()
        .map(|e| CLAMP * (e / CLAMP).tanh())
        .sum::<f64>()
        / n;
    let per_row = |target: f64| (1.0 + (-logit.abs()).exp()).ln() + logit.max(0.0) - logit * target;
    let entropy = (n * per_row(1.0) + (num as f64 - n) * per_row(0.0)) / num as f64;
    let close = |what: &str, found: f64, expected: f64| {
        assert!(
            (found - expected).abs() < 1e-4 * expected,
            "{what}: {found}, not {expected}"
        );
    };
    close("mean distance", report.scene, sum / n);
    close("reprojection", report.reprojection_px, clamped);
    close("cross-entropy", report.reliability, entropy);
    // The sum of the distances, the means of the others (the reference's reductions).
    close("total", report.total, sum + clamped + entropy);
}

#[test]
fn a_step_of_the_papers_recipe_on_points() {
    let labels = room::labels(1);
    let view = &labels.map.views[0];
    let keypoints = &view.features.keypoints;
    let cam_from_world = view.cam_from_world.expect("a pose");
    let at = [0.1f32, -0.2, 2.5];
    let report = constant_step(&labels, Kind::Points, &at, 0.7, 2.0);
    let p = nalgebra::Vector3::new(0.1, -0.2, 2.5);
    let seen = view
        .camera
        .pixel_from_cam(&cam_from_world.transform_point(&p))
        .expect("in front");
    let labelled = || keypoints.iter().zip(&labels.map.points);
    let distances: Vec<f64> = labelled()
        .map(|(_, t)| (p - t.point_in_world).norm())
        .collect();
    let pixels: Vec<f64> = labelled().map(|(k, _)| k.pixel.distance(seen)).collect();
    // One image a step; the recipe draws all of its points, filled up with rows that count nowhere.
    expect(&report, &distances, &pixels, keypoints.len(), 0.7);
}

#[test]
fn a_step_of_the_papers_recipe_on_segments() {
    let labels = room::labels(1);
    let view = &labels.map.views[0];
    let segments = &view.features.segments;
    let cam_from_world = view.cam_from_world.expect("a pose");
    let at = [0.1f32, -0.2, 2.5, -0.4, 0.3, 3.0];
    let report = constant_step(&labels, Kind::Segments, &at, -0.3, 2.0);
    let ends = [
        nalgebra::Vector3::new(0.1, -0.2, 2.5),
        nalgebra::Vector3::new(-0.4, 0.3, 3.0),
    ];
    let seen = ends.map(|p| {
        let in_cam = cam_from_world.transform_point(&p);
        view.camera.pixel_from_cam(&in_cam).expect("in front")
    });
    let (mut distances, mut pixels) = (Vec::new(), Vec::new());
    for (s, t) in segments.iter().zip(&labels.map.lines) {
        let d =
            (ends[0] - t.start_in_world).norm_squared() + (ends[1] - t.end_in_world).norm_squared();
        distances.push(d.sqrt());
        let (dx, dy) = (s.end.x - s.start.x, s.end.y - s.start.y);
        let off = |p: &landline::geometry::Pixel| {
            ((p.x - s.start.x) * dy - (p.y - s.start.y) * dx).abs() / dx.hypot(dy)
        };
        pixels.push(off(&seen[0]) + off(&seen[1]));
    }
    expect(&report, &distances, &pixels, segments.len(), -0.3);
}

/// The room in another unit of length, which nobody names.
fn in_units(size: f64) -> Labels {
    let mut labels = room::labels(1);
    labels.map.units = Units::Arbitrary;
    for view in &mut labels.map.views {
        let pose = view.cam_from_world.as_mut().expect("a pose");
        pose.translation *= size;
    }
    for point in &mut labels.map.points {
        point.point_in_world *= size;
    }
    for line in &mut labels.map.lines {
        line.start_in_world *= size;
        line.end_in_world *= size;
    }
    labels
}

#[test]
fn worlds_of_millimetres_and_of_kilometres_train_like_the_room_in_metres() {
    let at = [0.1f32, -0.2, 2.5, -0.4, 0.3, 3.0];
    for (kind, len) in [(Kind::Points, 3), (Kind::Segments, 6)] {
        let room = constant_step(&room::labels(1), kind, &at[..len], 0.7, 2.0);
        assert!(room.reprojection_px > 0.0, "{room:?}");
        for size in [1e3, 1e-3] {
            let other = constant_step(&in_units(size), kind, &at[..len], 0.7, 2.0 * size);
            for (found, expected) in [
                (other.scene, size * room.scene),
                (other.reprojection_px, room.reprojection_px),
                (other.total, room.total),
            ] {
                assert!(
                    (found - expected).abs() < 1e-4 * expected,
                    "{kind:?} at {size}: {other:?}, not {room:?}"
                );
            }
        }
    }
}
