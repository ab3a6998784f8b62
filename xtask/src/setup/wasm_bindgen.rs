//! wasm-bindgen's command-line tools, at the version of the crate in the lock file. They are built from the
//! registry's source: prebuilt ones come from hosts that many networks do not reach.

use super::{already, step};
use crate::pins::Toolchain;
use crate::{paths, shell};
use anyhow::{Context as _, Result};
use std::path::PathBuf;

/// Where the tools are.
#[derive(Debug)]
pub(crate) struct WasmBindgen {
    pub(crate) cli: PathBuf,
    pub(crate) test_runner: PathBuf,
}

/// Finds or builds the tools.
pub(super) fn install(pins: &Toolchain) -> Result<WasmBindgen> {
    let name = "wasm-bindgen tools";
    let version = &pins.wasm_bindgen;
    let dir = paths::cache().join(format!("wasm-bindgen-{version}"));
    let suffix = std::env::consts::EXE_SUFFIX;
    let tools = WasmBindgen {
        cli: dir.join(format!("bin/wasm-bindgen{suffix}")),
        test_runner: dir.join(format!("bin/wasm-bindgen-test-runner{suffix}")),
    };
    if tools.cli.is_file() && tools.test_runner.is_file() {
        already(name, format_args!("{version} in {}", dir.display()));
        return Ok(tools);
    }
    step(
        name,
        &format!("building {version} (two minutes, once per machine)"),
        || {
            let scratch = paths::cache_scratch("wasm-bindgen")?;
            // Its own folder for the build, so that an interrupted one is continued.
            let build = paths::target().join("wasm-bindgen-cli");
            let install = |locked: bool| {
                let mut install = shell::cargo();
                install
                    .args(["install", "wasm-bindgen-cli", "--version", version])
                    .args(locked.then_some("--locked"))
                    .args(["--no-track", "--root"])
                    .arg(&*scratch)
                    // They run for a second or two: a third of the building time for twice of that.
                    .args(["--config", "profile.release.opt-level=0"])
                    .args(["--config", "profile.release.codegen-units=16"])
                    .env("CARGO_TARGET_DIR", &build)
                    .env_remove("RUSTFLAGS")
                    .env_remove("CARGO_ENCODED_RUSTFLAGS");
                shell::run(&mut install)
            };
            // The published lock file may name a dependency that a mirror of the registry does not carry (yet). The
            // tools themselves stay at the pinned version either way.
            if let Err(error) = install(true) {
                println!(
                    "        {error:#}; trying again with the dependencies that the registry offers"
                );
                install(false).with_context(|| {
                    format!(
                        "could not build wasm-bindgen-cli {version}; this step needs the crates registry once"
                    )
                })?;
            }
            paths::publish(&scratch, &dir)?;
            // Large, and of no further use; what cannot be removed does no harm.
            drop(std::fs::remove_dir_all(&build));
            Ok(())
        },
    )?;
    Ok(tools)
}
