//! The networks on a GPU through WebGPU.
//!
//! * **In and out**: the same [`Graph`](super::Graph) and [`Weights`](super::Weights) as the CPU executor.
//! * **Method**: every operation is lowered to one or two kernel calls (`wgsl/`, each with the stem of its CPU twin);
//!   activations live in one arena placed by the same plan. Matrix products and convolutions use the tile shape that WebGPU
//!   engines converged on: 8 x 8 threads with four by four results each.
//! * **Invariants**: only the limits that WebGPU guarantees are used; no object is made after a network is loaded;
//!   results of compaction do not depend on timing; every failure is a [`GpuError`] that says why the CPU takes over, and
//!   none of them reaches a browser's console.
//! * **Cost**: [`FrameParts::cost`], known without a device.

#[cfg(not(target_arch = "wasm32"))]
mod blocking;
mod device;
mod error;
mod executor;
mod faults;
mod frame;
mod frame_plan;
mod fuse;
mod lower;
mod network;
mod pipelines;
mod readback;
mod select;
mod self_test;
mod storage;

#[cfg(not(target_arch = "wasm32"))]
pub use blocking::GpuExecutor;
pub use device::{AdapterChoice, GpuDevice};
pub use error::GpuError;
pub use executor::{GpuNetwork, Outputs};
#[cfg(feature = "faults")]
pub use faults::Fault;
pub use frame::{FrameResult, GpuFrame};
pub use frame_plan::{FrameParts, FramePorts, GpuPart, PictureParts};
pub use network::GpuCost;
pub use pipelines::Pipelines;
pub use readback::{MAP_DEADLINE_MS, Timer};
pub use select::GpuSelect;
pub use self_test::self_test;
pub use storage::WeightStorage;
