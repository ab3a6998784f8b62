//! Browser binding of landline: converts types and nothing else. The feature `locate` is what pages need to locate, `map` what
//! they need to make scenes; each is an artefact of its own, so that neither carries the other.
//!
//! JavaScript writes a frame's bytes into a buffer of the engine, calls `locate`, and reads the answer as flat numbers
//! whose layout `result` defines. Pixels are copied once, results once; no object is made per point.

#![cfg_attr(
    not(all(feature = "locate", feature = "map")),
    allow(dead_code, reason = "each artefact uses a part of what both share")
)]

mod error;
#[cfg(feature = "locate")]
mod follow;
mod frame;
#[cfg(feature = "locate")]
mod gpu;
#[cfg(feature = "map")]
mod mapper;
#[cfg(feature = "locate")]
mod place;
#[cfg(feature = "map")]
mod poses;
#[cfg(feature = "locate")]
mod relocalizer;
#[cfg(feature = "locate")]
mod result;

use landline::geometry::Units;
use wasm_bindgen::prelude::wasm_bindgen;

#[cfg(feature = "locate")]
pub use follow::RawFollower;
#[cfg(feature = "map")]
pub use mapper::RawMapper;
#[cfg(feature = "locate")]
pub use place::RawPlace;
#[cfg(feature = "map")]
pub use poses::read_poses;
#[cfg(feature = "locate")]
pub use relocalizer::RawRelocalizer;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = console, js_name = error)]
    fn console_error(text: &str);

    /// Milliseconds; pages, workers and Node have it.
    #[cfg(feature = "locate")]
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    fn performance_now() -> f64;
}

/// What JavaScript calls a unit of length.
fn units_name(units: Units) -> &'static str {
    match units {
        Units::Metres => "metres",
        Units::Arbitrary => "scene-units",
    }
}

/// Version of the package.
#[wasm_bindgen]
#[must_use]
pub fn version() -> String {
    env!("CARGO_PKG_VERSION").to_owned()
}

/// The build, by what its networks compute with: `plain`, or `relaxed` with the multiply-add of relaxed SIMD.
#[cfg(feature = "locate")]
#[wasm_bindgen]
#[must_use]
pub fn build() -> String {
    let level = landline::simd::Level::best();
    if level == landline::simd::Level::Portable {
        "plain".to_owned()
    } else {
        level.name().to_owned()
    }
}

/// Writes panics to the console: without it they show as `unreachable` and nothing else.
#[wasm_bindgen(start)]
pub fn start() {
    std::panic::set_hook(Box::new(|info| console_error(&format!("landline: {info}"))));
}
