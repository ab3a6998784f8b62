//! `cargo xtask web`: from the crates and `web/ts` to the packed npm package and the staged demo page.
//!
//! For each build: cargo build → wasm-bindgen → wasm-opt → checks of the binary; then tsc → `dist/npm/landline` → npm pack → `dist/site`

pub(crate) mod api;
mod binary;
mod comments;
mod config;
mod package;
mod site;
pub(crate) mod size;
mod wasm;

use crate::{paths, setup};
use anyhow::{Result, anyhow, bail};
use config::{Build, BuildConfig};
use std::path::PathBuf;

pub(crate) use package::{tarball, workspace_value};

/// Builds the npm package and the demo page.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Build detector and solver alone instead, with the same flags, for `benches/*_node.mjs`.
    #[arg(long)]
    bench: bool,
    /// Build the binaries and their scripts alone, as they go into the package.
    #[arg(long, conflicts_with = "bench")]
    binaries: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if args.bench {
        return bench();
    }
    if args.binaries {
        return binaries().map(drop);
    }
    build()?;
    size::run(&size::Args {})
}

/// Builds everything; what is up to date is not built again.
///
/// # Errors
///
/// When a tool is missing or a stage fails.
pub(crate) fn build() -> Result<()> {
    let weights = setup::weights()?;
    let config = binaries()?;
    let scripts = package::compile_scripts()?;
    package::assemble(&config, &scripts, &weights)?;
    let tarball = package::pack()?;
    site::stage()?;
    println!("web     package: {}", tarball.display());
    println!("web     demo page: {}", paths::site().display());
    Ok(())
}

/// Builds the binaries with their scripts into `paths::bindgen()`, each checked; returns what they were built of.
fn binaries() -> Result<BuildConfig> {
    let tools = setup::web_tools()?;
    let config: BuildConfig = crate::pins::json("pkg-config/build.json")?;
    std::thread::scope(|scope| -> Result<()> {
        let mut finishing = Vec::new();
        for build in &config.builds {
            let raw = wasm::compile(&config, build)?;
            let (config, tools) = (&config, &tools);
            // wasm-opt spends half of its time on one core: the next build is compiled meanwhile.
            finishing.push(scope.spawn(move || -> Result<()> {
                let wasm = wasm::finish(config, build, tools, &raw, &folder(build))?;
                binary::check(&std::fs::read(&wasm)?, build, &config.allowed)
            }));
        }
        for work in finishing {
            work.join()
                .map_err(|_| anyhow!("wasm-bindgen or wasm-opt could not be run"))??;
        }
        Ok(())
    })?;
    for build in &config.builds {
        same_glue(build)?;
    }
    Ok(config)
}

/// Builds the binaries; returns them and their scripts, as paths below `paths::bindgen()`.
///
/// # Errors
///
/// When a tool is missing or a stage fails.
pub(crate) fn built_binaries() -> Result<Vec<String>> {
    let mut names = Vec::new();
    for build in &binaries()?.builds {
        let dir = folder(build);
        let dir = dir.strip_prefix(paths::bindgen())?.to_string_lossy();
        for file in [
            format!("{}_bg.wasm", build.glue()),
            format!("{}.js", build.glue()),
        ] {
            names.push(if dir.is_empty() {
                file
            } else {
                format!("{dir}/{file}")
            });
        }
    }
    Ok(names)
}

/// Builds the binary of the benches, which ships nowhere.
fn bench() -> Result<()> {
    let tools = setup::web_tools()?;
    let config = BuildConfig {
        crate_name: "landline-bench".to_owned(),
        ..crate::pins::json("pkg-config/build.json")?
    };
    let build = Build {
        out_name: "landline_bench".to_owned(),
        ..Build::default()
    };
    let dir = paths::root().join("target/web/bench");
    let raw = wasm::compile(&config, &build)?;
    wasm::finish(&config, &build, &tools, &raw, &dir)?;
    println!("web     for benches: {}", dir.display());
    Ok(())
}

/// Where the binary of a build and its glue are put. A build that shares another one's glue has a folder of its own.
fn folder(build: &Build) -> PathBuf {
    match &build.glue_of {
        None => paths::bindgen().join(&build.folder),
        Some(_) => paths::bindgen().join(&build.out_name),
    }
}

/// A build that is loaded with the script of another one has to have the same.
fn same_glue(build: &Build) -> Result<()> {
    let Some(other) = &build.glue_of else {
        return Ok(());
    };
    let script = format!("{other}.js");
    let own = std::fs::read(folder(build).join(&script))?;
    if own != std::fs::read(paths::bindgen().join(&build.folder).join(&script))? {
        bail!(
            "the script of the build {} is not that of {other}: they cannot share it",
            build.out_name
        );
    }
    Ok(())
}
