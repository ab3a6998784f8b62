//! Every solver against planted truth, its own constraints, symmetries and degenerate samples.

use super::*;
use crate::math::Rng;
use nalgebra::Vector2;

const PROBLEMS: usize = 10_000;

struct Instance {
    truth: CamFromWorld,
    bearings: [Vector3<f64>; 4],
    points: [Vector3<f64>; 4],
    lines: [SampleLine; 4],
}

fn random_rotation(rng: &mut Rng) -> Matrix3<f64> {
    let q = core::array::from_fn(|_| rng.normal());
    CamFromWorld::from_quaternion_wxyz(q, Vector3::zeros()).rotation
}

fn instance(rng: &mut Rng, upright: bool) -> Instance {
    let rotation = if upright {
        let a = rng.range(0.0, core::f64::consts::TAU);
        let (s, c) = a.sin_cos();
        Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
    } else {
        random_rotation(rng)
    };
    let truth = CamFromWorld::new(rotation, Vector3::from_fn(|_, _| 2.0 * rng.normal()));
    let world_from_cam = truth.inverse();
    let ray = |rng: &mut Rng| Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.6, 0.6), 1.0);
    let bearings: [_; 4] = core::array::from_fn(|_| ray(rng).normalize());
    let points = bearings.map(|b| world_from_cam.transform_point(&(b * rng.range(0.5, 8.0))));
    let lines = core::array::from_fn(|_| {
        let p = ray(rng) * rng.range(0.5, 8.0);
        let q = ray(rng) * rng.range(0.5, 8.0);
        SampleLine {
            normal_in_cam: p.cross(&q).normalize(),
            point_in_world: world_from_cam.transform_point(&p),
            direction_in_world: (world_from_cam.rotation * (q - p)).normalize(),
        }
    });
    Instance {
        truth,
        bearings,
        points,
        lines,
    }
}

fn three<T: Copy>(v: &[T; 4]) -> [T; 3] {
    [v[0], v[1], v[2]]
}

fn two<T: Copy>(v: &[T; 4]) -> [T; 2] {
    [v[0], v[1]]
}

/// Items each solver reads: (points, lines).
fn arity(kind: SolverKind) -> (usize, usize) {
    match kind {
        SolverKind::P3p => (3, 0),
        SolverKind::P2p1ll => (2, 1),
        SolverKind::P1p2ll => (1, 2),
        SolverKind::P3ll => (0, 3),
        SolverKind::Up2p => (2, 0),
        SolverKind::Up1p1ll => (1, 1),
        SolverKind::Pnplf => (4, 0),
    }
}

fn solve(kind: SolverKind, i: &Instance, out: &mut Solutions) {
    match kind {
        SolverKind::P3p => p3p(&three(&i.bearings), &three(&i.points), out),
        SolverKind::P2p1ll => p2p1ll(&two(&i.bearings), &two(&i.points), &i.lines[0], out),
        SolverKind::P1p2ll => p1p2ll(&i.bearings[0], &i.points[0], &two(&i.lines), out),
        SolverKind::P3ll => p3ll(&three(&i.lines), out),
        SolverKind::Up2p => up2p(&two(&i.bearings), &two(&i.points), out),
        SolverKind::Up1p1ll => up1p1ll(&i.bearings[0], &i.points[0], &i.lines[0], out),
        SolverKind::Pnplf => out.clear(),
    }
}

/// With the most solutions that each may have.
const CALIBRATED: [(SolverKind, usize); 6] = [
    (SolverKind::P3p, 4),
    (SolverKind::P2p1ll, 4),
    (SolverKind::P1p2ll, 4),
    (SolverKind::P3ll, 8),
    (SolverKind::Up2p, 2),
    (SolverKind::Up1p1ll, 2),
];

/// PoseLib's tolerance for a found truth and for a valid solution.
const FOUND: f64 = 1e-6;

fn is_upright(kind: SolverKind) -> bool {
    matches!(kind, SolverKind::Up2p | SolverKind::Up1p1ll)
}

fn distance(a: &CamFromWorld, b: &CamFromWorld) -> f64 {
    (a.rotation - b.rotation).amax() + (a.translation - b.translation).norm()
}

