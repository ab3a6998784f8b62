//! Refinement from a given pose: how near it comes, whose noise it believes, and what it refuses.

use super::{error, refine_with, solve_with};
use landline::geometry::{CamFromWorld, rotation_from_vector};
use landline::math::Rng;
use landline::pose::{PoseError, PoseOptions, PoseScratch, PoseStatus, refine};
use landline_testkit::{PoseScene, PoseSceneParams, pose_scene};
use nalgebra::{Matrix3, Vector3};

/// What matching near a predicted place gives: few wrong, no noise in the world.
fn guided(seed: u64) -> PoseScene {
    let params = PoseSceneParams {
        inlier_share: 0.8,
        ..PoseSceneParams::default()
    };
    pose_scene(&params, seed)
}

/// Some pixels beside the truth.
fn nearby(truth: &CamFromWorld, rng: &mut Rng) -> CamFromWorld {
    let turn = Vector3::from_fn(|_, _| 0.004 * rng.normal());
    let shift = Vector3::from_fn(|_, _| 0.01 * rng.normal());
    CamFromWorld::new(
        rotation_from_vector(&turn) * truth.rotation,
        truth.translation + shift,
    )
}

#[test]
fn a_near_start_ends_where_the_search_ends() {
    let mut scratch = PoseScratch::new();
    let mut rng = Rng::from_seed(70);
    let options = PoseOptions::default();
    for seed in 0..20 {
        let scene = guided(seed);
        let start = nearby(&scene.cam_from_world, &mut rng);
        let outcome = refine_with(&scene, &start, &options, &mut scratch);
        assert_eq!(outcome.status, PoseStatus::Ok);
        let (m, rad) = error(&outcome, &scene.cam_from_world);
        assert!(m < 0.01 && rad < 2e-3, "{seed}: {m} m, {rad} rad");
        let e = outcome.estimate.expect("an estimate");
        assert!(m < 4.0 * e.sigma_m && e.sigma_m < 0.01, "{m} {}", e.sigma_m);
        assert_eq!(e.num_point_inliers as usize, scratch.inliers().points.len());
        // Deterministic, whatever the scratch has seen before.
        let _ = solve_with(&guided(seed + 100), &options, &mut scratch);
        assert_eq!(refine_with(&scene, &start, &options, &mut scratch), outcome);
    }
}

#[test]
fn the_noise_of_each_correspondence_counts() {
    let mut scratch = PoseScratch::new();
    let mut rng = Rng::from_seed(71);
    let (mut told, mut untold) = (0.0, 0.0);
    for seed in 0..20 {
        let mut scene = guided(seed);
        scene.lines.clear();
        for (i, p) in scene.points.iter_mut().enumerate() {
            let coarse = i % 4 > 0;
            p.sigma_px = if coarse { 6.0 } else { 0.7 };
            if coarse {
                p.pixel.x += 6.0 * rng.normal();
                p.pixel.y += 6.0 * rng.normal();
            }
        }
        let start = nearby(&scene.cam_from_world, &mut rng);
        let mut error_m = |scene: &PoseScene| {
            let outcome = refine_with(scene, &start, &PoseOptions::default(), &mut scratch);
            error(&outcome, &scene.cam_from_world).0
        };
        told += error_m(&scene);
        for p in &mut scene.points {
            p.sigma_px = 0.0;
        }
        untold += error_m(&scene);
    }
    assert!(told < 0.8 * untold, "{told} {untold}");
}

#[test]
fn what_cannot_be_refined_is_told() {
    let mut scratch = PoseScratch::new();
    let options = PoseOptions::default();
    let scene = guided(3);
    // Starts between 30 and 180 degrees away: found again, or refused, but never somewhere else.
    for (k, axis) in [Vector3::x(), Vector3::y(), Vector3::z()]
        .iter()
        .enumerate()
    {
        for turn in [0.5, 1.0, 2.0, 3.1] {
            let far = CamFromWorld::new(
                rotation_from_vector(&(axis * turn)) * scene.cam_from_world.rotation,
                scene.cam_from_world.translation + Vector3::new(0.3, 0.2, 0.1),
            );
            let outcome = refine_with(&scene, &far, &options, &mut scratch);
            let is_right = || error(&outcome, &scene.cam_from_world).0 < 0.02;
            assert!(
                outcome.located().is_none() || is_right(),
                "{k} {turn} {outcome:?}"
            );
        }
    }
    let mut empty = scene.clone();
    empty.points.truncate(2);
    empty.lines.clear();
    let outcome = refine_with(&empty, &scene.cam_from_world, &options, &mut scratch);
    assert_eq!(outcome.status, PoseStatus::TooFew);
    let bent = CamFromWorld::new(Matrix3::identity() * 2.0, Vector3::zeros());
    let refused = refine(
        &scene.points,
        &scene.lines,
        &scene.camera,
        &bent,
        &options,
        &mut scratch,
        &mut || 0.0,
    );
    assert!(matches!(
        refused,
        Err(PoseError::Option { name: "start", .. })
    ));
}
