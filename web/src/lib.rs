//! Browser binding of landline: converts types and nothing else.

use wasm_bindgen::prelude::wasm_bindgen;

/// Version of the package.
#[wasm_bindgen]
#[must_use]
pub fn version() -> String {
    env!("CARGO_PKG_VERSION").to_owned()
}
