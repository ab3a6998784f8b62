//! Bad input, hopeless input, budgets: a reason, never a NaN.

use super::{error, refine_with, solve, solve_with};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use landline::pose::{
    Degeneracy, Focal, Gravity, LineCorrespondence, PointCorrespondence, PoseError, PoseOptions,
    PoseScratch, PoseStatus, PriorPose, StopReason, estimate,
};
use landline_testkit::{PoseScene, PoseSceneParams, allocations, pose_scene};
use nalgebra::{Matrix6, Vector3};

fn nowhere(points: Vec<PointCorrespondence>, lines: Vec<LineCorrespondence>) -> PoseScene {
    PoseScene {
        camera: Camera::centered(640, 480, 525.0),
        cam_from_world: CamFromWorld::identity(),
        points,
        lines,
    }
}

/// A slice of such a cloud fits a proper pose; the rest says that the world is mirrored.
#[test]
fn a_world_behind_the_camera_is_refused() {
    let mut scratch = PoseScratch::new();
    for seed in 0..20 {
        for inlier_share in [1.0, 0.6] {
            let mut scene = pose_scene(
                &PoseSceneParams {
                    inlier_share,
                    ..PoseSceneParams::default()
                },
                seed,
            );
            let center = scene.cam_from_world.center_in_world();
            for p in &mut scene.points {
                p.point_in_world = 2.0 * center - p.point_in_world;
            }
            for l in &mut scene.lines {
                l.start_in_world = 2.0 * center - l.start_in_world;
                l.end_in_world = 2.0 * center - l.end_in_world;
            }
            let with_lines = scene.clone();
            scene.lines.clear();
            for scene in [&scene, &with_lines] {
                let outcome = solve_with(scene, &PoseOptions::default(), &mut scratch);
                assert_eq!(
                    outcome.status,
                    PoseStatus::LowInliers,
                    "seed {seed}, {} lines, inlier share {inlier_share}: {outcome:?}",
                    scene.lines.len()
                );
            }
        }
    }
}

#[test]
fn bad_input_gives_a_reason_and_never_a_nan() {
    let good = pose_scene(
        &PoseSceneParams {
            inlier_share: 1.0,
            ..PoseSceneParams::default()
        },
        7,
    );
    let options = PoseOptions {
        max_iterations: 3_000,
        ..PoseOptions::default()
    };
    let nan = f64::NAN;
    let with_points = |f: &dyn Fn(usize, &mut PointCorrespondence)| {
        let mut points = good.points.clone();
        points.iter_mut().enumerate().for_each(|(i, p)| f(i, p));
        nowhere(points, Vec::new())
    };
    let one = good.points[0];
    let cases = [
        (
            "nothing",
            nowhere(Vec::new(), Vec::new()),
            PoseStatus::TooFew,
        ),
        (
            "two points",
            nowhere(good.points[..2].to_vec(), Vec::new()),
            PoseStatus::TooFew,
        ),
        (
            "NaN pixels",
            with_points(&|_, p| p.pixel.x = nan),
            PoseStatus::TooFew,
        ),
        (
            "infinite world",
            with_points(&|_, p| p.point_in_world.y = f64::INFINITY),
            PoseStatus::TooFew,
        ),
        (
            "NaN confidence",
            with_points(&|_, p| p.confidence = f32::NAN),
            PoseStatus::TooFew,
        ),
        (
            "one point repeated",
            nowhere(vec![one; 100], Vec::new()),
            PoseStatus::Degenerate,
        ),
        (
            "one world point",
            with_points(&|_, p| p.point_in_world = one.point_in_world),
            PoseStatus::Degenerate,
        ),
    ];
    for (name, scene, expected) in &cases {
        let outcome = solve(scene, &options);
        assert_eq!(outcome.status, *expected, "{name}");
        assert!(outcome.located().is_none(), "{name}");
    }
    let collinear = with_points(&|i, p| p.point_in_world = Vector3::new(i as f64 * 0.01, 1.0, 3.0));
    assert_eq!(solve(&collinear, &options).status, PoseStatus::Degenerate);
    // Broken items among good ones are dropped and counted, and change nothing else.
    let mut mixed = good.clone();
    mixed.points.push(PointCorrespondence {
        pixel: Pixel::new(nan, 1.0),
        ..one
    });
    let zero_length = LineCorrespondence {
        end: good.lines[0].start,
        ..good.lines[0]
    };
    mixed.lines.push(zero_length);
    let outcome = solve(&mixed, &options);
    assert_eq!(outcome.stats.num_invalid, 2);
    assert_eq!(outcome.status, PoseStatus::Ok);
    assert_eq!(outcome.estimate, solve(&good, &options).estimate);
    let mut camera = good.clone();
    camera.camera = Camera::centered(640, 480, nan);
    let result = estimate(
        &camera.points,
        &camera.lines,
        &camera.camera,
        &options,
        &mut PoseScratch::new(),
        &mut || 0.0,
    );
    assert!(matches!(result, Err(PoseError::Camera(_))), "{result:?}");
    let bad_option = PoseOptions {
        max_point_error_px: -1.0,
        ..options
    };
    let result = estimate(
        &good.points,
        &good.lines,
        &good.camera,
        &bad_option,
        &mut PoseScratch::new(),
        &mut || 0.0,
    );
    let name = |e| {
        matches!(
            e,
            PoseError::Option {
                name: "max_point_error_px",
                ..
            }
        )
    };
    assert!(result.is_err_and(name));
}

