//! The engine as wasm in headless Chromium. `cargo xtask test --only browser` runs it.

mod gpu;
mod lsd;

use wasm_bindgen_test::{wasm_bindgen_test, wasm_bindgen_test_configure};

wasm_bindgen_test_configure!(run_in_browser);

#[wasm_bindgen_test]
fn reports_the_version_of_the_workspace() {
    assert_eq!(landline_web::version(), env!("CARGO_PKG_VERSION"));
}
