//! The pose estimator as a whole: against recorded problems, symmetries, bad input, budgets.

use landline::geometry::{CamFromWorld, Camera, Pixel, rotation_from_vector};
use landline::math::Rng;
use landline::pose::{
    Degeneracy, Focal, Gravity, LineCorrespondence, PointCorrespondence, PoseError, PoseOptions,
    PoseOutcome, PoseScratch, PoseStatus, PriorPose, StopReason, WorldNoise, estimate,
    problem_file,
};
use landline_testkit::{PoseScene, PoseSceneParams, pose_scene, shared_data};
use nalgebra::{Matrix6, Vector3, Vector6};

fn solve(scene: &PoseScene, options: &PoseOptions) -> PoseOutcome {
    let mut scratch = PoseScratch::new();
    solve_with(scene, options, &mut scratch)
}

fn solve_with(scene: &PoseScene, options: &PoseOptions, scratch: &mut PoseScratch) -> PoseOutcome {
    estimate(
        &scene.points,
        &scene.lines,
        &scene.camera,
        options,
        scratch,
        &mut || 0.0,
    )
    .expect("valid camera and options")
}

fn error(outcome: &PoseOutcome, truth: &CamFromWorld) -> (f64, f64) {
    let e = outcome.estimate.as_ref().expect("an estimate");
    e.cam_from_world.error_to(truth)
}

/// (setting, least share within 5 cm and 5 degrees: what PoseLib 2.0.5 reaches with the better of its calls, or the bar)
const RECORDED: [(&str, f64); 11] = [
    ("easy", 1.0),
    ("typical", 1.0),
    ("noisy3d", 0.82),
    ("few", 0.9),
    ("many", 1.0),
    ("lowinl", 1.0),
    ("badpts", 1.0),
    ("lines", 0.75),
    ("coherent", 1.0),
    ("coherrel", 1.0),
    ("verylow", 0.5),
];

#[test]
fn recorded_problems_are_solved_as_often_as_poselib_does() {
    let Some(dir) = shared_data("data/pose_problems") else {
        return;
    };
    let mut scratch = PoseScratch::new();
    for (setting, least) in RECORDED {
        let bytes = std::fs::read(dir.join(format!("{setting}.plb"))).expect("readable");
        let problems = problem_file::parse(&bytes).expect("valid");
        let (mut good, mut gross) = (0, 0);
        for p in &problems {
            let outcome = estimate(
                &p.points,
                &p.lines,
                &p.camera,
                &PoseOptions::default(),
                &mut scratch,
                &mut || 0.0,
            )
            .expect("valid input");
            let (m, rad) = error(&outcome, &p.cam_from_world);
            let is_given = matches!(outcome.status, PoseStatus::Ok | PoseStatus::Ambiguous);
            good += usize::from(is_given && m < 0.05 && rad < 5f64.to_radians());
            gross += usize::from(!is_given || m > 0.25 || rad > 5f64.to_radians());
        }
        let share = good as f64 / problems.len() as f64;
        println!("{setting}: {share:.3} within 5 cm and 5 degrees, {gross} gross failures");
        assert!(share >= least, "{setting}: {share} below {least}");
        assert_eq!(gross, 0, "{setting}: gross failures");
    }
}

