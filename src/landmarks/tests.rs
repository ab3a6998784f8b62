//! A room of random points and lines: poses are known exactly, descriptors up to noise.

use super::build::{LineSource, PointSource, build};
use super::{LandmarkTable, Landmarks, LookOptions, SecondLook};
use crate::features::{FeatureSet, Keypoint};
use crate::geometry::{CamFromWorld, Camera, Pixel, Segment2, rotation_from_vector};
use crate::math::Rng;
use crate::pose::{PoseOptions, PoseScratch, PoseStatus};
use nalgebra::Vector3;

const CHANNELS: usize = 64;
const TOKENS: usize = 3;

struct Room {
    points: Vec<(Vector3<f64>, Vec<f32>)>,
    lines: Vec<([Vector3<f64>; 2], Vec<f32>)>,
    camera: Camera,
}

fn unit(mut v: Vec<f32>) -> Vec<f32> {
    let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    v.iter_mut().for_each(|x| *x /= norm);
    v
}

fn descriptor(rng: &mut Rng) -> Vec<f32> {
    unit((0..CHANNELS).map(|_| rng.normal() as f32 + 0.3).collect())
}

impl Room {
    fn new(rng: &mut Rng) -> Self {
        let mut at = |depth: (f64, f64)| {
            Vector3::new(
                rng.range(-2.0, 2.0),
                rng.range(-1.5, 1.5),
                rng.range(depth.0, depth.1),
            )
        };
        let places: Vec<_> = (0..600).map(|_| at((2.0, 5.0))).collect();
        let ends: Vec<_> = (0..60).map(|_| [at((3.0, 4.0)), at((3.0, 4.0))]).collect();
        Self {
            points: places.into_iter().map(|p| (p, descriptor(rng))).collect(),
            lines: ends.into_iter().map(|e| (e, descriptor(rng))).collect(),
            camera: Camera::centered(640, 480, 520.0),
        }
    }

    /// Cameras along a line, all of which see everything.
    fn table(&self) -> LandmarkTable {
        let cameras: Vec<_> = (0..8)
            .map(|i| Vector3::new(-0.7 + 0.2 * f64::from(i), 0.1, -0.2))
            .collect();
        let views: Vec<u32> = (0..8).collect();
        let points: Vec<_> = self
            .points
            .iter()
            .map(|(point_in_world, descriptor)| PointSource {
                point_in_world: *point_in_world,
                descriptor,
                sigma: 1e-3,
                views: &views,
            })
            .collect();
        let lines: Vec<_> = self
            .lines
            .iter()
            .map(|([start_in_world, end_in_world], descriptor)| LineSource {
                start_in_world: *start_in_world,
                end_in_world: *end_in_world,
                descriptor,
                sigma: 1e-3,
                views: &views,
            })
            .collect();
        build(CHANNELS, &cameras, &points, &lines).expect("a room")
    }

    /// What the camera sees from a pose, with noise, beside as many keypoints of something else.
    fn seen(&self, cam_from_world: &CamFromWorld, rng: &mut Rng) -> FeatureSet {
        let mut out = FeatureSet {
            descriptor_channels: CHANNELS,
            tokens: TOKENS,
            ..FeatureSet::default()
        };
        let noisy = |clean: &[f32], rng: &mut Rng| {
            unit(
                clean
                    .iter()
                    .map(|x| x + 0.06 * rng.normal() as f32)
                    .collect(),
            )
        };
        let project = |p: &Vector3<f64>| {
            let pixel = self
                .camera
                .pixel_from_cam(&cam_from_world.transform_point(p))?;
            let is_inside = (0.0..640.0).contains(&pixel.x) && (0.0..480.0).contains(&pixel.y);
            is_inside.then_some(pixel)
        };
        for (p, clean) in &self.points {
            if let Some(pixel) = project(p) {
                let pixel = Pixel::new(pixel.x + 0.4 * rng.normal(), pixel.y + 0.4 * rng.normal());
                out.keypoints.push(Keypoint { pixel, score: 1.0 });
                out.descriptors_nd.extend(noisy(clean, rng));
                let pixel = Pixel::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
                out.keypoints.push(Keypoint { pixel, score: 1.0 });
                out.descriptors_nd.extend(descriptor(rng));
            }
        }
        for ([a, b], clean) in &self.lines {
            if let (Some(start), Some(end)) = (project(a), project(b)) {
                out.segments.push(Segment2 {
                    start,
                    end,
                    width_px: 1.0,
                    precision: 0.1,
                    neg_log10_nfa: 10.0,
                });
                for _ in 0..TOKENS {
                    out.segment_descriptors_nsd.extend(noisy(clean, rng));
                }
            }
        }
        out
    }
}

fn pose(turn: [f64; 3], shift: [f64; 3]) -> CamFromWorld {
    CamFromWorld::new(rotation_from_vector(&turn.into()), shift.into())
}

