use super::*;
use crate::features::Keypoint;
use crate::geometry::{Pixel, rotation_from_vector};
use crate::math::Rng;
use crate::reconstruction::Stage;
use nalgebra::{Matrix3, Vector3};

const FOCAL: f64 = 500.0;
const CHANNELS: usize = 32;

/// Points of a place, each with a descriptor of its own.
struct Place {
    points: Vec<Vector3<f64>>,
    descriptors: Vec<Vec<f32>>,
}

fn place(seed: u64, count: usize, point: impl Fn(&mut Rng) -> Vector3<f64>) -> Place {
    let mut rng = Rng::from_seed(seed);
    Place {
        points: (0..count).map(|_| point(&mut rng)).collect(),
        descriptors: (0..count)
            .map(|_| (0..CHANNELS).map(|_| rng.normal() as f32).collect())
            .collect(),
    }
}

fn in_depth(rng: &mut Rng) -> Vector3<f64> {
    Vector3::new(
        rng.range(-4.0, 4.0),
        rng.range(-2.0, 2.0),
        rng.range(3.0, 7.0),
    )
}

/// What a camera sees of a place, half a pixel off.
fn features(place: &Place, cam_from_world: &CamFromWorld, focal: f64, seed: u64) -> FeatureSet {
    let mut rng = Rng::from_seed(seed);
    let mut set = FeatureSet {
        descriptor_channels: CHANNELS,
        ..FeatureSet::default()
    };
    for (point, descriptor) in place.points.iter().zip(&place.descriptors) {
        let p = cam_from_world.transform_point(point);
        let (u, v) = (
            focal * p.x / p.z + 320.0 + 0.5 * rng.normal(),
            focal * p.y / p.z + 240.0 + 0.5 * rng.normal(),
        );
        if p.z < 0.5 || !(0.0..640.0).contains(&u) || !(0.0..480.0).contains(&v) {
            continue;
        }
        set.keypoints.push(Keypoint {
            pixel: Pixel::new(u, v),
            score: 1.0,
        });
        let row: Vec<f32> = descriptor
            .iter()
            .map(|d| d + 0.2 * rng.normal() as f32)
            .collect();
        let norm = row.iter().map(|d| d * d).sum::<f32>().sqrt();
        set.descriptors_nd.extend(row.iter().map(|d| d / norm));
    }
    set
}

/// A walk sideways, 20 cm a picture, that sways.
fn walk(i: usize) -> CamFromWorld {
    let t = i as f64;
    let center = Vector3::new(0.2 * t - 2.0, 0.1 * (0.7 * t).sin(), 0.15 * (0.4 * t).cos());
    let rotation: Matrix3<f64> =
        rotation_from_vector(&Vector3::new(0.0, 0.03 * (0.5 * t).sin(), 0.0));
    CamFromWorld::new(rotation, -(rotation * center))
}

/// The first pictures of the walk through a place.
fn film(place: &Place, count: usize) -> Vec<FeatureSet> {
    (0..count)
        .map(|i| features(place, &walk(i), FOCAL, i as u64))
        .collect()
}

fn run(sets: &[FeatureSet], group: CameraGroup) -> Result<Motion, MotionError> {
    let pictures: Vec<Picture<'_>> = sets
        .iter()
        .map(|features| Picture {
            features,
            camera: 0,
        })
        .collect();
    let params = MotionParams::default();
    let groups = [group];
    let mut go_on = |_: Stage, _: usize, _: usize| true;
    pollster::block_on(async {
        let matches = match_pictures(&pictures, &groups, &params, &mut go_on).await?;
        reconstruct_motion(&pictures, &groups, &matches, &params, &mut go_on).await
    })
}

fn known() -> CameraGroup {
    CameraGroup::given(Camera::centered(640, 480, FOCAL))
}

/// Largest error of distances between camera centres, relative to the longest, the unit of length being free.
fn distance_error(component: &Component, truth: impl Fn(usize) -> CamFromWorld) -> f64 {
    let centers: Vec<(Vector3<f64>, Vector3<f64>)> = component
        .cam_from_world
        .iter()
        .enumerate()
        .filter_map(|(i, pose)| {
            Some((pose.as_ref()?.center_in_world(), truth(i).center_in_world()))
        })
        .collect();
    let mut pairs = Vec::new();
    for i in 0..centers.len() {
        for j in 0..i {
            let found = (centers[i].0 - centers[j].0).norm();
            pairs.push((found, (centers[i].1 - centers[j].1).norm()));
        }
    }
    let scale = pairs.iter().map(|p| p.1).sum::<f64>() / pairs.iter().map(|p| p.0).sum::<f64>();
    let longest = pairs.iter().map(|p| p.1).fold(0.0, f64::max);
    let error = pairs.iter().map(|p| (scale * p.0 - p.1).abs());
    error.fold(0.0, f64::max) / longest
}

