//! Labels of a synthetic room with exact truth: points, lines, and the ways in which input can be wrong.

use crate::room::{Room, room};
use landline::geometry::{CamFromWorld, Camera, CameraAxes, Rigid};
use landline::mapping::{FilmParams, TrackError, map_film};
use landline::models::ExtractorKind;
use landline::reconstruction::motion::CameraGroup;
use landline::reconstruction::{LineTrack, Stage};
use landline_mapper::dataset::DatasetImage;
use landline_mapper::labels::{LabelError, Labels, Origin, TrackParams, TrackStats, build};
use landline_mapper::progress::Progress;
use nalgebra::{Matrix3, Rotation3, Vector3};

fn run(room: Room) -> Result<(Labels, TrackStats), LabelError> {
    let images: Vec<&DatasetImage> = room.images.iter().collect();
    build(
        &images,
        room.features,
        Origin::default(),
        &TrackParams::default(),
        Progress::Hidden,
    )
}

#[test]
fn points_and_lines_are_found_where_they_are() {
    let truth = room(24);
    let (points, lines) = (truth.points.clone(), truth.lines.clone());
    let (labels, stats) = run(truth).expect("a good data set");
    assert!(stats.num_points >= 230, "{stats}");
    assert!(stats.mean_error_px < 0.8, "{stats}");
    let agree = stats.agreement.expect("pictures follow each other");
    assert!(
        agree > 0.9 && !stats.to_string().contains("warning"),
        "{stats}"
    );
    // The 30 keypoints of nothing must not be labelled.
    assert!(
        stats.labelled_keypoints <= stats.keypoints - 29.0,
        "{stats}"
    );
    let mut far = 0;
    for track in &labels.map.points {
        let nearest = points
            .iter()
            .map(|(p, _)| (p - track.point_in_world).norm())
            .fold(f64::MAX, f64::min);
        far += usize::from(nearest > 0.02);
    }
    assert!(
        far <= 3,
        "{far} of {} points are off",
        labels.map.points.len()
    );

    assert!(stats.num_lines >= 26, "{stats}");
    for track in &labels.map.lines {
        let direction = (track.end_in_world - track.start_in_world).normalize();
        let best = lines
            .iter()
            .map(|([a, b], _)| {
                let d = (b - a).normalize();
                let off = |x: &Vector3<f64>| ((x - a) - d * (x - a).dot(&d)).norm();
                let angle = direction.dot(&d).abs().min(1.0).acos().to_degrees();
                (
                    off(&track.start_in_world).max(off(&track.end_in_world)),
                    angle,
                )
            })
            .fold((f64::MAX, 0.0), |m, x| if x.0 < m.0 { x } else { m });
        assert!(best.0 < 0.03 && best.1 < 2.0, "a line is off by {best:?}");
        let length = (track.end_in_world - track.start_in_world).norm();
        assert!((0.45..0.65).contains(&length), "length {length}");
    }
    // A target's ends are in the order of the segment's own ends.
    let mut num_targets = 0;
    let targets = labels.targets();
    for image in labels.pictures(&targets) {
        let cam_from_world = image.view.cam_from_world.expect("posed");
        for (segment, target) in image.features.segments.iter().zip(&image.targets.segments) {
            let Some(target) = target else { continue };
            let ends = labels.map.segment_target_ends(*target).expect("exists");
            let pixel = |p: &Vector3<f64>| {
                let in_cam = cam_from_world.transform_point(p);
                image.view.camera.pixel_from_cam(&in_cam).expect("in front")
            };
            let (a, b) = (pixel(&ends[0]), pixel(&ends[1]));
            let along = (segment.end.x - segment.start.x) * (b.x - a.x)
                + (segment.end.y - segment.start.y) * (b.y - a.y);
            assert!(along > 0.0, "{} has a reversed target", image.view.name);
            num_targets += 1;
        }
    }
    assert!(num_targets > 24 * 15, "{num_targets}");
}

#[test]
fn the_same_input_gives_the_same_labels() {
    let (a, _) = run(room(16)).expect("good");
    let (b, _) = run(room(16)).expect("good");
    assert_eq!(a, b);
}

