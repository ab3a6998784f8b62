//! Solves recorded pose problems and prints one JSON object for each: our side of `benches/pose_peers.py`.

use anyhow::{Context, Result, bail};
use clap::Parser;
use cpu_time::ThreadTime;
use landline::pose::{Focal, PoseOptions, PoseOutcome, PoseScratch, PoseStatus, estimate};
use landline_testkit::problem_file;
use serde::Serialize;
use std::io::Write;
use std::path::PathBuf;

/// Solves the pose problems of a `.plb` file; one JSON object a line.
#[derive(Debug, Parser)]
struct Args {
    /// Problems with ground truth (`.plb`)
    file: PathBuf,
    /// Largest reprojection error of an inlier point, in pixels
    tau_points: f64,
    /// Largest sum of the two end distances of an inlier line, in pixels
    tau_lines: f64,
    /// Seed of the random generator
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Ignore the file's focal length and estimate it
    #[arg(long)]
    unknown_focal: bool,
    /// Time budget of each problem in milliseconds
    #[arg(long)]
    budget_ms: Option<f64>,
    /// Times each problem is solved; the median time is printed
    #[arg(long, default_value_t = 1)]
    repeat: usize,
}

/// One line of the output. `R` and `t` are null when there is no trustworthy pose.
#[derive(Serialize)]
struct Line<'a> {
    i: usize,
    #[serde(rename = "R")]
    rotation: Option<[f64; 9]>,
    t: Option<[f64; 3]>,
    focal_px: Option<f64>,
    status: String,
    message: &'a str,
    ms: f64,
    iters: u32,
    models: u32,
    sigma_m: Option<f64>,
    sigma_rad: Option<f64>,
    log_evidence: Option<f64>,
    runner_up: Option<f64>,
    inliers_p: Vec<u8>,
    inliers_l: Vec<u8>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let name = args.file.display();
    let bytes = std::fs::read(&args.file).with_context(|| format!("reading {name}"))?;
    let problems = problem_file::parse(&bytes).with_context(|| format!("in {name}"))?;
    if args.repeat == 0 {
        bail!("--repeat must be at least 1");
    }
    let options = PoseOptions {
        max_point_error_px: args.tau_points,
        max_line_error_px: args.tau_lines,
        seed: args.seed,
        focal: if args.unknown_focal {
            Focal::Unknown
        } else {
            Focal::Known
        },
        time_budget_ms: args.budget_ms,
        ..PoseOptions::default()
    };
    let start = std::time::Instant::now();
    let mut clock = || start.elapsed().as_secs_f64() * 1e3;
    let mut scratch = PoseScratch::new();
    let mut solve = |i: usize, scratch: &mut PoseScratch| {
        let p = &problems[i];
        estimate(
            &p.points, &p.lines, &p.camera, &options, scratch, &mut clock,
        )
        .with_context(|| format!("problem {i} of {name}"))
    };
    let mut out = std::io::stdout().lock();
    if !problems.is_empty() {
        solve(0, &mut scratch)?; // warm-up: buffers grow once
    }
    for (i, problem) in problems.iter().enumerate() {
        let mut times = Vec::new();
        let mut last = None;
        for _ in 0..args.repeat {
            let begin = ThreadTime::now();
            let outcome = solve(i, &mut scratch)?;
            times.push(begin.elapsed().as_secs_f64() * 1e3);
            last = Some(outcome);
        }
        times.sort_by(f64::total_cmp);
        let Some(outcome) = last else { continue };
        let flags = |list: &[u32], n: usize| {
            let mut flags = vec![0; n];
            for k in list {
                flags[*k as usize] = 1;
            }
            flags
        };
        let line = line(
            i,
            times[times.len() / 2],
            &outcome,
            flags(&scratch.inliers().points, problem.points.len()),
            flags(&scratch.inliers().lines, problem.lines.len()),
        );
        serde_json::to_writer(&mut out, &line)?;
        out.write_all(b"\n")?;
    }
    Ok(())
}

fn line(
    i: usize,
    ms: f64,
    outcome: &PoseOutcome,
    inliers_p: Vec<u8>,
    inliers_l: Vec<u8>,
) -> Line<'static> {
    let e = outcome.estimate.as_ref();
    // An ambiguous pose is still the best one known; a benchmark that counts failures should see it.
    let shown = e.filter(|_| matches!(outcome.status, PoseStatus::Ok | PoseStatus::Ambiguous));
    Line {
        i,
        rotation: shown.map(|e| {
            let r = &e.cam_from_world.rotation;
            core::array::from_fn(|k| r[(k / 3, k % 3)])
        }),
        t: shown.map(|e| e.cam_from_world.translation.into()),
        focal_px: e.map(|e| e.camera.focal_px().0),
        status: format!("{:?}", outcome.status),
        message: outcome.status.message(),
        ms,
        iters: outcome.stats.iterations,
        models: outcome.stats.models_scored,
        sigma_m: e.map(|e| e.sigma_m),
        sigma_rad: e.map(|e| e.sigma_rad),
        log_evidence: e.map(|e| e.log_evidence),
        runner_up: e.and_then(|e| e.runner_up.map(|r| r.score_ratio)),
        inliers_p,
        inliers_l,
    }
}
