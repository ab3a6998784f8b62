//! Derivatives against central differences; recovery of a known scene; priors and gauge.

use super::model::{self, Moving};
use super::*;
use crate::geometry::rotation_from_vector;
use crate::math::Rng;

fn moving(pose: &CamFromWorld) -> Moving {
    Moving {
        rotation: pose.rotation,
        center: pose.center_in_world(),
    }
}

#[test]
fn derivatives_are_those_of_the_error() {
    let mut rng = Rng::from_seed(1);
    for _ in 0..200 {
        let mut random = |s: f64| Vector3::from_fn(|_, _| s * rng.normal());
        let camera = Moving {
            rotation: rotation_from_vector(&random(0.4)),
            center: random(0.3),
        };
        let point = random(0.5) + Vector3::new(0.0, 0.0, 6.0);
        let intrinsics = Intrinsics {
            focal_px: 500.0,
            k: -0.1,
            prior: None,
        };
        let place = Vector2::new(10.0, -20.0);
        let Some(l) = model::linear(&camera, &intrinsics, &point, &place) else {
            continue;
        };
        let value = |turn: Vector3<f64>, shift: Vector3<f64>, p: Vector3<f64>, lnf: f64, k: f64| {
            let camera = Moving {
                rotation: rotation_from_vector(&turn) * camera.rotation,
                center: camera.center + shift,
            };
            let intrinsics = Intrinsics {
                focal_px: intrinsics.focal_px * lnf.exp(),
                k: intrinsics.k + k,
                prior: None,
            };
            model::error(&camera, &intrinsics, &(point + p), &place).expect("in front")
        };
        let zero = Vector3::zeros();
        let h = 1e-6;
        let close = |slope: Vector2<f64>, plus: Vector2<f64>, minus: Vector2<f64>| {
            let numeric = (plus - minus) / (2.0 * h);
            assert!(
                (slope - numeric).norm() < 1e-4 * (1.0 + numeric.norm()),
                "{slope} {numeric}"
            );
        };
        for i in 0..3 {
            let e = Vector3::from_fn(|r, _| if r == i { h } else { 0.0 });
            let turn = |s: f64| value(e * s, zero, zero, 0.0, 0.0);
            close(l.by_turn.column(i).into(), turn(1.0), turn(-1.0));
            let p = |s: f64| value(zero, zero, e * s, 0.0, 0.0);
            close(l.by_point.column(i).into(), p(1.0), p(-1.0));
            let shift = |s: f64| value(zero, e * s, zero, 0.0, 0.0);
            close(-l.by_point.column(i), shift(1.0), shift(-1.0));
        }
        close(
            l.by_intrinsics.column(0).into(),
            value(zero, zero, zero, h, 0.0),
            value(zero, zero, zero, -h, 0.0),
        );
        close(
            l.by_intrinsics.column(1).into(),
            value(zero, zero, zero, 0.0, h),
            value(zero, zero, zero, 0.0, -h),
        );
    }
}

/// A ring of cameras that look at a cloud of points, everything known.
fn scene(sigma_px: f64, rng: &mut Rng) -> BundleProblem {
    let mut problem = BundleProblem {
        intrinsics: vec![Intrinsics {
            focal_px: 520.0,
            k: 0.03,
            prior: None,
        }],
        ..BundleProblem::default()
    };
    for i in 0..12 {
        let angle = 0.15 * f64::from(i);
        let rotation = rotation_from_vector(&Vector3::new(
            0.05 * rng.normal(),
            angle,
            0.03 * rng.normal(),
        ));
        let center = rotation.transpose() * Vector3::new(0.0, 0.1 * rng.normal(), -4.0);
        problem.cameras.push(BundleCamera {
            cam_from_world: CamFromWorld::new(rotation, -(rotation * center)),
            intrinsics: 0,
            is_fixed: false,
        });
    }
    for p in 0..150 {
        let point = Vector3::from_fn(|_, _| rng.range(-1.2, 1.2));
        problem.points.push(point);
        for c in 0..12 {
            if (c + p) % 3 == 0 {
                continue;
            }
            let camera = moving(&problem.cameras[c].cam_from_world);
            let exact = model::error(&camera, &problem.intrinsics[0], &point, &Vector2::zeros())
                .expect("in front");
            problem.observations.push(BundleObservation {
                camera: c as u32,
                point: p as u32,
                place_px: exact + Vector2::new(rng.normal(), rng.normal()) * sigma_px,
            });
        }
    }
    problem
}

fn disturb(problem: &mut BundleProblem, rng: &mut Rng) {
    for camera in problem.cameras.iter_mut().skip(1) {
        let turn = rotation_from_vector(&Vector3::from_fn(|_, _| 0.02 * rng.normal()));
        let center =
            camera.cam_from_world.center_in_world() + Vector3::from_fn(|_, _| 0.05 * rng.normal());
        let rotation = turn * camera.cam_from_world.rotation;
        camera.cam_from_world = CamFromWorld::new(rotation, -(rotation * center));
    }
    for point in &mut problem.points {
        *point += Vector3::from_fn(|_, _| 0.05 * rng.normal());
    }
    problem.intrinsics[0].focal_px *= 1.06;
    problem.intrinsics[0].k = 0.0;
}

fn free() -> BundleOptions {
    BundleOptions {
        loss: Loss::Squares,
        refines_focal: true,
        refines_radial: true,
        max_iterations: 50,
        tolerance: 1e-12,
    }
}

