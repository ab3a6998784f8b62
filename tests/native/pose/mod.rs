//! The pose solver as a whole: recorded problems, symmetries, bad input, budgets, and its minimal solvers beside the oracle.

mod inputs;
mod knowledge;
mod oracle;
mod recorded;
mod refined;
mod symmetries;

use landline::geometry::CamFromWorld;
use landline::pose::{PoseOptions, PoseOutcome, PoseScratch, estimate, refine};
use landline_testkit::PoseScene;

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

fn refine_with(
    scene: &PoseScene,
    start: &CamFromWorld,
    options: &PoseOptions,
    scratch: &mut PoseScratch,
) -> PoseOutcome {
    refine(
        &scene.points,
        &scene.lines,
        &scene.camera,
        start,
        options,
        scratch,
        &mut || 0.0,
    )
    .expect("valid camera, start and options")
}

fn error(outcome: &PoseOutcome, truth: &CamFromWorld) -> (f64, f64) {
    let e = outcome.estimate.as_ref().expect("an estimate");
    e.cam_from_world.error_to(truth)
}
