//! A scene from landmarks alone: made without training, measured on pictures that it does not know, read back from its file.

#[path = "../train/room.rs"]
mod exact;

use landline::mapping::SceneError;
use landline::scene_file::{HeldOut, Precision, SceneFile, Timestamp, Units};
use landline_mapper::privacy::{Privacy, PrivacyError, hold_back};
use landline_mapper::reveals::{revealed, words};
use landline_mapper::teach::{
    Event, Observer, SceneRequest, TeachError, add_landmarks, measure_landmarks, scene_of_landmarks,
};
use nalgebra::Vector3;

#[derive(Default)]
struct Told(Vec<&'static str>);

impl Observer for Told {
    fn happened(&mut self, event: &Event<'_>) {
        self.0.push(match event {
            Event::Untrained { .. } => "untrained",
            Event::Landmarks(_) => "landmarks",
            _ => "other",
        });
    }
}

fn request() -> SceneRequest {
    SceneRequest {
        anchors: None,
        lines: true,
        hold_out_every: 4,
        licence: "CC0".to_owned(),
        created: Some(Timestamp::parse("2026-02-03T12:00:00Z").expect("a moment")),
        max_bytes: None,
        precision: Precision::Int8,
    }
}

#[test]
fn landmarks_alone_locate_what_they_do_not_know() {
    let mut labels = exact::labels(8);
    labels.map.gravity = Some(Vector3::new(0.0, 1.0, 0.0));
    let (request, mut told) = (request(), Told::default());
    let measured = measure_landmarks(&labels, &request, &mut told).expect("there are landmarks");
    let held_out = measured.expect("two pictures are kept back").held_out;
    assert_eq!((held_out.num_images, held_out.num_not_located), (2, 0));
    // Positions are exact; what is left is f16 in a room of two metres.
    let median = held_out.median_position.expect("all are located");
    assert!(median < 0.01, "{median}");

    let mut scene = scene_of_landmarks(&labels, &request, measured).expect("there are landmarks");
    add_landmarks(&mut scene, &labels.map, None, request.precision, &mut told).expect("they fit");
    assert_eq!(told.0, ["untrained", "landmarks"]);
    let bytes = scene.to_bytes(request.precision).expect("writes");
    let read = SceneFile::from_bytes(&bytes).expect("reads").info;
    assert_eq!(read.units, Units::Metres);
    assert_eq!(read.gravity, labels.map.gravity);
    assert_eq!(read.created, request.created);
    let training = read.training.expect("says how it came about");
    assert_eq!((training.num_steps, training.num_images), (0, 8));
    let of_file = training.held_out.expect("is written");
    assert_eq!(of_file.num_images, held_out.num_images);
    assert_eq!(of_file.median_position, held_out.median_position);
    // Numbers go through JSON, whose reader may miss the last bit.
    let turn = |h: &HeldOut| h.median_rotation_deg.expect("all are located");
    assert!((turn(&of_file) / turn(&held_out) - 1.0).abs() < 1e-12);
}

#[test]
fn a_map_without_points_is_no_scene() {
    let mut labels = exact::labels(8);
    labels.map.points.clear();
    let refused = scene_of_landmarks(&labels, &request(), None);
    assert!(
        matches!(refused, Err(TeachError::Scene(SceneError::Model(_)))),
        "{:?}",
        refused.err()
    );
}

/// Each choice gives a whole scene that tells less; what was measured of the other scene is gone.
#[test]
fn scenes_hold_back_what_they_are_told_to() {
    let labels = exact::labels(8);
    let (request, mut told) = (request(), Told::default());
    let measured = measure_landmarks(&labels, &request, &mut told).expect("there are landmarks");
    let mut whole = scene_of_landmarks(&labels, &request, measured).expect("there are landmarks");
    add_landmarks(&mut whole, &labels.map, None, request.precision, &mut told).expect("they fit");
    let num_bytes = whole.to_bytes(request.precision).expect("writes").len();
    let of = |choices: &[Privacy]| {
        let mut scene = whole.clone();
        hold_back(&mut scene, choices).expect("anchored");
        let bytes = scene.to_bytes(request.precision).expect("writes");
        (SceneFile::from_bytes(&bytes).expect("reads"), bytes.len())
    };
    let points = |scene: &SceneFile| scene.landmarks.as_ref().map(|t| t.point_positions.len());
    let lines = |scene: &SceneFile| scene.landmarks.as_ref().map(|t| t.line_positions.len());
    assert_eq!(
        of(&[]).0,
        SceneFile::from_bytes(&whole.to_bytes(request.precision).expect("writes")).expect("reads")
    );

    let (sparse, fewer_bytes) = of(&[Privacy::Sparse]);
    assert!(fewer_bytes < num_bytes);
    assert_eq!(points(&sparse), points(&whole).map(|n| n.div_ceil(4)));
    assert_eq!(lines(&sparse), lines(&whole).map(|n| n.div_ceil(4)));
    assert!(revealed(&sparse).map.points.len() * 3 < revealed(&whole).map.points.len());
    assert_eq!(sparse.info.training.expect("kept").held_out, None);

    let (no_lines, _) = of(&[Privacy::NoLines]);
    assert_eq!(lines(&no_lines), Some(0));
    assert!(lines(&whole) > Some(0));
    assert_eq!(revealed(&no_lines).map.segments.len(), 0);

    let (coarse, _) = of(&[Privacy::CoarseDescriptors]);
    let said = |scene: &SceneFile| words(scene, &revealed(scene)).join("; ");
    assert!(said(&coarse).contains("signs") && !said(&whole).contains("signs"));

    let (none, _) = of(&[Privacy::NoSecondLook]);
    assert_eq!(none.landmarks, None);
    assert!(
        said(&whole).contains("where the camera went")
            && !said(&none).contains("where the camera went")
    );

    let all = [
        Privacy::Sparse,
        Privacy::NoLines,
        Privacy::CoarseDescriptors,
        Privacy::NoSecondLook,
    ];
    assert!(of(&all).1 < fewer_bytes);

    // The order of two choices does not matter.
    assert_eq!(
        of(&[Privacy::NoLines, Privacy::Sparse]).0,
        of(&[Privacy::Sparse, Privacy::NoLines]).0
    );
    let attention = landline::models::RegressorConfig::preset(landline::models::Preset::Paper, 64);
    let mut other = SceneFile {
        config: attention,
        ..whole
    };
    let refused = hold_back(&mut other, &[Privacy::Sparse]);
    assert!(matches!(refused, Err(PrivacyError::Variant { .. })));
}