#[test]
fn a_rough_pose_becomes_exact_and_a_wrong_one_finds_little() {
    let mut rng = Rng::from_seed(11);
    let room = Room::new(&mut rng);
    let landmarks = Landmarks::new(&room.table());
    let truth = pose([0.05, -0.1, 0.02], [0.2, -0.05, 0.3]);
    let features = room.seen(&truth, &mut rng);
    let (mut look, mut scratch) = (SecondLook::default(), PoseScratch::default());
    assert!(look.load(&landmarks, &features, (640, 480)));
    let rough = pose([0.07, -0.09, 0.0], [0.23, -0.02, 0.27]);
    let mut from = |start: &CamFromWorld, take: LookOptions| {
        let options = PoseOptions::default();
        let (camera, clock) = (&room.camera, &mut || 0.0);
        look.look(
            &landmarks,
            &features,
            camera,
            start,
            take,
            &options,
            &mut scratch,
            clock,
        )
        .expect("sound input")
    };
    let both = LookOptions::default();
    let points = LookOptions {
        lines: false,
        ..both
    };
    let lines = LookOptions {
        points: false,
        ..both
    };
    for (take, metres, degrees) in [
        (both, 2e-3, 0.05),
        (points, 3e-3, 0.05),
        (lines, 3e-3, 0.05),
    ] {
        let (outcome, found) = from(&rough, take).expect("finds enough");
        assert_eq!(outcome.status, PoseStatus::Ok);
        let estimate = outcome.estimate.expect("is located");
        let (position, rotation) = estimate.cam_from_world.error_to(&truth);
        assert!(
            position < metres && rotation.to_degrees() < degrees,
            "{take:?}: {position} m, {} degrees",
            rotation.to_degrees()
        );
        assert!(found.share() > 0.8, "{found:?}");
        let again = from(&rough, take).expect("finds enough");
        assert_eq!(again, (outcome, found), "the same bits");
    }
    // Half a metre aside nothing is where it should be.
    if let Some((_, found)) = from(&pose([0.05, 0.2, 0.02], [0.9, -0.05, 0.3]), both) {
        assert!(found.share() < 0.15, "{found:?}");
    }
}

#[test]
fn votes_find_the_pose_without_another() {
    let mut rng = Rng::from_seed(12);
    let room = Room::new(&mut rng);
    let landmarks = Landmarks::new(&room.table());
    let truth = pose([0.0, 0.15, -0.05], [-0.1, 0.05, 0.2]);
    let features = room.seen(&truth, &mut rng);
    let (mut look, mut scratch) = (SecondLook::default(), PoseScratch::default());
    assert!(look.load(&landmarks, &features, (640, 480)));
    let outcome = look
        .recall(
            &landmarks,
            &features,
            &room.camera,
            &PoseOptions::default(),
            &mut scratch,
            &mut || 0.0,
        )
        .expect("sound input");
    let estimate = outcome.located().expect("is located");
    let (position, rotation) = estimate.cam_from_world.error_to(&truth);
    assert!(position < 0.02 && rotation < 0.01, "{position} {rotation}");
}

#[test]
fn features_of_another_extractor_are_not_looked_for() {
    let mut rng = Rng::from_seed(13);
    let room = Room::new(&mut rng);
    let landmarks = Landmarks::new(&room.table());
    let truth = pose([0.0; 3], [0.0; 3]);
    let mut features = room.seen(&truth, &mut rng);
    let mut look = SecondLook::default();
    features.descriptors_nd.pop();
    assert!(!look.load(&landmarks, &features, (640, 480)));
    // A device that kept the descriptors to itself.
    features.descriptors_nd.clear();
    assert!(!look.load(&landmarks, &features, (640, 480)));
    let found = look.look(
        &landmarks,
        &features,
        &room.camera,
        &truth,
        LookOptions::default(),
        &PoseOptions::default(),
        &mut PoseScratch::default(),
        &mut || 0.0,
    );
    assert_eq!(found.expect("sound input"), None);
}

#[test]
fn what_was_found_tells_another_focal_length() {
    let mut rng = Rng::from_seed(14);
    let room = Room::new(&mut rng);
    let landmarks = Landmarks::new(&room.table());
    let truth = pose([0.05, -0.1, 0.02], [0.2, -0.05, 0.3]);
    let features = room.seen(&truth, &mut rng);
    let (mut look, mut scratch) = (SecondLook::default(), PoseScratch::default());
    assert!(look.load(&landmarks, &features, (640, 480)));
    for factor in [1.0, 1.08, 0.93] {
        let given = room.camera.with_focal_scaled(1.0 / factor);
        let (outcome, _) = look
            .look(
                &landmarks,
                &features,
                &given,
                &truth,
                LookOptions::default(),
                &PoseOptions::default(),
                &mut scratch,
                &mut || 0.0,
            )
            .expect("sound input")
            .expect("finds enough");
        let estimate = outcome.estimate.expect("a pose");
        let other = look.other_camera(&estimate.camera, &estimate.cam_from_world, false);
        let Some(solved) = other else {
            assert_eq!(factor, 1.0);
            continue;
        };
        // Matches of the windows around a wrong projection draw towards it: half of the way shows that it is wrong.
        let ln_ratio = (solved.camera.focal_px().0 / given.focal_px().0).ln();
        let expected = f64::ln(factor);
        assert!(
            (ln_ratio - expected).abs() < 0.5 * expected.abs(),
            "{factor}: {solved:?}"
        );
    }
}
