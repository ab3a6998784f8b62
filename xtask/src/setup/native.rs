//! The native tool, as the package and the demo use it.

use super::rust;
use crate::{paths, shell};
use anyhow::{Result, bail};
use std::path::PathBuf;
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
    if let Some(tool) = std::env::var_os("LANDLINE_NATIVE") {
        return Ok(paths::root().join(tool));
    }
    rust::toolchain()?;
    let tool = paths::target()
        .join("debug")
        .join(format!("landline{}", std::env::consts::EXE_SUFFIX));
    // The native tests build it too, with training; building it again without would only cost time.
    if tests_have_run() && tool.is_file() {
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