#[test]
fn stairs_are_located_within_limaps_bar() {
    let Some(dir) = shared_data("data/stairs_pnp") else {
        return;
    };
    let options = PoseOptions {
        max_point_error_px: 5.0,
        max_line_error_px: 5.0,
        world_noise: WorldNoise::FromThresholds,
        ..PoseOptions::default()
    };
    for name in ["stairs_1", "stairs_2"] {
        let text = std::fs::read_to_string(dir.join(format!("{name}.json"))).expect("readable");
        let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let rows = |key: &str| -> Vec<Vec<f64>> {
            serde_json::from_value(json[key].clone()).expect("rows of numbers")
        };
        let list = |v: &serde_json::Value| -> Vec<f64> {
            serde_json::from_value(v.clone()).expect("numbers")
        };
        let q = list(&json["cam_from_world_gt"]["qwxyz"]);
        let t = list(&json["cam_from_world_gt"]["t"]);
        let truth = CamFromWorld::from_quaternion_wxyz(
            [q[0], q[1], q[2], q[3]],
            Vector3::from_column_slice(&t),
        );
        let points = rows("points2d")
            .iter()
            .zip(&rows("points3d"))
            .map(|(p, x)| PointCorrespondence {
                pixel: Pixel::new(p[0], p[1]),
                point_in_world: Vector3::from_column_slice(x),
                confidence: 0.5,
                sigma_m: 0.0,
            })
            .collect();
        // The segments count pixel centres as integers, the points do not.
        let lines = rows("segments2d")
            .iter()
            .zip(&rows("segments3d"))
            .map(|(s, x)| LineCorrespondence {
                start: Pixel::from_index_coordinates(s[0], s[1]),
                end: Pixel::from_index_coordinates(s[2], s[3]),
                start_in_world: Vector3::from_column_slice(&x[..3]),
                end_in_world: Vector3::from_column_slice(&x[3..]),
                confidence: 0.5,
                sigma_m: 0.0,
            })
            .collect();
        let scene = PoseScene {
            camera: Camera::centered(640, 480, 525.0),
            cam_from_world: truth,
            points,
            lines,
        };
        let outcome = solve(&scene, &options);
        let (m, rad) = error(&outcome, &truth);
        println!(
            "{name}: {m:.3} m, {:.2} degrees, {:?}",
            rad.to_degrees(),
            outcome.status
        );
        assert!(
            m < 0.5 && rad.to_degrees() < 2.0,
            "{name}: {m} m, {rad} rad"
        );
    }
}

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

fn nowhere(points: Vec<PointCorrespondence>, lines: Vec<LineCorrespondence>) -> PoseScene {
    PoseScene {
        camera: Camera::centered(640, 480, 525.0),
        cam_from_world: CamFromWorld::identity(),
        points,
        lines,
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
    let mut behind = good.clone();
    let center = good.cam_from_world.center_in_world();
    for p in &mut behind.points {
        p.point_in_world = 2.0 * center - p.point_in_world;
    }
    behind.lines.clear();
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
            PoseStatus::LowInliers,
        ),
        (
            "one world point",
            with_points(&|_, p| p.point_in_world = one.point_in_world),
            PoseStatus::LowInliers,
        ),
    ];
    for (name, scene, expected) in &cases {
        let outcome = solve(scene, &options);
        assert_eq!(outcome.status, *expected, "{name}");
        assert!(outcome.located().is_none(), "{name}");
    }
    let finite_or_refused = [
        ("behind the camera", behind),
        (
            "collinear world points",
            with_points(&|i, p| p.point_in_world = Vector3::new(i as f64 * 0.01, 1.0, 3.0)),
        ),
    ];
    for (name, scene) in &finite_or_refused {
        let outcome = solve(scene, &options);
        assert_ne!(outcome.status, PoseStatus::Ok, "{name}");
        if let Some(e) = outcome.estimate {
            let sum = e.cam_from_world.rotation.sum() + e.cam_from_world.translation.sum();
            assert!(sum.is_finite(), "{name}");
        }
    }
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
fn the_time_budget_ends_the_search() {
    let params = PoseSceneParams {
        inlier_share: 0.0,
        num_points: 800,
        ..PoseSceneParams::default()
    };
    let scene = pose_scene(&params, 8);
    for budget in [0.0, 5.0, 40.0] {
        let options = PoseOptions {
            time_budget_ms: Some(budget),
            ..PoseOptions::default()
        };
        // A clock that advances by a millisecond each time it is read.
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
        assert_eq!(outcome.status, PoseStatus::OutOfTime, "{budget}");
        assert_eq!(outcome.stats.stop, StopReason::TimeBudget);
        assert!(f64::from(outcome.stats.iterations) <= 32.0 * (budget + 1.0));
    }
}

