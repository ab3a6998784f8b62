//! Time of the pose solver: `cargo bench -p landline --no-default-features --bench pose`.
//!
//! Each minimal solver on a thousand random samples, and whole estimates on synthetic rooms.
//! `benches/pose_peers.py` compares whole estimates with PoseLib on recorded problems, natively and as wasm.

#![expect(missing_docs, reason = "criterion_group! makes public functions")]

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use landline::geometry::{CamFromWorld, rotation_from_vector};
use landline::math::Rng;
use landline::pose::solvers::{
    FocalSolutions, ImageLineCentered, SampleLine, Solutions, p1p2ll, p2p1ll, p3ll, p3p, pnplf,
    up1p1ll, up2p,
};
use landline::pose::{Focal, Gravity, PoseOptions, PoseScratch, estimate};
use landline_testkit::{PoseScene, PoseSceneParams, pose_scene};
use nalgebra::{Vector2, Vector3};
use std::hint::black_box;
use std::time::Instant;

const NUM_SAMPLES: usize = 1000;

/// Four points and four lines seen by one camera that is upright, so that every solver has its input.
struct Sample {
    bearings: [Vector3<f64>; 4],
    points: [Vector3<f64>; 4],
    lines: [SampleLine; 4],
}

fn samples() -> Vec<Sample> {
    let mut rng = Rng::from_seed(1);
    (0..NUM_SAMPLES)
        .map(|_| {
            let yaw = rotation_from_vector(&Vector3::new(0.0, rng.range(-3.0, 3.0), 0.0));
            let shift = Vector3::from_fn(|_, _| rng.normal());
            let world_from_cam = CamFromWorld::new(yaw, shift).inverse();
            let ray = |rng: &mut Rng| Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.6, 0.6), 1.0);
            let bearings = core::array::from_fn(|_| ray(&mut rng).normalize());
            let mut depth = || rng.range(0.5, 8.0);
            let points = bearings.map(|b| world_from_cam.transform_point(&(b * depth())));
            let lines = core::array::from_fn(|_| {
                let (p, q) = (ray(&mut rng) * 2.0, ray(&mut rng) * 3.0);
                SampleLine {
                    normal_in_cam: p.cross(&q).normalize(),
                    point_in_world: world_from_cam.transform_point(&p),
                    direction_in_world: (world_from_cam.rotation * (q - p)).normalize(),
                }
            });
            Sample {
                bearings,
                points,
                lines,
            }
        })
        .collect()
}

fn solvers(c: &mut Criterion) {
    let samples = samples();
    let mut group = c.benchmark_group("solver, 1000 samples");
    group.throughput(Throughput::Elements(NUM_SAMPLES as u64));
    let mut run = |name: &str, solve: &dyn Fn(&Sample, &mut Solutions)| {
        group.bench_function(name, |b| {
            let mut out = Solutions::default();
            b.iter(|| {
                for s in &samples {
                    solve(black_box(s), &mut out);
                    black_box(out.len());
                }
            });
        });
    };
    run("p3p", &|s, out| {
        let ([b0, b1, b2, _], [x0, x1, x2, _]) = (s.bearings, s.points);
        p3p(&[b0, b1, b2], &[x0, x1, x2], out);
    });
    run("p2p1ll", &|s, out| {
        let ([b0, b1, ..], [x0, x1, ..]) = (s.bearings, s.points);
        p2p1ll(&[b0, b1], &[x0, x1], &s.lines[0], out);
    });
    run("p1p2ll", &|s, out| {
        p1p2ll(&s.bearings[0], &s.points[0], &[s.lines[0], s.lines[1]], out);
    });
    run("p3ll", &|s, out| {
        p3ll(&[s.lines[0], s.lines[1], s.lines[2]], out);
    });
    run("up2p", &|s, out| {
        let ([b0, b1, ..], [x0, x1, ..]) = (s.bearings, s.points);
        up2p(&[b0, b1], &[x0, x1], out);
    });
    run("up1p1ll", &|s, out| {
        up1p1ll(&s.bearings[0], &s.points[0], &s.lines[0], out);
    });
    let pixels = |s: &Sample| s.bearings.map(|b| Vector2::new(b.x, b.y) * (500.0 / b.z));
    let lines = |s: &Sample| {
        s.lines.map(|l| ImageLineCentered {
            line: l
                .normal_in_cam
                .component_mul(&Vector3::new(1.0, 1.0, 500.0)),
            point_in_world: l.point_in_world,
            direction_in_world: l.direction_in_world,
        })
    };
    for num_points in [4, 2] {
        group.bench_function(format!("pnplf, {num_points} points"), |b| {
            let mut out = FocalSolutions::default();
            b.iter(|| {
                for s in &samples {
                    let n = num_points;
                    pnplf(
                        &pixels(s)[..n],
                        &s.points[..n],
                        &lines(s)[..4 - n],
                        &mut out,
                    );
                    black_box(out.len());
                }
            });
        });
    }
    group.finish();
}

