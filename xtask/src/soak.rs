//! `cargo xtask soak`: many frames in Chromium, with events in an order that a seed makes (`benches/soak.mjs`).

use crate::{paths, setup, shell, web};
use anyhow::Result;

/// Runs frames of the sample room through the built package in headless Chromium, with random events between them; prints memory,
/// workers and rejections, and fails where something is left over or unexplained.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Frames.
    #[arg(long, default_value_t = 10_000)]
    frames: u32,
    /// Seed of the events.
    #[arg(long, default_value_t = 1)]
    seed: u32,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    web::build()?;
    let browser = setup::browser()?;
    let mut node = shell::command("node");
    node.arg(paths::root().join("benches/soak.mjs"))
        .args([args.frames.to_string(), args.seed.to_string()])
        .env("CHROME", browser.chromium);
    shell::run(&mut node)
}
