//! What must not matter, and what must be noticed.

use super::{error, solve, solve_with};
use landline::geometry::Pixel;
use landline::pose::{PoseOptions, PoseScratch};
use landline_testkit::{PoseScene, PoseSceneParams, pose_scene};
use nalgebra::Vector3;

#[test]
fn a_half_pixel_between_points_segments_and_principal_point_is_noticed() {
    let params = PoseSceneParams {
        sigma_px: 0.0,
        inlier_share: 1.0,
        ..PoseSceneParams::default()
    };
    let scene = pose_scene(&params, 3);
    let options = PoseOptions::default();
    let mut scratch = PoseScratch::new();
    let mut rms = |scene: &PoseScene| {
        let outcome = solve_with(scene, &options, &mut scratch);
        let points = scratch.point_errors_px().iter().map(|e| f64::from(e * e));
        let lines = scratch
            .line_errors_px()
            .iter()
            .flat_map(|e| e.map(|d| f64::from(d * d)));
        let (sum, n) = points
            .chain(lines)
            .fold((0.0, 0.0), |(s, n), e| (s + e, n + 1.0));
        (outcome, (sum / n).sqrt())
    };
    let moved = |by_points: f64, by_lines: f64, by_center: f64| {
        let mut s = scene.clone();
        for p in &mut s.points {
            p.pixel = Pixel::new(p.pixel.x + by_points, p.pixel.y + by_points);
        }
        for l in &mut s.lines {
            l.start = Pixel::new(l.start.x + by_lines, l.start.y + by_lines);
            l.end = Pixel::new(l.end.x + by_lines, l.end.y + by_lines);
        }
        if let landline::geometry::CameraModel::SimplePinhole { cx, cy, .. } = &mut s.camera.model {
            *cx += by_center;
            *cy += by_center;
        }
        s
    };
    let (exact, exact_rms) = rms(&scene);
    assert!(exact_rms < 1e-5, "{exact_rms}");
    // All three move together: nothing changes.
    let (together, together_rms) = rms(&moved(0.5, 0.5, 0.5));
    assert!(together_rms < 1e-5);
    let (m, rad) = error(&together, &exact.estimate.expect("pose").cam_from_world);
    assert!(m < 1e-8 && rad < 1e-8);
    for (what, scene) in [
        ("points", moved(0.5, 0.0, 0.0)),
        ("segments", moved(0.0, 0.5, 0.0)),
        ("principal point", moved(0.0, 0.0, 0.5)),
    ] {
        let (outcome, rms) = rms(&scene);
        let (m, rad) = error(&outcome, &scene.cam_from_world);
        let turn_px = 525.0 * rad;
        assert!(
            rms > 0.02 || turn_px > 0.2,
            "{what}: rms {rms} px, {m} m, {turn_px} px"
        );
    }
}

#[test]
fn identical_calls_give_identical_bits_and_seeds_agree() {
    let scene = pose_scene(&PoseSceneParams::default(), 5);
    let options = PoseOptions::default();
    let mut scratch = PoseScratch::new();
    let first = solve_with(&scene, &options, &mut scratch);
    for _ in 0..10 {
        assert_eq!(solve_with(&scene, &options, &mut scratch), first);
    }
    let mut shuffled = scene.clone();
    shuffled.points.reverse();
    shuffled.lines.reverse();
    for (scene, seed) in [(&scene, 1), (&scene, 2), (&shuffled, 0)] {
        let other = solve(scene, &PoseOptions { seed, ..options });
        let (m, rad) = error(&other, &first.estimate.expect("pose").cam_from_world);
        assert!(m < 1e-4 && rad < 1e-4, "{m} m, {rad} rad");
    }
}

#[test]
fn unit_and_origin_of_the_world_do_not_matter() {
    let scene = pose_scene(&PoseSceneParams::default(), 6);
    let options = PoseOptions::default();
    let reference = solve(&scene, &options).estimate.expect("pose");
    for (scale, offset) in [(1e-3, 0.0), (1e4, 0.0), (1.0, 1e6)] {
        let offset = Vector3::new(offset, -0.5 * offset, offset);
        let map = |x: &Vector3<f64>| x * scale + offset;
        let mut moved = scene.clone();
        for p in &mut moved.points {
            p.point_in_world = map(&p.point_in_world);
        }
        for l in &mut moved.lines {
            l.start_in_world = map(&l.start_in_world);
            l.end_in_world = map(&l.end_in_world);
        }
        let found = solve(&moved, &options).estimate.expect("pose");
        let center = (found.cam_from_world.center_in_world() - offset) / scale;
        let distance = (center - reference.cam_from_world.center_in_world()).norm();
        let angle = found
            .cam_from_world
            .rotation_angle_to(&reference.cam_from_world);
        assert!(
            distance < 1e-5 && angle < 1e-5,
            "{scale} {offset:?}: {distance} {angle}"
        );
        assert!((found.sigma_m / scale / reference.sigma_m - 1.0).abs() < 1e-3);
    }
}
