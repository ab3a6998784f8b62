//! Labels of a synthetic room with exact truth: points, lines, and the ways in which input can be wrong.

use landline::geometry::{CamFromWorld, Camera, Pixel, Rigid, Segment2};
use landline::math::Rng;
use landline_mapper::dataset::{DatasetImage, Split};
use landline_mapper::feature_cache::ImageFeatures;
use landline_mapper::labels::{LabelError, LabelParams, LabelStats, Labels, build};
use landline_mapper::progress::Progress;
use nalgebra::{Matrix3, Rotation3, Vector3};

const D: usize = 32;
const SAMPLES: usize = 12;
const NOISE_PX: f64 = 0.4;

struct Room {
    points: Vec<(Vector3<f64>, Vec<f32>)>,
    lines: Vec<([Vector3<f64>; 2], Vec<f32>)>,
    images: Vec<DatasetImage>,
    features: Vec<ImageFeatures>,
}

fn unit(rng: &mut Rng) -> Vec<f32> {
    let v: Vec<f64> = (0..D).map(|_| rng.normal()).collect();
    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.iter().map(|x| (x / norm) as f32).collect()
}

fn noisy(rng: &mut Rng, descriptor: &[f32]) -> Vec<f32> {
    let v: Vec<f32> = descriptor
        .iter()
        .map(|x| x + 0.03 * rng.normal() as f32)
        .collect();
    let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    v.iter().map(|x| x / norm).collect()
}

/// Cameras on an arc that look into a box of points and lines.
fn room(num_images: usize) -> Room {
    let mut rng = Rng::from_seed(7);
    let inside = |rng: &mut Rng| {
        Vector3::new(
            rng.range(-1.5, 1.5),
            rng.range(-1.0, 1.0),
            rng.range(1.5, 3.5),
        )
    };
    let points: Vec<_> = (0..250)
        .map(|_| (inside(&mut rng), unit(&mut rng)))
        .collect();
    let lines: Vec<_> = (0..30)
        .map(|_| {
            let a = inside(&mut rng);
            let direction = Vector3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            ([a, a + 0.6 * direction], unit(&mut rng))
        })
        .collect();
    let camera = Camera::centered(640, 480, 500.0);
    let mut images = Vec::new();
    let mut features = Vec::new();
    for i in 0..num_images {
        let s = i as f64 / 23.0 - 0.5;
        let center = Vector3::new(1.2 * s, 0.15 * (7.0 * s).sin(), 0.3 * s * s);
        let rotation = Rotation3::from_euler_angles(0.05 * (5.0 * s).cos(), 0.35 * s, 0.04 * s);
        let r = *rotation.matrix();
        let pose = CamFromWorld::new(r, -(r * center));
        let project = |p: &Vector3<f64>| {
            camera
                .pixel_from_cam(&pose.transform_point(p))
                .filter(|q| q.x > 0.0 && q.y > 0.0 && q.x < 640.0 && q.y < 480.0)
        };
        let mut f = ImageFeatures {
            descriptor_len: D,
            ..ImageFeatures::default()
        };
        let jitter = |rng: &mut Rng, p: Pixel| {
            Pixel::new(p.x + NOISE_PX * rng.normal(), p.y + NOISE_PX * rng.normal())
        };
        for (p, descriptor) in &points {
            if let Some(pixel) = project(p) {
                f.pixels.push(jitter(&mut rng, pixel));
                f.scores.push(1.0);
                let d = noisy(&mut rng, descriptor);
                f.descriptors_nd.extend(d);
            }
        }
        // Keypoints of nothing in particular.
        for _ in 0..30 {
            f.pixels
                .push(Pixel::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0)));
            f.scores.push(0.1);
            let d = unit(&mut rng);
            f.descriptors_nd.extend(d);
        }
        for ([a, b], descriptor) in &lines {
            // The detector stops somewhere along the line, in either direction.
            let (from, to) = (rng.range(0.0, 0.15), rng.range(0.85, 1.0));
            let (mut p, mut q) = (a + (b - a) * from, a + (b - a) * to);
            if rng.below(2) == 0 {
                std::mem::swap(&mut p, &mut q);
            }
            if let (Some(start), Some(end)) = (project(&p), project(&q)) {
                f.segments.push(Segment2 {
                    start: jitter(&mut rng, start),
                    end: jitter(&mut rng, end),
                    width_px: 1.0,
                    precision: 0.125,
                    neg_log10_nfa: 5.0,
                });
                for _ in 0..SAMPLES {
                    let d = noisy(&mut rng, descriptor);
                    f.segment_descriptors_nsd.extend(d);
                }
            }
        }
        images.push(DatasetImage {
            name: format!("{i:03}.png"),
            path: "unused".into(),
            camera,
            cam_from_world: Some(pose),
            split: Split::Train,
        });
        features.push(f);
    }
    Room {
        points,
        lines,
        images,
        features,
    }
}

fn run(room: Room) -> Result<(Labels, LabelStats), LabelError> {
    let images: Vec<&DatasetImage> = room.images.iter().collect();
    build(
        &images,
        room.features,
        "synthetic",
        &LabelParams::default(),
        &Progress::Hidden,
    )
}

#[test]
fn points_and_lines_are_found_where_they_are() {
    let truth = room(24);
    let (points, lines) = (truth.points.clone(), truth.lines.clone());
    let (labels, stats) = run(truth).expect("a good data set");
    assert!(stats.num_points >= 230, "{stats}");
    assert!(stats.mean_error_px < 0.8, "{stats}");
    // The 30 keypoints of nothing must not be labelled.
    assert!(
        stats.labelled_keypoints <= stats.keypoints - 29.0,
        "{stats}"
    );
    let mut far = 0;
    for track in &labels.points {
        let nearest = points
            .iter()
            .map(|(p, _)| (p - track.point_in_world).norm())
            .fold(f64::MAX, f64::min);
        far += usize::from(nearest > 0.02);
    }
    assert!(far <= 3, "{far} of {} points are off", labels.points.len());

    assert!(stats.num_lines >= 26, "{stats}");
    for track in &labels.lines {
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
    for image in &labels.images {
        for (segment, target) in image.segments.iter().zip(&image.segment_targets) {
            let Some(target) = target else { continue };
            let ends = labels.segment_target_ends(*target).expect("exists");
            let pixel = |p: &Vector3<f64>| {
                image
                    .camera
                    .pixel_from_cam(&image.cam_from_world.transform_point(p))
                    .expect("in front")
            };
            let (a, b) = (pixel(&ends[0]), pixel(&ends[1]));
            let along = (segment.end.x - segment.start.x) * (b.x - a.x)
                + (segment.end.y - segment.start.y) * (b.y - a.y);
            assert!(along > 0.0, "{} has a reversed target", image.name);
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
    assert!(matches!(run(unposed), Err(LabelError::TooFewPictures(0))));

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
        Err(LabelError::NoOverlap { .. } | LabelError::PoseConvention { .. }) => {}
        Err(other) => panic!("unexpected: {other}"),
        Ok((_, stats)) => assert!(
            stats.labelled_keypoints < 0.3 * stats.keypoints,
            "wrong poses must not look good: {stats}"
        ),
    }
}
