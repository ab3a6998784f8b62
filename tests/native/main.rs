//! Native tests that cross a module.

#[cfg(feature = "webgpu")]
mod gpu;
mod lsd_golden;
mod nn;
