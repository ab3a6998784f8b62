//! Set-up: everything the build and the tests need beyond a Rust toolchain, Node and Python.
//!
//! Each step looks whether its result is there, says what it does, and leaves either the whole result or nothing:
//! results are made under a temporary name and renamed. An interrupted set-up is continued by running it again.

mod apt;
mod browser;
mod native;
mod node;
mod rust;
mod wasm_bindgen;
mod weights;

use anyhow::Result;
use std::time::Instant;

pub(crate) use browser::{Browser, installed_chromium};
pub(crate) use native::{fast_tool, note_tests, tests_have_run, tool as native_tool};
pub(crate) use node::{Node, hex, tool as node_tool};
pub(crate) use wasm_bindgen::WasmBindgen;
pub(crate) use weights::Weights;

/// Sets up everything and does nothing else.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> Result<()> {
    let pins = crate::pins::toolchain()?;
    rust::toolchain()?;
    rust::wasm_target()?;
    wasm_bindgen::install(&pins)?;
    node::install(&pins)?;
    browser::install()?;
    gpu_driver();
    weights::fetch(&pins)?;
    Ok(())
}

/// What building the npm package needs.
#[derive(Debug)]
pub(crate) struct WebTools {
    pub(crate) wasm_bindgen: WasmBindgen,
    pub(crate) node: Node,
}

/// The steps for building the wasm and the TypeScript.
///
/// # Errors
///
/// When a step fails; the message says what to do.
pub(crate) fn web_tools() -> Result<WebTools> {
    let pins = crate::pins::toolchain()?;
    rust::toolchain()?;
    rust::wasm_target()?;
    let wasm_bindgen = wasm_bindgen::install(&pins)?;
    let node = node::install(&pins)?;
    Ok(WebTools { wasm_bindgen, node })
}

/// The step for building native code.
///
/// # Errors
///
/// When the compiler is too old.
pub(crate) fn native_tools() -> Result<()> {
    rust::toolchain()
}

/// The browser for tests.
///
/// # Errors
///
/// When there is none and it cannot be installed.
pub(crate) fn browser() -> Result<Browser> {
    browser::install()
}

/// The checkpoint of the default extractor.
///
/// # Errors
///
/// When it cannot be fetched or is not the pinned one.
pub(crate) fn weights() -> Result<Weights> {
    weights::fetch(&crate::pins::toolchain()?)
}

/// A software Vulkan driver for the GPU tests, where a package manager can bring one. Without it they are skipped
/// with a reason and counted, so this step never fails.
pub(crate) fn gpu_driver() {
    browser::vulkan_driver();
}

/// Says that a step has nothing to do.
fn already(name: &str, what: impl std::fmt::Display) {
    println!("set-up  {name}: {what}");
}

/// Runs one step that has something to do; says what, and how long it took.
fn step<T>(name: &str, doing: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
    println!("set-up  {name}: {doing} ...");
    let start = Instant::now();
    let result = work()?;
    println!(
        "set-up  {name}: done in {:.0} s",
        start.elapsed().as_secs_f64()
    );
    Ok(result)
}
