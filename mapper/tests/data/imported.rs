//! Labels from points and lines that came with the data set.

use crate::room::{Room, room};
use landline::scene_file::Units;
use landline_mapper::dataset::{Dataset, DatasetImage, ModelLine, ModelPoint};
use landline_mapper::labels::{Imported, Labels, Origin, TrackParams, TrackStats, build_from};
use landline_mapper::progress::Progress;

/// The room as a reader would deliver it, with its exact points seen at exact pixels, and its exact lines.
fn dataset(room: &Room) -> Dataset {
    let seen = |p: &nalgebra::Vector3<f64>, image: &DatasetImage| {
        let in_cam = image.cam_from_world?.transform_point(p);
        let pixel = image.camera.pixel_from_cam(&in_cam)?;
        let is_inside = pixel.x > 0.0 && pixel.y > 0.0 && pixel.x < 640.0 && pixel.y < 480.0;
        is_inside.then_some(pixel)
    };
    let images = || room.images.iter().enumerate();
    let mut dataset = Dataset::empty("test");
    dataset.units = Units::Metres;
    dataset.images = room.images.clone();
    dataset.points = room
        .points
        .iter()
        .map(|(p, _)| ModelPoint {
            point_in_world: *p,
            observations: images()
                .filter_map(|(i, image)| Some((i, seen(p, image)?)))
                .collect(),
        })
        .collect();
    dataset.lines = room
        .lines
        .iter()
        .enumerate()
        .map(|(l, ([a, b], _))| ModelLine {
            start_in_world: *a,
            end_in_world: *b,
            observations: room
                .segment_lines
                .iter()
                .enumerate()
                .flat_map(|(i, shown)| {
                    let segments = shown.iter().enumerate();
                    segments
                        .filter(move |(_, line)| **line == l)
                        .map(move |(s, _)| (i, s))
                })
                .collect(),
        })
        .collect();
    dataset
}

fn labels(
    room: &Room,
    dataset: &Dataset,
    positions: &[usize],
    with_points: bool,
) -> (Labels, TrackStats) {
    let images: Vec<&DatasetImage> = positions.iter().map(|i| &dataset.images[*i]).collect();
    let features = positions
        .iter()
        .map(|i| room.features[*i].clone())
        .collect();
    let imported = Imported::new(dataset, positions, with_points).expect("has points");
    build_from(
        &images,
        features,
        Origin::default(),
        &imported,
        &TrackParams::default(),
        Progress::Hidden,
    )
    .expect("a good data set")
}

/// How many of the room's lines some of the pictures show.
fn num_shown(room: &Room, positions: &[usize]) -> usize {
    let shown = positions.iter().flat_map(|i| &room.segment_lines[*i]);
    shown.collect::<std::collections::HashSet<_>>().len()
}

#[test]
fn targets_are_the_points_and_lines_of_the_data_set() {
    let room = room(12);
    let dataset = dataset(&room);
    // Positions of the data set are not those of the labelled pictures.
    let positions = [1, 2, 4, 5, 6, 8, 9, 11];
    let (labels, stats) = labels(&room, &dataset, &positions, true);
    // All but the 30 keypoints of nothing, of which a few lie on a point by chance.
    assert!(stats.labelled_keypoints > stats.keypoints - 34.0, "{stats}");
    assert!(stats.mean_error_px < 0.8, "{stats}");
    for track in &labels.map.points {
        assert!(room.points.iter().any(|(p, _)| *p == track.point_in_world));
        for o in &track.observations {
            let view = &labels.map.views[o.view as usize];
            let cam_from_world = view.cam_from_world.expect("posed");
            let in_cam = cam_from_world.transform_point(&track.point_in_world);
            let pixel = view.camera.pixel_from_cam(&in_cam).expect("in front");
            let keypoint = view.features.keypoints[o.feature as usize];
            assert!(pixel.distance(keypoint.pixel) < 3.0);
        }
    }
    assert_eq!(labels.map.lines.len(), num_shown(&room, &positions));
    let targets = labels.targets();
    for (labelled, position) in labels.pictures(&targets).zip(positions) {
        assert_eq!(labelled.view.name, dataset.images[position].name);
        for (target, line) in labelled
            .targets
            .segments
            .iter()
            .zip(&room.segment_lines[position])
        {
            let target = target.expect("every segment shows a line");
            assert_eq!(
                labels.map.lines[target.track as usize].start_in_world,
                room.lines[*line].0[0]
            );
        }
    }
}

#[test]
fn points_may_be_triangulated_beside_imported_lines() {
    let room = room(24);
    let dataset = dataset(&room);
    let positions: Vec<usize> = (0..24).collect();
    let (labels, stats) = labels(&room, &dataset, &positions, false);
    assert!(stats.num_matches > 0 && stats.num_points >= 230, "{stats}");
    assert_eq!(labels.map.lines.len(), num_shown(&room, &positions));
}

#[test]
fn a_data_set_without_points_says_so() {
    let room = room(3);
    let mut dataset = dataset(&room);
    dataset.points.clear();
    let message = Imported::new(&dataset, &[0, 1, 2], true)
        .expect_err("no points")
        .to_string();
    assert!(message.contains("--points-from"), "{message}");
}