/// How far a pose is from satisfying the sample: angle for bearings, relative distance for lines.
fn violation(kind: SolverKind, i: &Instance, pose: &CamFromWorld) -> f64 {
    let (points, lines) = arity(kind);
    let mut worst = 0.0f64;
    for k in 0..points {
        let z = pose.transform_point(&i.points[k]);
        worst = worst.max((z.normalize() - i.bearings[k]).norm());
    }
    for line in &i.lines[..lines] {
        let z = pose.transform_point(&line.point_in_world);
        worst = worst
            .max(
                (pose.rotation * line.direction_in_world)
                    .dot(&line.normal_in_cam)
                    .abs(),
            )
            .max(line.normal_in_cam.dot(&z).abs() / z.norm());
    }
    worst
}

#[test]
fn every_solver_recovers_the_truth_in_all_random_problems() {
    for (kind, most) in CALIBRATED {
        let mut rng = Rng::from_seed(11);
        let mut out = Solutions::default();
        let (mut missed, mut total) = (0, 0);
        let mut worst_violation = 0.0f64;
        for _ in 0..PROBLEMS {
            let i = instance(&mut rng, is_upright(kind));
            solve(kind, &i, &mut out);
            total += out.len();
            let nearest = out
                .iter()
                .map(|pose| distance(pose, &i.truth))
                .fold(f64::INFINITY, f64::min);
            missed += usize::from(!(nearest < FOUND));
            assert!(out.len() <= most, "{kind:?} has {} solutions", out.len());
            for pose in out.iter() {
                worst_violation = worst_violation.max(violation(kind, &i, pose));
                let skew = (pose.rotation * pose.rotation.transpose() - Matrix3::identity()).amax();
                assert!(skew < 1e-12, "{kind:?} rotation off by {skew:e}");
                assert!(pose.rotation.determinant() > 0.0);
            }
        }
        println!(
            "{kind:?}: mean solutions {:.2}, worst constraint {worst_violation:.1e}",
            total as f64 / PROBLEMS as f64
        );
        assert_eq!(missed, 0, "{kind:?} missed the truth");
        assert!(worst_violation < FOUND, "{kind:?}: {worst_violation:e}");
    }
}

#[test]
fn pnplf_recovers_pose_and_focal_length_of_every_mix() {
    for num_points in 0..=4usize {
        let mut rng = Rng::from_seed(12);
        let mut out = FocalSolutions::default();
        let (mut missed, mut total, mut worst) = (0, 0, 0.0f64);
        for _ in 0..PROBLEMS {
            let i = instance(&mut rng, false);
            let focal = rng.range(400.0, 1500.0);
            let pixels: Vec<_> = i.bearings[..num_points]
                .iter()
                .map(|b| Vector2::new(b.x, b.y) * (focal / b.z))
                .collect();
            let lines: Vec<_> = i.lines[..4 - num_points]
                .iter()
                .map(|l| ImageLineCentered {
                    line: Vector3::new(
                        l.normal_in_cam.x,
                        l.normal_in_cam.y,
                        l.normal_in_cam.z * focal,
                    ),
                    point_in_world: l.point_in_world,
                    direction_in_world: l.direction_in_world,
                })
                .collect();
            pnplf(&pixels, &i.points[..num_points], &lines, &mut out);
            let nearest = out
                .iter()
                .map(|s| distance(&s.cam_from_world, &i.truth) + (s.focal_px - focal).abs() / focal)
                .fold(f64::INFINITY, f64::min);
            missed += usize::from(!(nearest < FOUND));
            worst = worst.max(nearest);
            total += out.len();
        }
        println!(
            "Pnplf, {num_points} points: mean solutions {:.2}, {missed} missed, worst {worst:.1e}",
            total as f64 / PROBLEMS as f64
        );
        assert_eq!(missed, 0, "{num_points} points: missed of {PROBLEMS}");
    }
}