fn estimates(c: &mut Criterion) {
    let mut group = c.benchmark_group("estimate");
    group.sample_size(20);
    let default = PoseSceneParams::default();
    let rooms = |params: PoseSceneParams| -> Vec<PoseScene> {
        (0..16).map(|seed| pose_scene(&params, seed)).collect()
    };
    let many = PoseSceneParams {
        num_points: 600,
        num_lines: 300,
        ..default
    };
    let few_inliers = PoseSceneParams {
        inlier_share: 0.1,
        ..many
    };
    let noisy = PoseSceneParams {
        sigma_m: 0.03,
        ..many
    };
    let known = PoseOptions::default();
    let unknown = PoseOptions {
        focal: Focal::Unknown,
        ..known
    };
    for (name, params, options, has_gravity) in [
        ("200 points, 50 lines, half right", default, known, false),
        ("600 points, 300 lines, half right", many, known, false),
        ("the same with 3 cm of noise", noisy, known, false),
        ("a tenth right", few_inliers, known, false),
        ("a tenth right, gravity known", few_inliers, known, true),
        ("half right, focal length unknown", many, unknown, false),
    ] {
        let rooms = rooms(params);
        let mut scratch = PoseScratch::new();
        group.bench_function(name, |b| {
            let mut k = 0;
            b.iter_batched(
                || {
                    k = (k + 1) % rooms.len();
                    &rooms[k]
                },
                |room| {
                    let gravity = has_gravity.then(|| Gravity {
                        in_cam: room.cam_from_world.rotation * Vector3::y(),
                        in_world: Vector3::y(),
                        sigma_rad: 0.02,
                    });
                    let options = PoseOptions { gravity, ..options };
                    estimate(
                        &room.points,
                        &room.lines,
                        &room.camera,
                        &options,
                        &mut scratch,
                        &mut || 0.0,
                    )
                    .map(|outcome| outcome.status)
                },
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

/// What a budget of 20 ms makes of many correspondences: the time of the call, by a real clock.
fn budgets(c: &mut Criterion) {
    let mut group = c.benchmark_group("a budget of 20 ms");
    group.sample_size(10);
    let options = PoseOptions {
        time_budget_ms: Some(20.0),
        ..PoseOptions::default()
    };
    for num_points in [1000, 10_000, 100_000, 1_000_000] {
        // Nothing is right, so that only the budget ends the search.
        let params = PoseSceneParams {
            num_points,
            inlier_share: 0.0,
            ..PoseSceneParams::default()
        };
        let room = pose_scene(&params, 1);
        let mut scratch = PoseScratch::new();
        group.bench_function(format!("{num_points} points, none right"), |b| {
            b.iter(|| {
                let start = Instant::now();
                let mut clock = || 1e3 * start.elapsed().as_secs_f64();
                let (points, lines) = (&room.points, &room.lines);
                estimate(
                    points,
                    lines,
                    &room.camera,
                    &options,
                    &mut scratch,
                    &mut clock,
                )
                .map(|outcome| outcome.status)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, solvers, estimates, budgets);
criterion_main!(benches);
