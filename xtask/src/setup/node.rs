//! Node and the npm tools of `web/package-lock.json`: the TypeScript compiler, wasm-opt, the browser driver.

use super::{already, step};
use crate::pins::Toolchain;
use crate::{paths, shell};
use anyhow::{Context as _, Result, bail};
use sha2::{Digest as _, Sha256};
use std::path::PathBuf;
use std::process::Command;

/// Node is there and so are its tools.
#[derive(Debug)]
pub(crate) struct Node {
    /// Hash of the lock file that the tools were installed from: part of what a cached build depends on.
    pub(crate) lock_hash: String,
}

/// Checks Node and installs the tools with `npm ci`.
pub(super) fn install(pins: &Toolchain) -> Result<Node> {
    let name = "npm tools";
    let said = shell::output(shell::command("node").arg("--version")).with_context(|| {
        format!(
            "Node {} or newer is needed to build and test the npm package; install it and npm",
            pins.node_major
        )
    })?;
    let major: u32 = said
        .trim()
        .trim_start_matches('v')
        .split('.')
        .next()
        .and_then(|number| number.parse().ok())
        .with_context(|| format!("`node --version` printed {said:?}"))?;
    if major < pins.node_major {
        bail!(
            "Node {major} is too old, landline needs {} or newer",
            pins.node_major
        );
    }

    let web = paths::root().join("web");
    let lock = std::fs::read(web.join("package-lock.json"))
        .context("cannot read web/package-lock.json")?;
    let lock_hash = hex(&Sha256::digest(&lock));
    // `npm ci` removes the whole folder first, and this file with it, so it stands for a finished installation.
    let stamp = web.join("node_modules/.installed-from");
    if std::fs::read_to_string(&stamp).is_ok_and(|text| text == lock_hash) {
        already(name, "as in web/package-lock.json");
        return Ok(Node { lock_hash });
    }
    step(name, "npm ci in web/", || {
        let npm = if cfg!(windows) { "npm.cmd" } else { "npm" };
        shell::output(shell::command(npm).args(["ci", "--no-audit", "--no-fund"]).current_dir(&web))
            .context("npm could not install the tools of web/package-lock.json; this step needs the npm registry")?;
        paths::write(&stamp, lock_hash.as_bytes())
    })?;
    Ok(Node { lock_hash })
}

/// A command-line tool of an installed npm package, run by Node itself: the `.bin` links differ between systems.
pub(crate) fn tool(path_in_node_modules: &str) -> Command {
    let script: PathBuf = paths::root()
        .join("web/node_modules")
        .join(path_in_node_modules);
    let mut command = shell::command("node");
    command.arg(script);
    command
}

/// Two digits a byte.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
