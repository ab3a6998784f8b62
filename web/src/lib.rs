//! Browser binding of landline: converts types and nothing else.
//!
//! JavaScript writes a frame's bytes into a buffer of the engine, calls `locate`, and reads the answer as flat numbers
//! whose layout `result` defines. Pixels are copied once, results once; no object is made per point.

mod error;
mod follow;
mod gpu;
mod relocalizer;
mod result;

use wasm_bindgen::prelude::wasm_bindgen;

pub use follow::RawFollower;
pub use relocalizer::RawRelocalizer;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = console, js_name = error)]
    fn console_error(text: &str);

    /// Milliseconds; pages, workers and Node have it.
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    fn performance_now() -> f64;
}

/// Version of the package.
#[wasm_bindgen]
#[must_use]
pub fn version() -> String {
    env!("CARGO_PKG_VERSION").to_owned()
}

/// Writes panics to the console: without it they show as `unreachable` and nothing else.
#[wasm_bindgen(start)]
pub fn start() {
    std::panic::set_hook(Box::new(|info| console_error(&format!("landline: {info}"))));
}