#[test]
fn poses_of_another_convention_are_named() {
    for (what, change) in [
        (
            "--pose-direction",
            (|t: CamFromWorld| {
                let inverse = t.inverse();
                Rigid::new(inverse.rotation, inverse.translation)
            }) as fn(CamFromWorld) -> CamFromWorld,
        ),
        ("OpenGL axes", |t| {
            let flip = Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into());
            CamFromWorld::new(flip * t.rotation, flip * t.translation)
        }),
        ("use --camera-axes ros", |t| in_axes(&t, "ros")),
        ("use --camera-axes down-left-forward", |t| {
            in_axes(&t, "down-left-forward")
        }),
        (
            "use the other --pose-direction and --camera-axes opengl",
            |t| {
                let inverse = in_axes(&t, "opengl").inverse();
                Rigid::new(inverse.rotation, inverse.translation)
            },
        ),
        ("use --quaternions xyzw", |t| {
            let [w, x, y, z] = t.quaternion_wxyz();
            CamFromWorld::from_quaternion_wxyz([x, y, z, w], t.translation)
        }),
        ("if they are mirrored: poses of a left-handed world", |t| {
            left_handed(&t)
        }),
        ("if they are mirrored and world from camera", |t| {
            let inverse = left_handed(&t).inverse();
            Rigid::new(inverse.rotation, inverse.translation)
        }),
    ] {
        let mut bad = room(24);
        // Turn the world first, so that a camera near the origin does not make inverted poses look alike.
        let world = Rotation3::from_euler_angles(0.4, 1.1, -0.7).into_inner();
        for image in &mut bad.images {
            let t = image.cam_from_world.expect("posed");
            let turned = CamFromWorld::new(t.rotation * world, t.translation);
            image.cam_from_world = Some(change(turned));
        }
        let message = run(bad).expect_err("the poses are wrong").to_string();
        assert!(
            message.contains("contradict the pictures") && message.contains(what),
            "{message}"
        );
    }
}

/// A pose of a camera with other axes.
fn in_axes(t: &CamFromWorld, axes: &str) -> CamFromWorld {
    let axes: CameraAxes = axes.parse().expect("known");
    let turn = axes.ours_from_file.transpose();
    CamFromWorld::new(turn * t.rotation, turn * t.translation)
}

#[test]
fn intrinsics_of_another_lens_and_poses_of_the_next_picture_are_named() {
    let mut long = room(24);
    for image in &mut long.images {
        image.camera = Camera::centered(640, 480, 1.3 * 500.0);
    }
    let message = run(long).expect_err("too long").to_string();
    assert!(message.contains("about 0.77 times"), "{message}");

    let mut shifted = room(24);
    let poses: Vec<_> = shifted.images.iter().map(|i| i.cam_from_world).collect();
    for (image, pose) in shifted.images.iter_mut().zip(poses.iter().skip(1)) {
        image.cam_from_world = *pose;
    }
    let message = run(shifted).expect_err("shifted").to_string();
    assert!(message.contains("picture after each one"), "{message}");
}

#[test]
fn poses_of_no_picture_are_refused_unless_they_are_trusted() {
    let mut mixed = room(24);
    let mut poses: Vec<_> = mixed.images.iter().map(|i| i.cam_from_world).collect();
    poses.rotate_left(11);
    poses.swap(2, 9);
    poses.swap(4, 17);
    poses.swap(1, 20);
    for (image, pose) in mixed.images.iter_mut().zip(poses) {
        image.cam_from_world = pose;
    }
    let images = mixed.images.clone();
    let features = mixed.features.clone();
    let error = run(mixed).expect_err("mixed");
    println!("{error}");
    let images: Vec<&DatasetImage> = images.iter().collect();
    let params = TrackParams {
        trust_poses: true,
        ..TrackParams::default()
    };
    let trusted = build(
        &images,
        features,
        Origin::default(),
        &params,
        Progress::Hidden,
    );
    assert!(
        !matches!(
            trusted,
            Err(LabelError::Tracks(
                TrackError::PoseConvention { .. } | TrackError::PosesContradicted { .. }
            ))
        ),
        "what is trusted is not judged"
    );
}

/// A pose as Unity writes it: y up in world and camera.
fn left_handed(t: &CamFromWorld) -> CamFromWorld {
    let mirror = Matrix3::from_diagonal(&[1.0, -1.0, 1.0].into());
    CamFromWorld::new(mirror * t.rotation * mirror, mirror * t.translation)
}

#[test]
fn mirrored_pictures_are_named() {
    let mut bad = room(24);
    for features in &mut bad.features {
        for keypoint in &mut features.keypoints {
            keypoint.pixel.x = 640.0 - keypoint.pixel.x;
        }
        for segment in &mut features.segments {
            segment.start.x = 640.0 - segment.start.x;
            segment.end.x = 640.0 - segment.end.x;
        }
    }
    let message = run(bad).expect_err("mirrored").to_string();
    assert!(message.contains("mirror the pictures back"), "{message}");
}

