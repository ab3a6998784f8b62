//! The commands of the tool, one file each: `Args` for clap and `run`. Keep alphabetical.

pub mod convert;
pub mod data;
pub mod demo;
pub mod eval;
pub mod export;
pub mod features;
pub mod inspect;
pub mod labels;
pub mod lines;
pub mod locate;
#[cfg(feature = "train")]
pub mod map;
pub mod pose;
#[cfg(feature = "train")]
pub mod sample;
#[cfg(feature = "train")]
pub mod train;
