//! The map that is looked at again once a pose is known: many landmarks with short codes, and the guided matcher.
//!
//! * **In and out**: a [`LandmarkTable`] (what a scene file stores), made into [`Landmarks`] (what a frame is matched with); features
//!   of a frame and a pose that is roughly right; the pose that everything found again gives, and the share that was found.
//! * **Spaces and units**: world units as given; pixels of the working image.
//! * **Method**: where a first pose is missing or wrong, votes for what was seen together give another; [`guided`] projects what the pose shows, searches a shrinking window by descriptor, and refines the pose;
//!   [`code`] the descriptors, [`table`] the quantisation, [`build`] the way from tracks to a table.
//! * **Invariants**: deterministic; the same bits natively and in wasm (f32 sums in a fixed order, no fused operation). No
//!   allocation once a frame of the size was seen.
//! * **Cost**: linear in the landmarks for the projection, in what lies in the windows for the descriptors.

pub mod anchors;
pub mod build;
pub mod code;
pub mod from_map;
mod grid;
pub mod guided;
mod intrinsics;
mod lines;
mod ready;
mod recall;
pub mod table;
#[cfg(test)]
mod tests;
pub mod view;

pub use guided::{FoundAgain, LookOptions, SecondLook};
pub use intrinsics::SolvedCamera;
pub use ready::Landmarks;
pub use table::{LandmarkError, LandmarkTable};
