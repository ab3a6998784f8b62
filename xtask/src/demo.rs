//! `cargo xtask demo`: from a fresh checkout to poses on the terminal and a working page. `cargo xtask sample`: makes
//! the demo's sample scene anew.

use crate::{paths, serve, setup, shell, tiers, web};
use anyhow::{Result, bail};
use std::path::PathBuf;

/// Sets up everything, locates the sample pictures, prints poses and errors, and serves the demo page.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Stops before serving.
    #[arg(long)]
    no_serve: bool,
    /// Port of the page.
    #[arg(long, default_value_t = 8080)]
    port: u16,
}

/// Renders the sample room, trains its scene, and writes the demo's sample files anew.
#[derive(Debug, clap::Args)]
pub(crate) struct SampleArgs {
    /// Passed on to `landline sample`.
    #[arg(last = true)]
    rest: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    web::build()?;
    let mut locate = shell::command(native_tool()?);
    shell::run(locate.arg("demo"))?;
    if args.no_serve {
        return Ok(());
    }
    serve::run(&serve::Args {
        port: args.port,
        ..serve::Args::default()
    })
}

pub(crate) fn sample(args: &SampleArgs) -> Result<()> {
    setup::native_tools()?;
    let weights = setup::weights()?;
    let mut cargo = shell::cargo();
    cargo
        .args([
            "run",
            "--release",
            "--package",
            "landline-mapper",
            "--",
            "sample",
        ])
        .args(&args.rest);
    shell::run(cargo.env("LANDLINE_XFEAT_CHECKPOINT", weights.checkpoint))
}

/// Builds the tool `landline` without training, which takes most of its build time, and returns its path.
///
/// # Errors
///
/// When it does not build.
pub(crate) fn native_tool() -> Result<PathBuf> {
    setup::native_tools()?;
    let tool = paths::target()
        .join("debug")
        .join(format!("landline{}", std::env::consts::EXE_SUFFIX));
    // The native tests build it too, with training; building it again without would only cost time.
    if tiers::native::has_run() && tool.is_file() {
        return Ok(tool);
    }
    println!("native  cargo builds landline (without training)");
    shell::run(shell::cargo().args([
        "build",
        "--quiet",
        "--package",
        "landline-mapper",
        "--no-default-features",
    ]))?;
    if !tool.is_file() {
        bail!("cargo left no {}", tool.display());
    }
    Ok(tool)
}
