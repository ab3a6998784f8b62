//! Test support of landline. Used by `tests/`, `benches/` and the tests of `mapper` and `web`; the core's unit tests
//! keep their data inline. The examples of `mapper` render the demo's sample scene and walks with [`room`].

mod data;
mod film;
mod lsd;
mod memory;
mod nn_cases;
mod parallel;
pub mod portable;
mod portable_film;
mod pose_scene;
pub mod problem_file;
mod random_scene;
pub mod room;

#[cfg(not(target_arch = "wasm32"))]
pub use data::gpu_or_skip;
pub use data::{shared_data, skip};
pub use film::{film_camera, film_pictures};
pub use lsd::check_lsd_fingerprints;
pub use memory::{CountingAllocator, allocations, peak_bytes};
pub use nn_cases::{CPU_KINDS, NN_KINDS, NnCase, nn_case, nn_cases, random_weights};
pub use pose_scene::{PoseScene, PoseSceneParams, pose_scene};
pub use random_scene::{random_picture, random_scene, scaled_weights};