#[test]
fn unknown_focal_length_is_found_or_refused() {
    let options = PoseOptions {
        focal: Focal::Unknown,
        ..PoseOptions::default()
    };
    let mut scratch = PoseScratch::new();
    let mut errors = Vec::new();
    for seed in 0..30 {
        let params = PoseSceneParams {
            sigma_m: 0.02,
            ..PoseSceneParams::default()
        };
        let mut scene = pose_scene(&params, 40 + seed);
        // What the camera says must not matter.
        scene.camera = Camera::centered(640, 480, 1000.0);
        let outcome = solve_with(&scene, &options, &mut scratch);
        let e = outcome.located().expect("located");
        errors.push((e.camera.focal_px().0 / 525.0 - 1.0).abs());
    }
    errors.sort_by(f64::total_cmp);
    println!(
        "focal error: median {:.4}, worst {:.4}",
        errors[15], errors[29]
    );
    assert!(errors[15] < 0.01, "median focal error {}", errors[15]);
    for seed in 0..20 {
        let flat = PoseSceneParams {
            is_fronto_parallel: true,
            ..PoseSceneParams::default()
        };
        let outcome = solve_with(&pose_scene(&flat, 70 + seed), &options, &mut scratch);
        assert_eq!(outcome.status, PoseStatus::Degenerate, "flat scene {seed}");
        assert_eq!(outcome.degeneracy, Some(Degeneracy::FocalUndetermined));
        // Too narrow: everything in a window of 13 pixels in the middle of the image, half of it noise.
        let mut narrow = pose_scene(
            &PoseSceneParams {
                num_lines: 0,
                ..flat
            },
            70 + seed,
        );
        let world_from_cam = narrow.cam_from_world.inverse();
        for (i, p) in narrow.points.iter_mut().enumerate() {
            let shrink = |v: f64, c: f64| c + (v - c) * 0.02;
            p.pixel = Pixel::new(shrink(p.pixel.x, 320.0), shrink(p.pixel.y, 240.0));
            let z = 3.0 + (i % 7) as f64 * 0.3;
            let ray = Vector3::new(
                (p.pixel.x - 320.0) / 525.0,
                (p.pixel.y - 240.0) / 525.0,
                1.0,
            );
            p.point_in_world = world_from_cam.transform_point(&(ray * z));
            p.pixel.x += if i % 2 == 0 { 0.7 } else { -0.7 };
        }
        let outcome = solve_with(&narrow, &options, &mut scratch);
        assert!(
            outcome.located().is_none(),
            "narrow view {seed}: {:?}",
            outcome.status
        );
    }
}

#[test]
fn gravity_finds_what_points_alone_find_and_tolerates_a_degree() {
    let mut scratch = PoseScratch::new();
    let mut rng = Rng::from_seed(50);
    let mut iterations = (0, 0);
    for seed in 0..20 {
        let params = PoseSceneParams {
            inlier_share: 0.15,
            ..PoseSceneParams::default()
        };
        let scene = pose_scene(&params, 100 + seed);
        let tilt = Vector3::from_fn(|_, _| 1f64.to_radians() * rng.normal() / 3f64.sqrt());
        let in_cam = rotation_from_vector(&tilt) * scene.cam_from_world.rotation * Vector3::y();
        let gravity = Gravity {
            in_cam: in_cam * 9.81,
            in_world: Vector3::y(),
            sigma_rad: 1f64.to_radians(),
        };
        let options = PoseOptions {
            gravity: Some(gravity),
            ..PoseOptions::default()
        };
        let outcome = solve_with(&scene, &options, &mut scratch);
        let (m, rad) = error(&outcome, &scene.cam_from_world);
        assert!(
            m < 0.03 && rad.to_degrees() < 0.5,
            "{seed}: {m} m {rad} rad"
        );
        iterations.0 += outcome.stats.iterations;
        iterations.1 += solve_with(&scene, &PoseOptions::default(), &mut scratch)
            .stats
            .iterations;
    }
    println!(
        "iterations with gravity {}, without {}",
        iterations.0, iterations.1
    );
    // Two points and gravity are a sample: three correspondences are not needed.
    let exact = PoseSceneParams {
        num_points: 40,
        num_lines: 0,
        inlier_share: 1.0,
        ..PoseSceneParams::default()
    };
    let scene = pose_scene(&exact, 130);
    let gravity = Gravity {
        in_cam: scene.cam_from_world.rotation * Vector3::y(),
        in_world: Vector3::y(),
        sigma_rad: 0.01,
    };
    let options = PoseOptions {
        gravity: Some(gravity),
        ..PoseOptions::default()
    };
    assert_eq!(solve(&scene, &options).status, PoseStatus::Ok);
}

