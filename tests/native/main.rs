//! Native tests that cross a module.

#[cfg(feature = "webgpu")]
mod gpu;
mod nn;
