//! The engine as wasm under Node. `cargo xtask test --only node` runs it.

mod lsd;
mod nn;

use wasm_bindgen_test::wasm_bindgen_test;

#[wasm_bindgen_test]
fn reports_the_version_of_the_workspace() {
    assert_eq!(landline_web::version(), env!("CARGO_PKG_VERSION"));
}

/// The same inputs give the same bits as natively. `cargo xtask test` passes the native digest on; a run without it
/// says so and compares nothing.
#[wasm_bindgen_test]
fn gives_the_same_bits_as_the_native_build() {
    let digest = landline_testkit::portable::digest();
    match option_env!("LANDLINE_PORTABLE_DIGEST") {
        Some(native) => assert_eq!(digest, native, "left wasm, right native"),
        None => println!("skipped: no native digest to compare with; wasm gives {digest}"),
    }
}
