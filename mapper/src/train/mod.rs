//! Training with burn, the only place that uses it.
//!
//! * **In**: [`crate::labels::Labels`] (features with 3D targets) and a configuration of `landline::models`.
//! * **Out**: the tensors of that configuration, for a scene file.
//! * **Units**: coordinates in metres in the losses, in nominal ones ([`landline::geometry::SceneScale::nominal_metre`]) where the
//!   world's unit is unknown, so that limits mean the same in a world of millimetres; networks see those of [`landline::geometry::SceneScale`].
//! * **Method**: branches anchored on landmarks learn from rows drawn over all pictures (as ACE); branches with attention
//!   learn from whole pictures. Losses of the paper, equations 3 to 5, in the forms that [`session`] documents.
//! * **Invariants**: the same seed, data and options give the same tensors on the CPU, interrupted or not.
//! * **Cost**: a step of the default preset compares 2,048 descriptors with 2,048 keys, forwards and backwards.

pub mod buffer;
pub mod checkpoint;
pub mod curves;
pub mod held_out;
mod identity;
pub mod init;
pub mod loss;
pub mod net;
pub mod params;
pub mod recipe;
pub mod run;
pub mod schedule;
pub mod session;

/// The CPU as burn's device. Commands pass it on without knowing burn.
pub fn cpu_device() -> burn::tensor::Device {
    burn::tensor::Device::flex()
}
