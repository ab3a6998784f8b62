//! Scripts as they ship, without their comments: the declarations beside them keep theirs, and a first visit pays for every byte.

use crate::files::{copy_tree, files};
use crate::setup::node_tool;
use crate::{paths, shell};
use anyhow::{Context as _, Result};
use std::fs;
use std::path::Path;

/// Takes the comments out of the scripts in `dir`, before other people's are put there, which keep their licences.
pub(super) fn strip(dir: &Path) -> Result<()> {
    let scripts = files(dir)?.into_iter().filter(|name| name.ends_with(".js"));
    let scratch = paths::root().join("target/web/stripped");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    // Only comments: types were checked where the scripts come from, and what is written as it is meant to run stays so.
    let mut tsc = node_tool("typescript/bin/tsc");
    tsc.args([
        "--ignoreConfig",
        "--allowJs",
        "--noCheck",
        "--noResolve",
        "--removeComments",
    ])
    .args([
        "--target",
        "ESNext",
        "--module",
        "ESNext",
        "--moduleResolution",
        "bundler",
    ])
    .args(["--types", "", "--rootDir"])
    .arg(dir)
    .arg("--outDir")
    .arg(&scratch)
    .args(scripts.map(|name| dir.join(name)));
    shell::output(&mut tsc)
        .with_context(|| format!("cannot take the comments out of {}", dir.display()))?;
    copy_tree(&scratch, dir)
}
