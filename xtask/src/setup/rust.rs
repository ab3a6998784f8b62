//! The Rust compiler and its wasm target.

use super::{already, step};
use crate::{pins, shell};
use anyhow::{Context as _, Result, bail};
use std::path::Path;

/// Checks the compiler against `rust-version` of the workspace.
pub(super) fn toolchain() -> Result<()> {
    let rustc = rustc();
    let said = shell::output(shell::command(&rustc).arg("--version"))?;
    let found = version(&said).with_context(|| format!("`rustc --version` printed {said:?}"))?;
    let manifest = pins::text("Cargo.toml")?;
    let wanted = manifest
        .lines()
        .find_map(|line| line.strip_prefix("rust-version = \""))
        .and_then(|rest| version(&format!("rustc {rest}")))
        .context("Cargo.toml has no rust-version")?;
    if found < wanted {
        bail!(
            "rustc {}.{} is too old, landline needs {}.{} or newer: run `rustup update stable`",
            found.0,
            found.1,
            wanted.0,
            wanted.1
        );
    }
    Ok(())
}

/// Adds the wasm target, which every wasm build needs.
pub(super) fn wasm_target() -> Result<()> {
    const TARGET: &str = "wasm32-unknown-unknown";
    let name = "wasm target";
    let sysroot = shell::output(shell::command(rustc()).args(["--print", "sysroot"]))?;
    if Path::new(sysroot.trim())
        .join("lib/rustlib")
        .join(TARGET)
        .join("lib")
        .is_dir()
    {
        already(name, TARGET);
        return Ok(());
    }
    if shell::find("rustup").is_none() {
        bail!(
            "the Rust target {TARGET} is missing and there is no rustup to add it: install rustup, or the package of \
             your system that brings this target"
        );
    }
    step(name, "rustup adds it", || {
        shell::output(shell::command("rustup").args(["target", "add", TARGET]))
            .context("rustup could not add the wasm target; this step needs the network")
            .map(drop)
    })
}

fn rustc() -> std::ffi::OsString {
    std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())
}

/// Major and minor number in a line such as `rustc 1.95.0 (59807616e 2026-04-14)`.
fn version(line: &str) -> Option<(u32, u32)> {
    let mut numbers = line.split_whitespace().nth(1)?.split(['.', '"', '-']);
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::version;

    #[test]
    fn reads_versions_with_and_without_suffix() {
        assert_eq!(
            version("rustc 1.95.0 (59807616e 2026-04-14)"),
            Some((1, 95))
        );
        assert_eq!(
            version("rustc 1.97.0-nightly (abc 2026-06-01)"),
            Some((1, 97))
        );
        assert_eq!(version("rustc 1.95\""), Some((1, 95)));
        assert_eq!(version("rustc"), None);
    }
}