#[test]
fn a_prior_pose_is_used_and_not_trusted_blindly() {
    let scene = pose_scene(
        &PoseSceneParams {
            inlier_share: 0.05,
            ..PoseSceneParams::default()
        },
        140,
    );
    let near = |w: f64, v: f64| {
        let turn = rotation_from_vector(&Vector3::new(w, -w, w));
        let t = turn * scene.cam_from_world.translation + Vector3::new(v, v, -v);
        PriorPose {
            cam_from_world: CamFromWorld::new(turn * scene.cam_from_world.rotation, t),
            covariance: None,
        }
    };
    // Near: found without sampling at all.
    let options = PoseOptions {
        prior: Some(near(0.003, 0.02)),
        max_iterations: 1,
        min_iterations: 0,
        ..PoseOptions::default()
    };
    let (m, rad) = error(&solve(&scene, &options), &scene.cam_from_world);
    assert!(m < 0.05 && rad < 0.02, "{m} {rad}");
    // Far away: ignored.
    let options = PoseOptions {
        prior: Some(near(1.0, 3.0)),
        ..PoseOptions::default()
    };
    let (m, rad) = error(&solve(&scene, &options), &scene.cam_from_world);
    assert!(m < 0.05 && rad < 0.02, "{m} {rad}");
    // A certain prior holds the refinement.
    let mut prior = near(0.0, 0.01);
    prior.covariance = Some(Matrix6::from_diagonal(&Vector6::repeat(1e-12)));
    let options = PoseOptions {
        prior: Some(prior),
        ..PoseOptions::default()
    };
    let (m, _) = error(&solve(&scene, &options), &prior.cam_from_world);
    assert!(m < 1e-4, "{m}");
}

#[test]
fn covariance_is_calibrated_and_shrinks_with_more_data() {
    let mut scratch = PoseScratch::new();
    let options = PoseOptions::default();
    let (mut sum, mut sigma) = (0.0, [0.0; 2]);
    let count = 100;
    for seed in 0..count {
        for (k, num_points) in [150, 600].into_iter().enumerate() {
            let params = PoseSceneParams {
                sigma_px: 1.0,
                num_points,
                ..PoseSceneParams::default()
            };
            let scene = pose_scene(&params, 200 + seed);
            let e = solve_with(&scene, &options, &mut scratch)
                .estimate
                .expect("pose");
            sigma[k] += e.sigma_m;
            if k == 0 {
                let turn = e.cam_from_world.rotation * scene.cam_from_world.rotation.transpose();
                let w = landline::geometry::vector_from_rotation(&turn);
                let v = e.cam_from_world.translation - turn * scene.cam_from_world.translation;
                let xi = Vector6::new(w.x, w.y, w.z, v.x, v.y, v.z);
                let information = e.covariance.try_inverse().expect("positive definite");
                sum += xi.dot(&(information * xi));
            }
        }
    }
    let nees = sum / f64::from(count as u32);
    println!("mean NEES {nees:.2} (6 when calibrated)");
    assert!((nees - 6.0).abs() < 1.5, "{nees}");
    assert!(sigma[1] < 0.7 * sigma[0]);
}
