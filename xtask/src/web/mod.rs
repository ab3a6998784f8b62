//! `cargo xtask web`: from the crates and `web/ts` to the packed npm package and the staged demo page.
//!
//! cargo build → wasm-bindgen → wasm-opt → checks of the binary → tsc → `dist/npm/landline` → npm pack → `dist/site`

pub(crate) mod api;
mod binary;
mod config;
mod package;
mod site;
pub(crate) mod size;
mod wasm;

use crate::{paths, setup};
use anyhow::Result;
use config::{Artefact, BuildConfig};

pub(crate) use package::{tarball, workspace_value};

/// Builds the npm package and the demo page.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Build detector and solver alone instead, with the same flags, for `benches/*_node.mjs`.
    #[arg(long)]
    bench: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if args.bench {
        return bench();
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
    let tools = setup::web_tools()?;
    let weights = setup::weights()?;
    let config: BuildConfig = crate::pins::json("pkg-config/build.json")?;
    for artefact in &config.artefacts {
        let dir = paths::bindgen().join(&artefact.folder);
        let wasm = wasm::build(&config, artefact, &tools, &dir)?;
        binary::check(&std::fs::read(&wasm)?, &config.proposals)?;
    }
    let scripts = package::compile_scripts()?;
    package::assemble(&config, &scripts, &weights)?;
    let tarball = package::pack()?;
    site::stage()?;
    println!("web     package: {}", tarball.display());
    println!("web     demo page: {}", paths::site().display());
    Ok(())
}

/// Builds the binary of the benches, which ships nowhere.
fn bench() -> Result<()> {
    let tools = setup::web_tools()?;
    let config = BuildConfig {
        crate_name: "landline-bench".to_owned(),
        ..crate::pins::json("pkg-config/build.json")?
    };
    let artefact = Artefact {
        out_name: "landline_bench".to_owned(),
        folder: String::new(),
        feature: String::new(),
    };
    let dir = paths::root().join("target/web/bench");
    wasm::build(&config, &artefact, &tools, &dir)?;
    println!("web     for benches: {}", dir.display());
    Ok(())
}
