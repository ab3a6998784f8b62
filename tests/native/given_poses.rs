//! Poses that come with a film: exact ones stay to the last bit, disturbed ones are adjusted, those of another convention named.

use landline::geometry::{CamFromWorld, rotation_from_vector};
use landline::mapping::{FilmError, FilmMap, FilmParams, PoseSource, map_film};
use landline::math::Rng;
use landline::reconstruction::Stage;
use landline::reconstruction::motion::CameraGroup;
use landline_testkit::{film_camera, film_pictures};
use nalgebra::Vector3;

fn mapped(
    poses: impl Fn(&CamFromWorld) -> CamFromWorld,
    params: &FilmParams,
) -> (Result<FilmMap, FilmError>, Vec<CamFromWorld>) {
    let (mut views, truth) = film_pictures();
    for (view, pose) in views.iter_mut().zip(&truth) {
        view.cam_from_world = Some(poses(pose));
    }
    let group = CameraGroup::given(film_camera());
    let mut go_on = |_: Stage, _: usize, _: usize| true;
    let map = pollster::block_on(map_film(&views, &group, params, &mut go_on));
    (map, truth)
}

/// 1.5 cm and half a degree about each axis at most.
fn disturbed() -> impl Fn(&CamFromWorld) -> CamFromWorld {
    let rng = std::cell::RefCell::new(Rng::from_seed(11));
    move |pose| {
        let mut rng = rng.borrow_mut();
        let mut within = |limit: f64| Vector3::from_fn(|_, _| rng.range(-limit, limit));
        let turn = rotation_from_vector(&within(0.5_f64.to_radians()));
        let center = pose.center_in_world() + within(0.015);
        let rotation = turn * pose.rotation;
        CamFromWorld::new(rotation, -(rotation * center))
    }
}

/// Mean distance of camera centres, and mean angle.
fn off(map: &FilmMap, truth: &[CamFromWorld]) -> (f64, f64) {
    let (mut shift, mut angle) = (0.0, 0.0);
    for (pose, truth) in map.cam_from_world.iter().zip(truth) {
        let pose = pose.expect("all have a pose");
        shift += (pose.center_in_world() - truth.center_in_world()).norm();
        angle += pose.rotation_angle_to(truth);
    }
    let n = truth.len() as f64;
    (shift / n, angle / n)
}

#[test]
fn exact_poses_stay_as_they_are() {
    let (map, truth) = mapped(|pose| *pose, &FilmParams::default());
    let map = map.expect("a map");
    assert!(
        matches!(map.source, PoseSource::Given { epipolar_px: Some(px) } if px < 1.1),
        "{}",
        map.source
    );
    let given: Vec<Option<CamFromWorld>> = truth.into_iter().map(Some).collect();
    assert_eq!(map.cam_from_world, given);
}

#[test]
fn disturbed_poses_are_adjusted_towards_the_truth() {
    let as_given = FilmParams {
        given: None,
        ..FilmParams::default()
    };
    let (kept, truth) = mapped(disturbed(), &as_given);
    let (map, _) = mapped(disturbed(), &FilmParams::default());
    let (kept, map) = (kept.expect("a map"), map.expect("a map"));
    assert_eq!(kept.source, PoseSource::Given { epipolar_px: None });
    assert!(
        matches!(map.source, PoseSource::Adjusted(_)),
        "{}",
        map.source
    );
    let (shift, angle) = off(&map, &truth);
    let (shift_before, angle_before) = off(&kept, &truth);
    assert!(
        shift < 0.5 * shift_before && angle < 0.5 * angle_before,
        "{shift_before} -> {shift} m, {angle_before} -> {angle} rad"
    );
    assert!(map.median_error_px() < kept.median_error_px());
}

#[test]
fn poses_the_other_way_round_are_named_and_not_bent() {
    let inverse = |pose: &CamFromWorld| {
        let world_from_cam = pose.inverse();
        CamFromWorld::new(world_from_cam.rotation, world_from_cam.translation)
    };
    let (map, _) = mapped(inverse, &FilmParams::default());
    let error = map.expect_err("wrong poses");
    assert!(matches!(error, FilmError::Tracks(_)), "{error}");
}