#[test]
fn one_picture_no_pose_and_no_overlap_are_told_apart() {
    let message = run(room(1)).expect_err("one picture").to_string();
    assert!(
        message.contains("at least two training pictures") && message.contains("there are 1"),
        "{message}"
    );

    let mut unposed = room(5);
    for image in &mut unposed.images {
        image.cam_from_world = None;
    }
    assert!(matches!(
        run(unposed),
        Err(LabelError::Tracks(TrackError::TooFewPictures(0)))
    ));

    // Cameras that look in opposite directions, far from each other.
    let mut apart = room(2);
    let half_turn = Matrix3::from_diagonal(&[-1.0, 1.0, -1.0].into());
    apart.images[1].cam_from_world =
        Some(CamFromWorld::new(half_turn, Vector3::new(0.0, 0.0, -50.0)));
    let message = run(apart).expect_err("no overlap").to_string();
    assert!(message.contains("see the same things"), "{message}");
}

#[test]
fn pictures_that_belong_to_other_poses_give_no_labels() {
    let mut mixed = room(24);
    mixed.features.rotate_left(11);
    mixed.features.swap(2, 9);
    mixed.features.swap(4, 17);
    match run(mixed) {
        Err(LabelError::Tracks(
            TrackError::NoOverlap { .. }
            | TrackError::PoseConvention { .. }
            | TrackError::PosesContradicted { .. },
        )) => {}
        Err(other) => panic!("unexpected: {other}"),
        Ok((_, stats)) => assert!(
            stats.labelled_keypoints < 0.3 * stats.keypoints,
            "wrong poses must not look good: {stats}"
        ),
    }
}

/// What a page exports of its film is what training reads.
#[test]
fn labels_of_a_film_come_through_the_file() {
    let (mut views, poses) = landline_testkit::film_pictures();
    for (view, pose) in views.iter_mut().zip(&poses) {
        view.cam_from_world = Some(*pose);
    }
    let before = views.clone();
    let group = CameraGroup::given(landline_testkit::film_camera());
    let mut go_on = |_: Stage, _: usize, _: usize| true;
    let params = FilmParams::default();
    let map = pollster::block_on(map_film(&views, &group, &params, &mut go_on)).expect("a map");
    let origin = Origin {
        extractor_sha256: "ab".repeat(32),
        source: "a film".to_owned(),
        ..Origin::default()
    };
    let bytes = map.labels(&mut views, &origin).expect("all have a pose");
    assert_eq!(views, before, "features were only lent");
    let path = std::env::temp_dir().join(format!("film-{}.labels", std::process::id()));
    std::fs::write(&path, bytes).expect("writable");
    let read = Labels::read_for(&path, ExtractorKind::Xfeat, &origin.extractor_sha256);
    std::fs::remove_file(&path).expect("exists");
    let read = read.expect("a label file");
    assert_eq!(read.origin, origin);
    assert_eq!(read.map.units, map.units);
    assert_eq!(read.map.views.len(), views.len());
    for (own, view) in read.map.views.iter().zip(&views) {
        assert_eq!(own.name, view.name);
        let (pose, was) = own.cam_from_world.zip(view.cam_from_world).expect("poses");
        // Reading makes rotations orthonormal once more.
        let numbers = pose.to_row_major().into_iter().zip(was.to_row_major());
        assert!(numbers.fold(0.0, |off: f64, (a, b)| off.max((a - b).abs())) < 1e-12);
        assert_eq!(own.camera, map.main_camera());
        assert_eq!(own.features.descriptors_nd, view.features.descriptors_nd);
        assert_eq!(own.features.segments, view.features.segments);
    }
    assert!(map.points.len() > 100 && !map.lines.is_empty());
    let points = read.map.points.iter().zip(&map.points);
    assert!(points.len() == map.points.len());
    for (own, point) in points {
        assert_eq!(own.point_in_world, point.point_in_world);
        assert_eq!(own.observations, point.observations);
    }
    let seen = |lines: &[LineTrack]| -> Vec<_> {
        lines
            .iter()
            .map(|l| (l.start_in_world, l.observations.clone()))
            .collect()
    };
    assert_eq!(seen(&read.map.lines), seen(&map.lines));
}
