//! The engine as wasm in headless Chromium, with WebGPU on Chromium's software adapter.

use crate::tally::Tally;
use crate::{setup, shell};
use anyhow::Result;

pub(crate) fn run() -> Result<Tally> {
    let tools = setup::web_tools()?;
    let browser = setup::browser()?;
    let mut cargo = shell::cargo();
    cargo
        .args([
            "test",
            "--package",
            "landline-web",
            "--target",
            "wasm32-unknown-unknown",
            "--test",
            "wasm_browser",
        ])
        .env_remove("RUSTFLAGS")
        .env("CARGO_ENCODED_RUSTFLAGS", "-C\u{1f}target-feature=+simd128")
        .env(
            "CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUNNER",
            &tools.wasm_bindgen.test_runner,
        )
        .env("CHROMEDRIVER", &browser.driver)
        .env("WASM_BINDGEN_TEST_TIMEOUT", "300");
    super::cargo_test(&mut cargo)
}
