//! Solution sets of the minimal solvers beside those of the reference implementation.
//!
//! `tests/goldens/pose_solvers.json` comes from `tests/reference/pose_solvers.py`, whose head has the command.

use landline::geometry::CamFromWorld;
use landline::pose::solvers::{
    FocalSolutions, ImageLineCentered, SampleLine, Solutions, p1p2ll, p2p1ll, p3ll, p3p, pnplf,
    up1p1ll, up2p,
};
use nalgebra::{Vector2, Vector3};
use serde_json::Value;

/// Sum of the differences of rotation and relative translation below which two solutions are the same one. The solutions are
/// recorded with 13 digits; the worst of 70,000 problems differ by what two double-precision solvers may.
const SAME: f64 = 1e-6;

fn vectors(v: &Value) -> Vec<Vector3<f64>> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(v.clone()).expect("rows of numbers");
    rows.iter().map(|r| Vector3::from_column_slice(r)).collect()
}

fn units(v: &Value) -> Vec<Vector3<f64>> {
    vectors(v).iter().map(Vector3::normalize).collect()
}

/// Our solutions of one recorded problem, with focal length 1 where it is known.
fn solve(solver: &str, problem: &Value) -> Vec<(CamFromWorld, f64)> {
    let points = vectors(&problem["points"]);
    let line_points = vectors(&problem["line_points"]);
    let directions = units(&problem["directions"]);
    if solver == "pnplf" {
        let pixels: Vec<Vec<f64>> =
            serde_json::from_value(problem["pixels"].clone()).expect("rows");
        let pixels: Vec<_> = pixels.iter().map(|p| Vector2::new(p[0], p[1])).collect();
        let lines: Vec<_> = vectors(&problem["image_lines"])
            .into_iter()
            .zip(line_points.iter().zip(&directions))
            .map(|(line, (p, d))| ImageLineCentered {
                line,
                point_in_world: *p,
                direction_in_world: *d,
            })
            .collect();
        let mut out = FocalSolutions::default();
        pnplf(&pixels, &points, &lines, &mut out);
        return out.iter().map(|s| (s.cam_from_world, s.focal_px)).collect();
    }
    let b = units(&problem["bearings"]);
    let lines: Vec<_> = units(&problem["normals"])
        .into_iter()
        .zip(line_points.iter().zip(&directions))
        .map(|(normal_in_cam, (p, d))| SampleLine {
            normal_in_cam,
            point_in_world: *p,
            direction_in_world: *d,
        })
        .collect();
    let mut out = Solutions::default();
    match (solver, b.as_slice(), points.as_slice(), lines.as_slice()) {
        ("p3p", &[b0, b1, b2], &[x0, x1, x2], []) => p3p(&[b0, b1, b2], &[x0, x1, x2], &mut out),
        ("p2p1ll", &[b0, b1], &[x0, x1], [l]) => p2p1ll(&[b0, b1], &[x0, x1], l, &mut out),
        ("p1p2ll", [b], [x], &[l0, l1]) => p1p2ll(b, x, &[l0, l1], &mut out),
        ("p3ll", [], [], &[l0, l1, l2]) => p3ll(&[l0, l1, l2], &mut out),
        ("up2p", &[b0, b1], &[x0, x1], []) => up2p(&[b0, b1], &[x0, x1], &mut out),
        ("up1p1ll", [b], [x], [l]) => up1p1ll(b, x, l, &mut out),
        (other, ..) => panic!("no solver {other} for this sample"),
    }
    out.iter().map(|pose| (*pose, 1.0)).collect()
}

fn difference(a: &(CamFromWorld, f64), b: &(CamFromWorld, f64)) -> f64 {
    let (p, q) = (&a.0, &b.0);
    (p.rotation - q.rotation).amax()
        + (p.translation - q.translation).norm() / (1.0 + q.translation.norm())
        + (a.1 / b.1 - 1.0).abs()
}

#[test]
fn solution_sets_are_those_of_the_reference() {
    let recorded = include_str!("../../goldens/pose_solvers.json");
    let text = match std::env::var("LANDLINE_POSE_SOLVERS") {
        Ok(path) => std::fs::read_to_string(path).expect("readable"),
        Err(_) => recorded.to_owned(),
    };
    let all: Value = serde_json::from_str(&text).expect("JSON");
    let all = all.as_object().expect("one list for each solver");
    assert_eq!(all.len(), 7);
    for (solver, problems) in all {
        let problems = problems.as_array().expect("a list");
        let (mut missing, mut extra, mut worst, mut total) = (0, 0, 0.0f64, 0);
        for problem in problems {
            let expected: Vec<Vec<f64>> =
                serde_json::from_value(problem["solutions"].clone()).expect("rows");
            let expected: Vec<_> = expected
                .iter()
                .map(|s| {
                    let t = Vector3::new(s[4], s[5], s[6]);
                    let q = [s[0], s[1], s[2], s[3]];
                    let focal = s.get(7).copied().unwrap_or(1.0);
                    (CamFromWorld::from_quaternion_wxyz(q, t), focal)
                })
                .collect();
            let found = solve(solver, problem);
            let nearest = |a, set: &[(CamFromWorld, f64)]| {
                set.iter()
                    .map(|b| difference(a, b))
                    .fold(f64::INFINITY, f64::min)
            };
            for e in &expected {
                let d = nearest(e, &found);
                missing += usize::from(d > SAME);
                worst = worst.max(if d > SAME { 0.0 } else { d });
            }
            extra += found
                .iter()
                .filter(|f| nearest(f, &expected) > SAME)
                .count();
            total += expected.len();
        }
        println!(
            "{solver}: {} problems, {total} solutions, {missing} missing, {extra} extra, worst difference {worst:.1e}",
            problems.len()
        );
        assert_eq!((missing, extra), (0, 0), "{solver}");
    }
}
