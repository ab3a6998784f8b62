//! `cargo xtask demo`: from a fresh checkout to poses on the terminal, by all three builds, and a working page.
//! `cargo xtask sample`: makes the demo's sample scene anew.

use crate::{paths, serve, setup, shell, web};
use anyhow::Result;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

/// Sets up everything, locates the sample pictures natively, under Node and in Chromium, prints poses and errors, and
/// serves the demo page.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Stops before serving.
    #[arg(long)]
    no_serve: bool,
    /// Does not open the page in a browser.
    #[arg(long)]
    no_open: bool,
    /// Port of the page.
    #[arg(long, default_value_t = 8080)]
    port: u16,
}

/// Renders the sample room, teaches its scene, and writes the demo's sample files anew.
#[derive(Debug, clap::Args)]
pub(crate) struct SampleArgs {
    /// Passed on to the example `sample` of the mapper.
    #[arg(last = true)]
    rest: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    web::build()?;
    let saved = paths::target().join("demo");
    println!("\ndemo    the sample pictures, natively:");
    let mut locate = shell::command(setup::native_tool()?);
    // The kernels with the bits of wasm, so that the three may be compared to the last digits; the machine's best are
    // faster and differ from them by rounding.
    locate
        .args(["demo", "--kernels", "portable", "--extractor"])
        .arg(paths::package().join("xfeat.safetensors"))
        .arg("--save")
        .arg(&saved);
    shell::run(&mut locate)?;
    let server = Arc::new(serve::Server::bind(&serve::Args {
        port: args.port,
        ..serve::Args::default()
    })?);
    let serving = {
        let server = Arc::clone(&server);
        std::thread::spawn(move || server.answer_all())
    };
    println!("\ndemo    the same pixels by the npm package:");
    shell::run(&mut by_the_package(&saved, &server.url))?;
    if args.no_serve {
        return Ok(());
    }
    println!("\ndemo    the page is at {} (Ctrl+C stops)", server.url);
    if !args.no_open {
        open_browser(&server.url);
    }
    serving
        .join()
        .map_err(|_| anyhow::anyhow!("the server stopped"))
}

/// The script that holds Node and Chromium against the native poses.
fn by_the_package(saved: &Path, site: &str) -> Command {
    let sample = paths::root().join("www/scenes/sample");
    let mut node = shell::command("node");
    node.arg(paths::root().join("xtask/node/poses.mjs"))
        .arg(saved)
        .arg(sample.join("sample.json"))
        .arg(sample.join("sample.landline"))
        .arg(paths::package())
        .arg(site)
        .args(setup::installed_chromium());
    node
}

/// Opens the page where there is a screen; the address stands on the terminal anyway.
fn open_browser(url: &str) {
    let has_screen = cfg!(any(windows, target_os = "macos"))
        || ["DISPLAY", "WAYLAND_DISPLAY"]
            .iter()
            .any(|name| std::env::var_os(name).is_some());
    if !has_screen {
        return;
    }
    let opener = if cfg!(windows) {
        "explorer"
    } else if cfg!(target_os = "macos") {
        "open"
    } else {
        "xdg-open"
    };
    // Whether it worked shows on the screen.
    drop(shell::command(opener).arg(url).spawn());
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
            "--no-default-features",
            "--example",
            "sample",
            "--",
        ])
        .args(&args.rest);
    shell::run(cargo.env("LANDLINE_XFEAT_CHECKPOINT", weights.checkpoint))
}
