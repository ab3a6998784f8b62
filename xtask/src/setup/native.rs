//! The native tool, as the package and the demo use it.

use super::rust;
use crate::{paths, shell};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

static TESTS_HAVE_RUN: AtomicBool = AtomicBool::new(false);

/// Notes that this process has run the native tests.
pub(crate) fn note_tests() {
    TESTS_HAVE_RUN.store(true, Ordering::Relaxed);
}

/// Whether this process has run the native tests, so that what they built and wrote down is of the present sources.
pub(crate) fn tests_have_run() -> bool {
    TESTS_HAVE_RUN.load(Ordering::Relaxed)
}

/// Builds the tool `landline` without training, which takes most of its build time, and returns its path. A tool that
/// `LANDLINE_NATIVE` names is used as it is.
///
/// # Errors
///
/// When it does not build.
pub(crate) fn tool() -> Result<PathBuf> {
    if let Some(tool) = named() {
        return Ok(tool);
    }
    let tool = built("debug");
    // The native tests build it too, with training; building it again without would only cost time.
    if tests_have_run() && tool.is_file() {
        return Ok(tool);
    }
    build(&tool, &[])
}

/// As [`tool`], built for speed.
///
/// # Errors
///
/// When it does not build.
pub(crate) fn fast_tool() -> Result<PathBuf> {
    match named() {
        Some(tool) => Ok(tool),
        None => build(&built("release"), &["--release"]),
    }
}

fn named() -> Option<PathBuf> {
    std::env::var_os("LANDLINE_NATIVE").map(|tool| paths::root().join(tool))
}

fn built(profile: &str) -> PathBuf {
    let name = format!("landline{}", std::env::consts::EXE_SUFFIX);
    paths::target().join(profile).join(name)
}

fn build(tool: &Path, profile: &[&str]) -> Result<PathBuf> {
    rust::toolchain()?;
    // Not quietly: the first time it takes many minutes, and what cargo prints is all that shows it going on.
    println!(
        "native  cargo builds landline (without training); the first time that takes many minutes"
    );
    let mut cargo = shell::cargo();
    cargo.args([
        "build",
        "--package",
        "landline-mapper",
        "--no-default-features",
    ]);
    shell::run(cargo.args(profile))?;
    if !tool.is_file() {
        bail!("cargo left no {}", tool.display());
    }
    Ok(tool.to_owned())
}
