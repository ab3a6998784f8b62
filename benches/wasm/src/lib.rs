//! Detector and solver alone in WebAssembly, for measurements beside their peers.

mod lsd;
mod pose;

use wasm_bindgen::prelude::wasm_bindgen;

pub use lsd::{NUMBERS_PER_SEGMENT, detect_segments};
pub use pose::PoseSolver;

#[wasm_bindgen]
extern "C" {
    /// Milliseconds; pages, workers and Node have it.
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    fn performance_now() -> f64;
}
