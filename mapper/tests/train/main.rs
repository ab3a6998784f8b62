//! The trainer: its losses against numbers worked out by hand, its forward passes against the executor that ships, and
//! interrupted runs against whole ones.
#![cfg(feature = "train")]

mod losses;
mod parity;
mod resume;
mod room;
