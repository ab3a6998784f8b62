//! A place of small rooms: each is one picture whose keypoints stand where they were put, described by random weights. So the
//! answers are known exactly.

use landline::front_end::{FrontEnd, FrontEndOptions};
use landline::geometry::{CamFromWorld, Camera};
use landline::image::GrayImage;
use landline::math::Rng;
use landline::models::landmarks::{Anchor, untrained};
use landline::models::{ExtractorKind, Preset, RegressorConfig};
use landline::place::{
    FileRef, Place, PlaceError, PlaceIndex, PlaceManifest, PlaceOptions, PlaceReport, Placed,
    RoomEntry,
};
use landline::relocalizer::{Relocalizer, RelocalizerOptions};
use landline::scene_file::{ExtractorFile, SceneFile, SceneInfo};
use landline::session::SessionQuery;
use landline_testkit::random_scene;
use nalgebra::Vector3;

const WIDTH: usize = 224;
const HEIGHT: usize = 160;

fn camera() -> Camera {
    Camera::centered(WIDTH as u32, HEIGHT as u32, 190.0)
}

/// Options that make an extractor of random weights find something.
fn lower(options: &mut FrontEndOptions) {
    options.keypoints.min_heat = 0.012;
    options.keypoints.max_keypoints = 200;
}

fn extractor() -> ExtractorFile {
    let kind = ExtractorKind::Xfeat;
    random_scene(
        kind,
        RegressorConfig::preset(Preset::Compact, kind.descriptor_channels()),
    )
    .1
}

/// Blocks of random brightness.
fn picture(seed: u64) -> GrayImage {
    let mut rng = Rng::from_seed(seed);
    let blocks: Vec<u8> = (0..WIDTH * HEIGHT / 16)
        .map(|_| rng.range(20.0, 235.0) as u8)
        .collect();
    let data = (0..WIDTH * HEIGHT)
        .map(|i| blocks[(i / WIDTH / 4) * (WIDTH / 4) + i % WIDTH / 4])
        .collect();
    GrayImage {
        data,
        width: WIDTH,
        height: HEIGHT,
    }
}

fn pose(seed: u64) -> CamFromWorld {
    let s = seed as f64;
    CamFromWorld::from_quaternion_wxyz([0.95, 0.1, 0.05 * s, -0.1], Vector3::new(0.2, s, -0.3))
}

/// The scene in which a picture was taken from [`pose`].
fn scene(seed: u64, extractor: &ExtractorFile) -> SceneFile {
    let mut options = FrontEndOptions::new(extractor.kind);
    lower(&mut options);
    let mut front_end = FrontEnd::new(extractor.clone(), options).expect("fits");
    let gray = picture(seed);
    let features = front_end.run(&gray.frame()).expect("a frame");
    assert!(
        features.keypoints.len() > 60,
        "{} keypoints",
        features.keypoints.len()
    );
    let mut rng = Rng::from_seed(seed + 50);
    let world_from_cam = pose(seed).inverse();
    let anchors: Vec<Anchor> = (0..features.keypoints.len())
        .map(|k| {
            let bearing = camera()
                .bearing_from_pixel(features.keypoints[k].pixel)
                .expect("in the picture");
            let point = world_from_cam.transform_point(&(rng.range(2.0, 6.0) * bearing));
            Anchor {
                key: features.descriptor(k).expect("a row").to_vec(),
                value: point.iter().map(|v| *v as f32).collect(),
            }
        })
        .collect();
    let (config, weights) =
        untrained(extractor.kind.descriptor_channels(), &anchors, &[]).expect("fits");
    SceneFile {
        info: SceneInfo::new(extractor.kind, extractor.source_sha256.clone()),
        config,
        weights,
        landmarks: None,
    }
}

fn file(url: &str) -> FileRef {
    FileRef {
        url: url.to_owned(),
        bytes: 1,
        sha256: "ab".repeat(32),
    }
}

