//! The engine as wasm under Node.

use crate::tally::Tally;
use crate::{paths, setup, shell};
use anyhow::{Context as _, Result};
use std::fs;

pub(crate) fn run() -> Result<Tally> {
    let tools = setup::web_tools()?;
    let mut cargo = shell::cargo();
    cargo
        .args([
            "test",
            "--package",
            "landline-web",
            "--target",
            "wasm32-unknown-unknown",
            "--test",
            "wasm_node",
        ])
        .env_remove("RUSTFLAGS")
        .env("CARGO_ENCODED_RUSTFLAGS", "-C\u{1f}target-feature=+simd128")
        .env(
            "CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUNNER",
            &tools.wasm_bindgen.test_runner,
        );
    cargo.env("LANDLINE_PORTABLE_DIGEST", native_digest()?);
    super::cargo_test(&mut cargo)
}

/// The digest of `testkit::portable` that the native test of that name wrote down. The native tier made it if it ran;
/// alone, this tier makes it.
fn native_digest() -> Result<String> {
    let file = paths::target().join("tmp/portable-digest.txt");
    if !setup::tests_have_run() {
        shell::output(shell::cargo().args([
            "test",
            "--package",
            "landline",
            "--test",
            "native",
            "--",
            "portable",
        ]))?;
    }
    let digest = fs::read_to_string(&file)
        .with_context(|| format!("the native tests left no {}", file.display()))?;
    println!("node    native digest: {digest}");
    Ok(digest)
}