#[test]
fn pure_outliers_are_refused() {
    let options = PoseOptions {
        max_iterations: 4_000,
        ..PoseOptions::default()
    };
    let mut scratch = PoseScratch::new();
    let mut accepted = 0;
    for seed in 0..100 {
        let params = PoseSceneParams {
            num_points: 50 + 7 * seed as usize,
            num_lines: seed as usize,
            inlier_share: 0.0,
            ..PoseSceneParams::default()
        };
        let outcome = solve_with(&pose_scene(&params, 900 + seed), &options, &mut scratch);
        accepted += usize::from(outcome.located().is_some());
    }
    assert!(accepted <= 1, "{accepted} of 100 accepted");
}

#[test]
fn the_search_does_not_stop_before_it_has_found_the_pose() {
    let mut scratch = PoseScratch::new();
    let mut missed = Vec::new();
    for seed in 0..300 {
        let params = PoseSceneParams {
            num_points: 90,
            num_lines: 30,
            inlier_share: 0.25,
            ..PoseSceneParams::default()
        };
        let scene = pose_scene(&params, 3_000 + seed);
        let options = PoseOptions {
            seed,
            ..PoseOptions::default()
        };
        let outcome = solve_with(&scene, &options, &mut scratch);
        assert_eq!(outcome.stats.stop, StopReason::Confident);
        let (m, rad) = error(&outcome, &scene.cam_from_world);
        if !(m < 0.1 && rad < 0.1) {
            missed.push((seed, m));
        }
    }
    // Promised is a miss in a thousand.
    assert!(missed.len() <= 1, "{missed:?}");
}

#[test]
fn the_time_budget_is_kept() {
    let params = |inlier_share, sigma_m| PoseSceneParams {
        inlier_share,
        sigma_m,
        num_points: 800,
        ..PoseSceneParams::default()
    };
    for (params, focal, is_solvable) in [
        (params(0.0, 0.0), Focal::Known, false),
        (params(0.5, 0.05), Focal::Known, true),
        (params(0.5, 0.02), Focal::Unknown, true),
    ] {
        let scene = pose_scene(&params, 8);
        for budget in [0.0, 1.0, 5.0, 12.0, 40.0] {
            let options = PoseOptions {
                time_budget_ms: Some(budget),
                focal,
                ..PoseOptions::default()
            };
            // A clock that advances by a millisecond each time it is read: it is read between all steps that take long.
            let mut now = 0.0;
            let outcome = estimate(
                &scene.points,
                &scene.lines,
                &scene.camera,
                &options,
                &mut PoseScratch::new(),
                &mut || {
                    now += 1.0;
                    now
                },
            )
            .expect("valid");
            assert!(
                now <= budget + 5.0,
                "{budget} ms: the clock was read {now} times"
            );
            assert!(f64::from(outcome.stats.iterations) <= 32.0 * (budget + 1.0));
            if !is_solvable || budget == 0.0 {
                assert_eq!(outcome.status, PoseStatus::OutOfTime, "{budget}");
                assert_eq!(outcome.stats.stop, StopReason::TimeBudget);
            }
            if let Some(e) = outcome.estimate {
                assert!(
                    e.cam_from_world
                        .to_row_major()
                        .iter()
                        .all(|v| v.is_finite())
                );
            }
        }
    }
}