/// A place of rooms of these seeds, in a row: each is beside the next.
fn place(seeds: &[u64], options: PlaceOptions) -> (Place, Vec<SceneFile>) {
    let extractor = extractor();
    let scenes: Vec<SceneFile> = seeds.iter().map(|s| scene(*s, &extractor)).collect();
    let ids: Vec<String> = (0..seeds.len()).map(|i| format!("room-{i}")).collect();
    let named: Vec<(&str, &SceneFile)> = ids.iter().map(String::as_str).zip(&scenes).collect();
    let index = PlaceIndex::build(&named).expect("builds");
    let mut manifest = PlaceManifest::for_scenes_like(&scenes[0].info, file("a.index"));
    for (i, id) in ids.iter().enumerate() {
        manifest.rooms.push(RoomEntry {
            id: id.clone(),
            name: None,
            scene: file(&format!("{id}.landline")),
            place_from_room: Some(Placed {
                qwxyz: [1.0, 0.0, 0.0, 0.0],
                t: [100.0 * i as f64, 0.0, 0.0],
                scale: 1.0,
            }),
            floor: None,
            neighbours: ids.get(i + 1).cloned().into_iter().collect(),
            outline: Vec::new(),
        });
    }
    let place = Place::new(manifest, index, extractor, options, |o| {
        lower(&mut o.front_end);
    })
    .expect("fits");
    (place, scenes)
}

fn query() -> SessionQuery<'static> {
    SessionQuery {
        camera: Some(camera()),
        ..SessionQuery::default()
    }
}

/// Locates, and brings the scenes that are wanted.
fn ask(place: &mut Place, scenes: &[SceneFile], seed: u64) -> PlaceReport {
    let gray = picture(seed);
    let mut clock = || 0.0;
    let mut report = place
        .locate(&gray.frame(), &query(), &mut clock)
        .expect("a frame");
    while !place.wanted().is_empty() {
        for room in place.wanted().to_vec() {
            place.put_room(room, scenes[room].clone()).expect("fits");
        }
        let again = place.resume(&query(), &mut clock).expect("a frame");
        report = again.expect("there was a frame");
    }
    report
}

#[test]
fn each_frame_is_found_in_its_room_as_in_that_scene_alone() {
    let seeds = [1, 2, 3, 4, 5, 6];
    let (mut place, scenes) = place(&seeds, PlaceOptions::default());
    for (room, seed) in seeds.into_iter().enumerate() {
        place.leave();
        let report = ask(&mut place, &scenes, seed);
        assert_eq!(
            report.room,
            Some(room),
            "{:?}",
            report.session.frame.outcome
        );
        assert!(report.has_entered);
        assert_eq!(place.ranking()[0].room, room);
        let found = *report.session.frame.outcome.located().expect("located");
        let (distance, angle) = found.cam_from_world.error_to(&pose(seed));
        assert!(distance < 2e-2 && angle < 5e-3, "{distance} {angle}");
        // In the place the rooms stand in a row.
        let in_place = report.cam_from_place.expect("is known").center_in_world();
        let shift = in_place - found.cam_from_world.center_in_world();
        assert!((shift - Vector3::new(100.0 * room as f64, 0.0, 0.0)).norm() < 1e-9);
        // The same to the last bit as without a place.
        let mut alone = Relocalizer::new(scenes[room].clone(), extractor(), |o| {
            o.front_end.tokens = FrontEndOptions::new(ExtractorKind::Xfeat).tokens;
            lower(&mut o.front_end);
        })
        .expect("fits");
        let gray = picture(seed);
        let query = landline::relocalizer::Query::with_camera(camera());
        let expected = alone
            .locate(&gray.frame(), &query, &mut || 0.0)
            .expect("a frame");
        let expected = expected.outcome.located().expect("located").cam_from_world;
        assert_eq!(found.cam_from_world, expected);
        // Once more: the room stays.
        let again = ask(&mut place, &scenes, seed);
        assert_eq!((again.room, again.has_entered), (Some(room), false));
        assert_eq!(
            again
                .session
                .frame
                .outcome
                .located()
                .map(|l| l.cam_from_world),
            Some(expected)
        );
    }
}