#[test]
fn a_disturbed_scene_comes_back_exactly() {
    let mut rng = Rng::from_seed(2);
    let truth = scene(0.0, &mut rng);
    let mut problem = truth.clone();
    disturb(&mut problem, &mut rng);
    let summary = adjust(&mut problem, &free()).expect("valid");
    assert!(
        summary.initial_cost > 1e3 && summary.final_cost < 1e-9,
        "{summary:?}"
    );
    assert!((problem.intrinsics[0].focal_px - 520.0).abs() < 1e-4);
    assert!((problem.intrinsics[0].k - 0.03).abs() < 1e-6);
    assert_eq!(problem.cameras[0], truth.cameras[0]);
}

#[test]
fn noise_costs_what_the_degrees_of_freedom_say() {
    let mut rng = Rng::from_seed(3);
    let sigma = 0.5;
    let mut problem = scene(sigma, &mut rng);
    disturb(&mut problem, &mut rng);
    let summary = adjust(&mut problem, &free()).expect("valid");
    assert!(summary.is_converged);
    let freedom = (2 * problem.observations.len() - 6 * 12 - 3 * 150 - 2 + 7) as f64;
    let expected = 0.5 * freedom * sigma * sigma;
    // The cost is chi squared: its standard deviation is sqrt(2 / freedom) = 3.3 % of it here.
    assert!(
        (summary.final_cost / expected - 1.0).abs() < 0.12,
        "{summary:?} {expected}"
    );
    let sigmas = focal_sigmas(&problem, &free()).expect("determined");
    assert!((problem.intrinsics[0].focal_px / 520.0).ln().abs() < 4.0 * sigmas[0]);
    assert!(sigmas[0] < 0.02, "{sigmas:?}");
}

#[test]
fn robust_losses_forgive_outliers_and_fixed_cameras_stay() {
    for loss in [Loss::Huber(1.0), Loss::Cauchy(1.0)] {
        let mut rng = Rng::from_seed(4);
        let mut problem = scene(0.2, &mut rng);
        for o in problem.observations.iter_mut().step_by(17) {
            o.place_px += Vector2::new(30.0, -20.0);
        }
        let truth = problem.clone();
        problem.cameras[3].is_fixed = true;
        problem.cameras[8].is_fixed = true;
        for camera in problem.cameras.iter_mut().step_by(2).skip(1) {
            if !camera.is_fixed {
                camera.cam_from_world.translation += Vector3::new(0.03, -0.02, 0.04);
            }
        }
        let options = BundleOptions {
            loss,
            ..BundleOptions::default()
        };
        let summary = adjust(&mut problem, &options).expect("valid");
        assert!(summary.final_cost < summary.initial_cost);
        for (now, then) in problem.cameras.iter().zip(&truth.cameras) {
            let moved =
                now.cam_from_world.center_in_world() - then.cam_from_world.center_in_world();
            assert!(moved.norm() < 0.02, "{loss:?}: {}", moved.norm());
            if now.is_fixed {
                assert_eq!(moved.norm(), 0.0);
            }
        }
        assert_eq!(problem.intrinsics, truth.intrinsics);
    }
}

#[test]
fn priors_hold_the_scale_and_bend() {
    let mut rng = Rng::from_seed(5);
    let mut problem = scene(0.3, &mut rng);
    let truth = problem.clone();
    // A track that drifts: 1 % longer with every step, and noisy.
    let drifted: Vec<CamFromWorld> = truth
        .cameras
        .iter()
        .enumerate()
        .map(|(i, c)| {
            let center = c.cam_from_world.center_in_world() * (1.0 + 0.004 * i as f64)
                + Vector3::from_fn(|_, _| 0.002 * rng.normal());
            CamFromWorld::new(
                c.cam_from_world.rotation,
                -(c.cam_from_world.rotation * center),
            )
        })
        .collect();
    for (i, (camera, given)) in problem.cameras.iter_mut().zip(&drifted).enumerate() {
        camera.cam_from_world = *given;
        problem.pose_priors.push(PosePrior {
            camera: i as u32,
            cam_from_world: *given,
            sigma_rad: 0.02,
            sigma_position: 0.1,
        });
        if i > 0 {
            problem.relative_priors.push(RelativePrior {
                cameras: (i as u32 - 1, i as u32),
                cam_from_world: (drifted[i - 1], *given),
                sigma_rad: 0.005,
                sigma_position: 0.01,
            });
        }
    }
    let distance = |p: &BundleProblem| -> f64 {
        p.cameras
            .iter()
            .zip(&truth.cameras)
            .map(|(a, b)| {
                (a.cam_from_world.center_in_world() - b.cam_from_world.center_in_world()).norm()
            })
            .fold(0.0, f64::max)
    };
    let before = distance(&problem);
    let summary = adjust(&mut problem, &BundleOptions::default()).expect("valid");
    assert!(summary.is_converged);
    // The pictures mend the shape; the scale is only known as well as the track is.
    let (a, b) = (
        &problem.cameras[0].cam_from_world,
        &problem.cameras[11].cam_from_world,
    );
    let span = (a.center_in_world() - b.center_in_world()).norm();
    let given = (drifted[0].center_in_world() - drifted[11].center_in_world()).norm();
    assert!((span / given - 1.0).abs() < 0.03, "{span} {given}");
    assert!(
        distance(&problem) < before,
        "{} {before}",
        distance(&problem)
    );
}

#[test]
fn wrong_indices_are_named() {
    let mut problem = scene(0.0, &mut Rng::from_seed(6));
    problem.observations[7].camera = 99;
    let error = adjust(&mut problem, &BundleOptions::default()).expect_err("no such camera");
    assert_eq!((error.observation, error.camera), (7, 99));
    assert!(adjust(&mut BundleProblem::default(), &BundleOptions::default()).is_ok());
}