#[test]
fn a_walk_is_posed_and_foreign_pictures_are_left_out() {
    let (here, elsewhere) = (place(1, 700, in_depth), place(2, 700, in_depth));
    let mut sets = film(&here, 20);
    // One foreign picture, and one that is there twice.
    sets.push(features(&elsewhere, &walk(3), FOCAL, 50));
    sets.push(sets[19].clone());
    let motion = run(&sets, known()).expect("a model");
    assert_eq!(motion.components.len(), 1);
    let component = &motion.components[0];
    assert_eq!(component.num_registered(), 21);
    assert_eq!(motion.left_out, [(20, LeftOut::NothingInCommon)]);
    let error = distance_error(component, |i| walk(if i == 21 { 19 } else { i }));
    assert!(error < 0.01, "{error}");
}

#[test]
fn an_unknown_focal_length_is_found() {
    let here = place(3, 700, in_depth);
    let sets = film(&here, 20);
    let motion = run(&sets, CameraGroup::unknown(640, 480)).expect("a model");
    let (found, _) = motion.components[0].cameras[0].focal_px();
    assert!((found / FOCAL - 1.0).abs() < 0.05, "{found}");
    assert_eq!(motion.components[0].num_registered(), 20);
}

#[test]
fn turning_on_the_spot_is_no_model() {
    let here = place(4, 2_000, in_depth);
    let turn = |i: usize| {
        let rotation = rotation_from_vector(&Vector3::new(0.0, 0.05 * i as f64 - 0.4, 0.0));
        CamFromWorld::new(rotation, Vector3::zeros())
    };
    let sets: Vec<FeatureSet> = (0..16)
        .map(|i| features(&here, &turn(i), FOCAL, i as u64))
        .collect();
    let outcome = run(&sets, known());
    assert!(
        matches!(outcome, Err(MotionError::NoStart { turned, .. }) if turned > 0),
        "{outcome:?}"
    );
}

#[test]
fn a_cut_makes_two_pieces() {
    let (here, elsewhere) = (place(5, 700, in_depth), place(6, 700, in_depth));
    let sets: Vec<FeatureSet> = (0..24)
        .map(|i| {
            let place = if i < 14 { &here } else { &elsewhere };
            features(place, &walk(i % 14), FOCAL, i as u64)
        })
        .collect();
    let motion = run(&sets, known()).expect("a model");
    let sizes: Vec<usize> = motion
        .components
        .iter()
        .map(Component::num_registered)
        .collect();
    assert_eq!(sizes, [14, 10]);
}

#[test]
fn two_pictures_or_the_same_picture_are_refused_in_words() {
    let here = place(7, 300, in_depth);
    let set = features(&here, &walk(0), FOCAL, 0);
    let one = run(core::slice::from_ref(&set), known()).expect_err("too few");
    assert_eq!(one, MotionError::TooFew(1));
    let same = run(&vec![set; 5], known()).expect_err("the same picture");
    assert!(matches!(same, MotionError::NoStart { .. }), "{same}");
}

/// Places in one world, each moved.
fn together(places: &[(&Place, Vector3<f64>)]) -> Place {
    let mut all = Place {
        points: Vec::new(),
        descriptors: Vec::new(),
    };
    for (place, shift) in places {
        all.points.extend(place.points.iter().map(|p| p + shift));
        all.descriptors.extend(place.descriptors.iter().cloned());
    }
    all
}

/// Refused, or right as far as it goes.
fn assert_not_silently_wrong(
    outcome: Result<Motion, MotionError>,
    truth: impl Fn(usize) -> CamFromWorld + Copy,
) {
    let Ok(motion) = outcome else { return };
    for component in &motion.components {
        let error = distance_error(component, truth);
        let num = component.num_registered();
        assert!(error < 0.03, "{num} pictures: {error}");
    }
}

#[test]
fn before_a_flat_wall_nothing_is_made_up() {
    let wall = place(8, 900, |rng| {
        Vector3::new(rng.range(-5.0, 5.0), rng.range(-2.5, 2.5), 4.0)
    });
    let sets = film(&wall, 20);
    assert_not_silently_wrong(run(&sets, known()), walk);
    assert_not_silently_wrong(run(&sets, CameraGroup::unknown(640, 480)), walk);
}