#[test]
fn twins_are_told_apart_by_nobody_and_that_is_said() {
    let (mut place, scenes) = place(&[1, 7, 7, 2], PlaceOptions::default());
    let report = ask(&mut place, &scenes, 7);
    assert_eq!(report.room, None);
    let mut rivals = report.rival.expect("two rooms claim it");
    rivals.sort_unstable();
    assert_eq!(rivals, [1, 2]);
    assert!(report.session.frame.outcome.located().is_none());
    // A room that has no twin is found as ever.
    assert_eq!(ask(&mut place, &scenes, 2).room, Some(3));
}

#[test]
fn walks_from_room_to_room_and_knows_what_lies_beside() {
    let (mut place, scenes) = place(&[1, 2, 3], PlaceOptions::default());
    assert_eq!(place.to_prefetch().count(), 0);
    assert!(ask(&mut place, &scenes, 1).has_entered);
    for room in 0..3 {
        place.drop_room(room).expect("goes");
    }
    assert_eq!(place.to_prefetch().collect::<Vec<_>>(), [1]);
    let report = ask(&mut place, &scenes, 2);
    assert_eq!((report.room, report.has_entered), (Some(1), true));
    // Nowhere: the room that the camera was in last stays the current one.
    let report = ask(&mut place, &scenes, 99);
    assert_eq!((report.room, report.has_entered), (None, false));
    assert_eq!(place.current(), Some(1));
}

#[test]
fn no_more_scenes_are_held_than_there_is_room_for() {
    let (mut whole, scenes) = place(&[1, 2, 3, 4, 5], PlaceOptions::default());
    for (room, scene) in scenes.iter().enumerate() {
        whole.put_room(room, scene.clone()).expect("fits");
    }
    let one = whole.num_bytes() / 5;
    let options = PlaceOptions {
        max_bytes: 3 * one + one / 2,
        candidates: 1,
        ..PlaceOptions::default()
    };
    let (mut place, scenes) = place(&[1, 2, 3, 4, 5], options);
    let mut found = 0;
    for round in 0..3 {
        for (room, seed) in [1, 2, 3, 4, 5].into_iter().enumerate() {
            let report = ask(&mut place, &scenes, seed);
            // Without landmarks the room of the frame before may claim it too, and which of the two it is stays open.
            assert!(report.room.is_none_or(|r| r == room), "round {round}");
            found += usize::from(report.room.is_some());
            assert!(place.num_bytes() <= options.max_bytes);
        }
    }
    assert!(found >= 5, "{found} of 15 frames are located");
}

#[test]
fn what_does_not_belong_together_is_refused_and_the_rest_goes_on() {
    let (mut place, scenes) = place(&[1, 2], PlaceOptions::default());
    let mut other = scenes[0].clone();
    other.info.extractor_sha256 = "cd".repeat(32);
    assert!(matches!(
        place.put_room(0, other),
        Err(PlaceError::Differs {
            what: "weights",
            ..
        })
    ));
    let mut larger = scenes[0].clone();
    larger.info.working_max_side = 800;
    assert!(matches!(
        place.put_room(0, larger),
        Err(PlaceError::Differs {
            what: "a working side of",
            ..
        })
    ));
    assert!(matches!(
        place.put_room(2, scenes[0].clone()),
        Err(PlaceError::NoRoom { .. })
    ));
    assert_eq!(ask(&mut place, &scenes, 2).room, Some(1));
    // An index of other rooms, and another extractor.
    let manifest = place.manifest().clone();
    let change = |_: &mut RelocalizerOptions| ();
    let options = PlaceOptions::default();
    let index = PlaceIndex::build(&[("room-0", &scenes[0])]).expect("builds");
    let refused = Place::new(manifest.clone(), index, extractor(), options, change);
    assert!(matches!(refused, Err(PlaceError::IndexRooms { .. })));
    let index =
        PlaceIndex::build(&[("room-0", &scenes[0]), ("room-1", &scenes[1])]).expect("builds");
    let mut foreign = extractor();
    foreign.source_sha256 = "cd".repeat(32);
    let refused = Place::new(manifest, index, foreign, options, change);
    assert!(matches!(refused, Err(PlaceError::Differs { .. })));
}