/// Loading and refining take time in proportion to the size before a clock can end them: a budget bounds the size, by confidence.
#[test]
fn a_budget_uses_the_most_confident_of_a_hundred_thousand() {
    let params = PoseSceneParams {
        num_points: 100_000,
        num_lines: 5000,
        ..PoseSceneParams::default()
    };
    let mut scene = pose_scene(&params, 3);
    let count = scene.points.len();
    for (i, p) in scene.points.iter_mut().enumerate() {
        // All different, in an order that has nothing to do with that of the list.
        p.confidence = 0.1 + 0.8 * (i * 7919 % count) as f32 / count as f32;
    }
    let with_budget = PoseOptions {
        time_budget_ms: Some(20.0),
        ..PoseOptions::default()
    };
    let mut scratch = PoseScratch::new();
    let outcome = solve_with(&scene, &with_budget, &mut scratch);
    assert_eq!(outcome.status, PoseStatus::Ok);
    assert_eq!(outcome.stats.num_left_out, 92_000);
    let num_used = scratch.point_posteriors().iter().filter(|p| **p > 0.0);
    assert!(num_used.count() <= 8000);

    // Work and result are those of the 8000 alone.
    let mut by_confidence: Vec<f32> = scene.points.iter().map(|p| p.confidence).collect();
    by_confidence.sort_by(f32::total_cmp);
    let least = by_confidence[count - 8000];
    scene.points.retain(|p| p.confidence >= least);
    let mut alone = solve(&scene, &PoseOptions::default());
    assert_eq!(alone.stats.num_left_out, 0);
    alone.stats.num_left_out = outcome.stats.num_left_out;
    assert_eq!(alone, outcome);
}

/// The items of two scenes seen by one camera; the confidences say nothing.
fn merged(a: &PoseScene, b: &PoseScene) -> PoseScene {
    let mut scene = a.clone();
    scene.points.extend(&b.points);
    scene.lines.extend(&b.lines);
    scene.points.iter_mut().for_each(|p| p.confidence = 0.5);
    scene.lines.iter_mut().for_each(|l| l.confidence = 0.5);
    scene
}