#[test]
fn twin_rooms_are_not_folded_into_one() {
    let (room, hall) = (place(9, 500, in_depth), place(10, 500, in_depth));
    // The twin is 16 m on, behind a hall; the same things are in it.
    let along = |x: f64| Vector3::new(x, 0.0, 0.0);
    let house = together(&[
        (&room, along(0.0)),
        (&hall, along(8.0)),
        (&room, along(16.0)),
    ]);
    let sets = film(&house, 100);
    let motion = run(&sets, known()).expect("a model");
    assert!(motion.components[0].num_registered() >= 30);
    assert_not_silently_wrong(Ok(motion), walk);
}

#[test]
fn a_given_focal_length_that_the_pictures_contradict_is_refused() {
    let here = place(11, 700, in_depth);
    let sets = film(&here, 20);
    let wrong = CameraGroup::given(Camera::centered(640, 480, 1.3 * FOCAL));
    let refused = run(&sets, wrong).expect_err("another camera");
    let MotionError::Focal {
        given_px, seen_px, ..
    } = refused
    else {
        panic!("{refused}");
    };
    assert!((given_px / FOCAL - 1.3).abs() < 1e-9);
    assert!((seen_px / FOCAL - 1.0).abs() < 0.05, "{seen_px}");
}

/// On an arc around the middle of the place, which it looks at.
fn on_arc(angle: f64) -> CamFromWorld {
    let (sin, cos) = angle.sin_cos();
    let center = Vector3::new(5.0 * sin, 0.0, 5.0 - 5.0 * cos);
    let rotation = Matrix3::new(cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos);
    CamFromWorld::new(rotation, -(rotation * center))
}

/// Where the pictures of two films on the arc were taken: 26 degrees each, with a gap of 52 between them.
fn two_films(i: usize) -> CamFromWorld {
    let start = if i < 10 { -0.9 } else { -0.05 };
    on_arc(start + 0.05 * i as f64)
}

/// Grows the two films as if no pair across had been compared, then joins them. How many pieces come out, and the largest.
fn joined(first: &Place, second: &Place) -> (usize, Component) {
    let sets: Vec<FeatureSet> = (0..20)
        .map(|i| {
            let place = if i < 10 { first } else { second };
            features(place, &two_films(i), FOCAL, i as u64)
        })
        .collect();
    let picture = |features| Picture {
        features,
        camera: 0,
    };
    let pictures: Vec<Picture<'_>> = sets.iter().map(picture).collect();
    let (params, groups) = (MotionParams::default(), [known()]);
    let cameras = [groups[0].camera];
    let mut go_on = |_: Stage, _: usize, _: usize| true;
    pollster::block_on(async {
        let all = match_pictures(&pictures, &groups, &params, &mut go_on).await;
        let mut matches = all.expect("go on");
        matches.retain(|m| (m.a < 10) == (m.b < 10));
        let hypotheses = focal_hypotheses(&pictures, &groups, &matches, &params);
        let mut watch = Watch::new(&mut go_on);
        let two_view = &params.two_view;
        let pairs = verify::verify(&pictures, &cameras, &matches, two_view, &mut watch).await;
        let pairs = pairs.expect("go on");
        let ground = Ground::new(&pictures, &groups, &pairs, &params);
        let (mut tried, mut is_done, mut pieces) = (Vec::new(), vec![false; 20], Vec::new());
        for _ in 0..2 {
            let start = best_start(
                &ground,
                &matches,
                &cameras,
                &hypotheses,
                &is_done,
                &mut tried,
                &mut watch,
            );
            let start = start.await.expect("go on").expect("a start");
            let grown = grow_all(&ground, start, &is_done, &mut watch).await;
            let grown = grown.expect("go on");
            for (done, pose) in is_done.iter_mut().zip(&grown.poses) {
                *done |= pose.is_some();
            }
            pieces.push(grown);
        }
        assert!(pieces.iter().all(|p| p.num_registered() == 10));
        let joined = join::bridge_gaps(&ground, &matches, &mut pieces, &mut watch).await;
        let joined = joined.expect("go on");
        let ground = match &joined {
            Some(pairs) => ground.with_pairs(pairs),
            None => ground,
        };
        (pieces.len(), component(&ground, &pieces[0]))
    })
}

#[test]
fn two_films_of_a_place_from_far_apart_are_joined() {
    let place = place(3, 900, in_depth);
    let (num, component) = joined(&place, &place);
    assert_eq!((num, component.num_registered()), (1, 20));
    let error = distance_error(&component, two_films);
    assert!(error < 0.02, "{error}");
}

