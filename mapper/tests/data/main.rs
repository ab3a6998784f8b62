//! Data sets, labels and evaluation across modules.

mod cameras;
mod cases;
mod disk;
mod evaluation;
mod folder;
mod imported;
mod labels;
mod mistakes;
mod output;
mod paper;
mod place;
mod readers;
mod room;
mod splits;
mod teach;

/// Some tests bound the memory that hostile files take.
#[global_allocator]
static ALLOCATOR: landline_testkit::CountingAllocator = landline_testkit::CountingAllocator;
