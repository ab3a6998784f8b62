//! Vectors of `f32`, one definition for every module with inner loops of its own.
//!
//! In and out: a generic kernel over the vector trait, compiled by the macro `entry` for every instruction set of the target;
//! a [`Level`] says which of them runs.
//! Invariants: on [`Level::Portable`] the same bits on every target; a level exists only where its instructions do.
//! Cost: the level is chosen once for each call of a kernel.

pub(crate) mod kernels;

pub use kernels::Level;