#[test]
fn furniture_that_stands_otherwise_joins_nothing() {
    let first = place(3, 900, in_depth);
    // The same things, each third of the room somewhere else.
    let mut points = first.points.clone();
    for p in &mut points {
        let shift = match p.x {
            x if x < -1.3 => Vector3::new(2.0, 0.7, 1.0),
            x if x < 1.3 => Vector3::new(-1.5, -0.8, -0.6),
            _ => Vector3::new(-1.0, 0.5, 1.6),
        };
        *p += shift;
    }
    let second = Place {
        points,
        descriptors: first.descriptors.clone(),
    };
    let (num, component) = joined(&first, &second);
    assert_eq!((num, component.num_registered()), (2, 10));
}

/// The first pictures of a long walk that sways in depth, each with a focal length of its own.
fn zoomed_film(place: &Place, count: usize, focal: impl Fn(usize) -> f64) -> Vec<FeatureSet> {
    (0..count)
        .map(|i| features(place, &walk(i), focal(i), i as u64))
        .collect()
}

#[test]
fn another_zoom_from_the_middle_on_is_a_camera_of_its_own() {
    let here = place(12, 900, in_depth);
    let focal = |i: usize| if i < 16 { FOCAL } else { 1.35 * FOCAL };
    let sets = zoomed_film(&here, 30, focal);
    let motion = run(&sets, CameraGroup::unknown(640, 480)).expect("a model");
    let component = &motion.components[0];
    assert!(component.num_registered() >= 28, "{motion:?}");
    assert!(distance_error(component, walk) < 0.03);
    for (i, pose) in component.cam_from_world.iter().enumerate() {
        let found = component.cameras[motion.camera_of[i]].focal_px().0;
        assert!(
            pose.is_none() || (found / focal(i) - 1.0).abs() < 0.05,
            "picture {i}: {found}"
        );
    }
}

#[test]
fn a_few_zoomed_pictures_are_left_out() {
    let here = place(13, 900, in_depth);
    let focal = |i: usize| {
        if (14..18).contains(&i) {
            1.4 * FOCAL
        } else {
            FOCAL
        }
    };
    let sets = zoomed_film(&here, 30, focal);
    let motion = run(&sets, CameraGroup::unknown(640, 480)).expect("a model");
    let component = &motion.components[0];
    assert!(component.num_registered() >= 12);
    assert!((14..18).all(|i| component.cam_from_world[i].is_none()));
    assert!(distance_error(component, walk) < 0.03);
}

#[test]
fn a_zoom_that_moves_while_filming_is_not_believed() {
    let here = place(14, 900, in_depth);
    let focal = |i: usize| FOCAL * (1.0 + 0.5 * ((i as f64 - 8.0) / 24.0).clamp(0.0, 1.0));
    let sets = zoomed_film(&here, 40, focal);
    match run(&sets, CameraGroup::unknown(640, 480)) {
        Err(refused) => assert!(refused.to_string().contains("zoom"), "{refused}"),
        Ok(motion) => {
            let error = distance_error(&motion.components[0], walk);
            assert!(error < 0.03, "{error}");
        }
    }
}

#[test]
fn a_piece_is_kept_when_moved_and_not_when_bent() {
    let sets = film(&place(15, 40, in_depth), 12);
    let picture = |features| Picture {
        features,
        camera: 0,
    };
    let pictures: Vec<Picture<'_>> = sets.iter().map(picture).collect();
    let (params, groups) = (MotionParams::default(), [known()]);
    let ground = Ground::new(&pictures, &groups, &[], &params);
    let way: Vec<Option<CamFromWorld>> = (0..12).map(|i| Some(walk(i))).collect();
    let piece = ground.posed_attempt(&way);
    let moved = Similarity {
        scale: 3.0,
        rotation: rotation_from_vector(&Vector3::new(0.3, -1.0, 0.2)),
        translation: Vector3::new(5.0, 0.0, -2.0),
    };
    let in_other_world = |pose: &CamFromWorld| Some(moved.transform_pose(pose));
    let whole: Vec<_> = way.iter().flatten().map(in_other_world).collect();
    assert!(zoom::keeps(&piece, &whole));
    // The last third at another scale, as it comes out where a join ahead is believed.
    let mut bent = whole.clone();
    let hinge = whole[7].expect("posed").center_in_world();
    for pose in bent[8..].iter_mut().flatten() {
        let center = hinge + 0.4 * (pose.center_in_world() - hinge);
        *pose = CamFromWorld::new(pose.rotation, -(pose.rotation * center));
    }
    assert!(!zoom::keeps(&piece, &bent));
}