#[test]
fn every_reason_is_given() {
    let params = PoseSceneParams {
        inlier_share: 1.0,
        num_points: 100,
        num_lines: 40,
        ..PoseSceneParams::default()
    };
    let scene = pose_scene(&params, 20);
    let options = PoseOptions {
        max_iterations: 5_000,
        ..PoseOptions::default()
    };
    let of = |scene: &PoseScene| {
        let outcome = solve(scene, &options);
        (outcome.status, outcome.degeneracy)
    };
    assert_eq!(of(&scene), (PoseStatus::Ok, None));
    let few = nowhere(scene.points[..1].to_vec(), scene.lines[..1].to_vec());
    assert_eq!(of(&few).0, PoseStatus::TooFew);
    let noise = PoseSceneParams {
        inlier_share: 0.0,
        ..params
    };
    assert_eq!(of(&pose_scene(&noise, 21)).0, PoseStatus::LowInliers);
    // Two rooms at once, each as good as the other.
    let both = merged(&scene, &pose_scene(&params, 22));
    assert_eq!(of(&both).0, PoseStatus::Ambiguous);

    // Structures that leave the pose open, seen without error by the camera of the scene.
    let camera = scene.camera;
    let pose = scene.cam_from_world;
    let pixel = |x: &Vector3<f64>| camera.pixel_from_cam(x).expect("in front");
    let in_world = |x: &Vector3<f64>| pose.inverse().transform_point(x);
    let point = |x: Vector3<f64>| PointCorrespondence {
        pixel: pixel(&x),
        point_in_world: in_world(&x),
        confidence: 0.9,
        sigma_m: 0.0,
        sigma_px: 0.0,
    };
    let line = |a: Vector3<f64>, b: Vector3<f64>| LineCorrespondence {
        start: pixel(&a),
        end: pixel(&b),
        start_in_world: in_world(&a),
        end_in_world: in_world(&b),
        confidence: 0.9,
        sigma_m: 0.0,
        sigma_px: 0.0,
    };
    let ladder = |f: &dyn Fn(f64) -> LineCorrespondence| {
        nowhere(
            Vec::new(),
            (0..40).map(|i| f(f64::from(i) / 40.0)).collect(),
        )
    };
    let undetermined = |cause| (PoseStatus::Degenerate, Some(cause));
    let rod = (0..60).map(|i| point(Vector3::new(f64::from(i) / 40.0 - 0.7, 0.2, 3.0)));
    assert_eq!(
        of(&nowhere(rod.collect(), Vec::new())),
        undetermined(Degeneracy::Collinear)
    );
    let pillars = ladder(&|s| {
        let foot = Vector3::new(2.0 * s - 1.0, 0.5, 3.0 + (40.0 * s).sin());
        line(foot, foot - Vector3::y())
    });
    assert_eq!(of(&pillars), undetermined(Degeneracy::LineDirections));
    let corner = Vector3::new(0.1, -0.1, 3.0);
    let star = ladder(&|s| {
        let ray = Vector3::new((6.0 * s).cos(), (6.0 * s).sin(), (20.0 * s).sin());
        line(corner + 0.2 * ray, corner + ray)
    });
    assert_eq!(of(&star), undetermined(Degeneracy::LineDirections));
}

#[test]
fn nothing_is_allocated_once_the_scratch_has_seen_the_problem() {
    let noisy = PoseSceneParams {
        sigma_m: 0.03,
        inlier_share: 0.2,
        ..PoseSceneParams::default()
    };
    let scene = pose_scene(&noisy, 11);
    let gravity = Gravity {
        in_cam: scene.cam_from_world.rotation * Vector3::y(),
        in_world: Vector3::y(),
        sigma_rad: 0.02,
    };
    let prior = PriorPose {
        cam_from_world: scene.cam_from_world,
        covariance: Some(Matrix6::identity()),
    };
    let options = PoseOptions::default();
    for options in [
        options,
        PoseOptions {
            gravity: Some(gravity),
            prior: Some(prior),
            time_budget_ms: Some(1e9),
            ..options
        },
        PoseOptions {
            focal: Focal::Unknown,
            ..options
        },
    ] {
        let mut scratch = PoseScratch::new();
        let (first, warm_up) = allocations(|| solve_with(&scene, &options, &mut scratch));
        assert!(warm_up > 0, "the allocator counts");
        let (again, count) = allocations(|| solve_with(&scene, &options, &mut scratch));
        assert_eq!(again, first);
        assert_eq!(count, 0, "{options:?}");
        // A smaller problem and another seed fit as well.
        let mut fewer = scene.clone();
        fewer.points.truncate(150);
        fewer.lines.truncate(20);
        let options = PoseOptions { seed: 7, ..options };
        let (_, count) = allocations(|| solve_with(&fewer, &options, &mut scratch));
        assert_eq!(count, 0, "{options:?}");
        let start = scene.cam_from_world;
        let mut refined = || refine_with(&fewer, &start, &options, &mut scratch);
        let first = refined();
        let (again, count) = allocations(refined);
        assert_eq!((again, count), (first, 0), "{options:?}");
    }
}
