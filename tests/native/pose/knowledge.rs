//! What is known beside the correspondences (focal length, gravity, a prior pose), and how well the answer is known.

use super::{error, solve, solve_with};
use landline::geometry::{CamFromWorld, Camera, Pixel, rotation_from_vector};
use landline::math::Rng;
use landline::pose::{Degeneracy, Focal, Gravity, PoseOptions, PoseScratch, PoseStatus, PriorPose};
use landline_testkit::{PoseSceneParams, pose_scene};
use nalgebra::{Matrix6, Vector3, Vector6};

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
