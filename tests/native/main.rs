//! Native tests that cross a module. Keep alphabetical.

mod docs;
mod follow;
mod given_poses;
#[cfg(feature = "webgpu")]
mod gpu;
#[cfg(feature = "webgpu")]
mod gpu_frame;
#[cfg(feature = "webgpu")]
mod gpu_relocalizer;
mod layering;
mod lsd_golden;
mod lsd_inputs;
mod lsd_properties;
mod nn;
mod place;
mod portable;
mod pose;
mod rust;
mod tree;
mod words;

#[global_allocator]
static ALLOCATOR: landline_testkit::CountingAllocator = landline_testkit::CountingAllocator;
