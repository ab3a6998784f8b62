//! The engine as wasm under Node.

use crate::tally::Tally;
use crate::{setup, shell};
use anyhow::Result;

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
    super::cargo_test(&mut cargo)
}
