//! Many rooms: which of a place's scenes a frame was taken in, and where in it.
//!
//! * **In and out**: a manifest ([`PlaceManifest`]), an index ([`PlaceIndex`]), scenes as they are needed; frames. A
//!   [`PlaceReport`] for each frame: the room, the pose in the room, and in the place where its transform is known.
//! * **Spaces and units**: a pose is in its room's world; [`Placed`] leads from there into the frame of the place.
//! * **Method**: a frame's features are made once. The index ranks the rooms by their nearest landmarks' votes; the best few are
//!   solved; the calibrated confidence and how much of the room was found again accept one, and two rooms that both claim a
//!   frame make it ambiguous. Afterwards the room stays as long as it answers.
//! * **Invariants**: deterministic; the same ranking natively and in wasm. Nothing is read: scenes that are wanted are named,
//!   and the caller brings them.
//! * **Cost**: in a room that is known what the scene alone costs; else the ranking, about a millisecond, and a solution for
//!   each candidate.

mod claim;
mod error;
mod index;
mod locator;
mod manifest;
mod words;

pub use error::PlaceError;
pub use index::{INDEX_VERSION, PlaceIndex, RoomScore};
pub use locator::{Place, PlaceOptions, PlaceReport};
pub use manifest::{FileRef, PLACE_VERSION, PlaceManifest, Placed, RoomEntry};
