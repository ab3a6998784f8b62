//! The engine as wasm under Node. `cargo xtask test --only node` runs it.

use wasm_bindgen_test::wasm_bindgen_test;

#[wasm_bindgen_test]
fn reports_the_version_of_the_workspace() {
    assert_eq!(landline_web::version(), env!("CARGO_PKG_VERSION"));
}
