//! Labels from points and lines that came with the data set.

use crate::folder::Folder;
use crate::readers::read;
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

/// Left, top, right and bottom side of boxes that stand in no regular distance.
fn boxes() -> Vec<[u32; 4]> {
    (0..48)
        .map(|i| {
            let (column, row) = (i % 8, i / 8);
            let left = 12 + 78 * column + (7 * column * column + 11 * row) % 23;
            let top = 10 + 78 * row + (5 * row * row + 13 * column) % 19;
            [left, top, left + 31 + 3 * row, top + 29 + 2 * column]
        })
        .collect()
}

#[test]
fn segments_of_a_shrunk_picture_are_scaled_and_those_of_another_are_refused() {
    let folder = Folder::new();
    let boxes = boxes();
    let path = folder.text("images/a.png", "");
    image::GrayImage::from_fn(640, 480, |x, y| {
        let inside = |[l, t, r, b]: &[u32; 4]| (*l..*r).contains(&x) && (*t..*b).contains(&y);
        image::Luma([if boxes.iter().any(inside) { 220 } else { 40 }])
    })
    .save_with_format(path, image::ImageFormat::Png)
    .expect("writable");
    folder.text("poses.txt", "a.png 1 0 0 0 0 0 0 500\n");
    folder.text("limap/image_list.txt", "number of images, 1\n1, a.png\n");
    // Both upright sides and the upper one of each box, as a detector finds them in the picture at `shrink` of its size.
    let sides: Vec<[f64; 4]> = boxes
        .iter()
        .map(|side| side.map(f64::from))
        .flat_map(|[l, t, r, b]| [[l, t, l, b], [r, t, r, b], [l, t, r, t]])
        .collect();
    let write = |shrink: f64| {
        let lines: Vec<String> = sides
            .iter()
            .map(|side| side.map(|v| (shrink * v - 0.5).to_string()).join(" "))
            .collect();
        let text = format!("{}\n{}\n", lines.len(), lines.join("\n"));
        folder.text("limap/segments/segments_1.txt", &text);
    };
    let limap = folder.0.join("limap");
    let words = ["--lines", limap.to_str().expect("UTF-8")];
    for (shrink, note) in [(1.0, None), (0.5, Some("scaled by 2.0000"))] {
        write(shrink);
        let dataset = read(&folder.0, &words).expect("segments");
        let segments = &dataset.segments.as_ref().expect("came with them")[0];
        assert_eq!(segments.len(), sides.len());
        for (found, side) in segments.iter().zip(&sides) {
            assert!(
                found.iter().zip(side).all(|(a, b)| (a - b).abs() < 1e-6),
                "{shrink}: {found:?} is not {side:?}"
            );
        }
        let table = dataset.table().to_string();
        assert!(note.is_none_or(|note| table.contains(note)), "{table}");
        assert_eq!(table.contains("scaled by"), note.is_some(), "{table}");
    }
    // Of a picture three times as large, with nothing in it where these are: no size fits.
    folder.text(
        "limap/segments/segments_1.txt",
        "2\n1900 100 1900 200\n1000 1300 1100 1300\n",
    );
    let message = read(&folder.0, &words).expect_err("outside").to_string();
    assert!(message.contains("are they of these pictures?"), "{message}");
}