#[test]
fn solution_sets_follow_the_symmetries() {
    for (kind, _) in CALIBRATED {
        let mut rng = Rng::from_seed(13);
        let (mut out, mut other) = (Solutions::default(), Solutions::default());
        for _ in 0..500 {
            let i = instance(&mut rng, is_upright(kind));
            solve(kind, &i, &mut out);
            // Negated normals and directions, a slid line point: the same poses.
            let mut j = Instance {
                lines: i.lines,
                ..i
            };
            for line in &mut j.lines {
                line.normal_in_cam = -line.normal_in_cam;
                line.point_in_world += line.direction_in_world * rng.range(-2.0, 2.0);
                line.direction_in_world = -line.direction_in_world;
            }
            solve(kind, &j, &mut other);
            assert!(same_set(&out, &other, |p| *p), "{kind:?} sign or slide");
            // A moved and scaled world: the poses move along.
            let scale = rng.range(0.1, 10.0);
            let turn = if is_upright(kind) {
                instance(&mut rng, true).truth.rotation
            } else {
                random_rotation(&mut rng)
            };
            let shift = Vector3::from_fn(|_, _| rng.normal());
            let moved = |x: &Vector3<f64>| turn * x * scale + shift;
            let mut k = Instance {
                lines: i.lines,
                ..i
            };
            k.points = i.points.map(|x| moved(&x));
            for (line, old) in k.lines.iter_mut().zip(&i.lines) {
                line.point_in_world = moved(&old.point_in_world);
                line.direction_in_world = turn * old.direction_in_world;
            }
            solve(kind, &k, &mut other);
            let undo = |p: &CamFromWorld| {
                let rotation = p.rotation * turn;
                let t = (p.translation + p.rotation * shift) / scale;
                CamFromWorld::new(rotation, t)
            };
            assert!(same_set(&out, &other, undo), "{kind:?} world motion");
        }
    }
}

/// Near-double roots may appear or vanish by rounding: solutions that are far from any other must be in both sets.
fn same_set(a: &Solutions, b: &Solutions, map: impl Fn(&CamFromWorld) -> CamFromWorld) -> bool {
    let is_isolated = |p: &CamFromWorld, set: &Solutions| {
        set.iter().filter(|q| distance(p, q) < 0.05).count() == 1
    };
    let size = |p: &CamFromWorld| 1.0 + p.translation.norm();
    a.iter()
        .filter(|p| is_isolated(p, a))
        .all(|p| size(p) > 50.0 || b.iter().any(|q| distance(p, &map(q)) < 1e-5 * size(p)))
}

#[test]
fn degenerate_samples_give_no_pose_and_no_nan() {
    let mut rng = Rng::from_seed(14);
    let mut out = Solutions::default();
    for _ in 0..200 {
        let i = instance(&mut rng, false);
        let (b, x, l) = (i.bearings, i.points, i.lines);
        let collinear = [x[0], x[1], x[0] + (x[1] - x[0]) * 0.3];
        p3p(&three(&b), &collinear, &mut out);
        assert!(out.is_empty(), "collinear points");
        p3p(&three(&b), &[x[0], x[0], x[1]], &mut out);
        assert!(out.is_empty(), "repeated point");
        p3p(&[b[0], b[0], b[1]], &three(&x), &mut out);
        assert!(out.iter().all(|p| p.rotation.sum().is_finite()));
        let mut parallel = three(&l);
        parallel[1].normal_in_cam = parallel[0].normal_in_cam;
        parallel[2].normal_in_cam = parallel[0].normal_in_cam;
        p3ll(&parallel, &mut out);
        assert!(out.is_empty(), "parallel viewing planes");
        // Room corner: three lines through one world point, their planes share a ray.
        let corner = i.truth.inverse().transform_point(&(b[0] * 3.0));
        let star = l.map(|mut line| {
            line.point_in_world = corner;
            let d = i.truth.rotation * line.direction_in_world;
            line.normal_in_cam = d.cross(&b[0]).normalize();
            line
        });
        p3ll(&three(&star), &mut out);
        assert!(out.is_empty(), "room corner");
        let mut on_line = two(&l);
        on_line[0].point_in_world = x[0] - on_line[0].direction_in_world;
        p1p2ll(&b[0], &x[0], &on_line, &mut out);
        assert!(out.iter().all(|p| p.translation.sum().is_finite()));
        let mut vertical = l[0];
        vertical.direction_in_world = Vector3::y();
        up1p1ll(&b[0], &x[0], &vertical, &mut out);
        assert!(out.is_empty(), "vertical line");
        let nan = Vector3::repeat(f64::NAN);
        p3p(&[nan, b[1], b[2]], &three(&x), &mut out);
        assert!(out.is_empty(), "NaN bearing");
        p2p1ll(&two(&b), &[nan, x[1]], &l[0], &mut out);
        assert!(out.is_empty(), "NaN point");
    }
}
