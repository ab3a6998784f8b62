//! The commands of the tool, one file each: `Args` for clap and `run`. Keep alphabetical.

pub mod convert;
pub mod data;
pub mod demo;
pub mod eval;
pub mod export;
pub mod features;
pub mod flow;
pub mod inspect;
pub mod labels;
pub mod landmarks;
pub mod lines;
pub mod locate;
pub mod map;
pub mod map_all;
pub mod paper;
pub mod place;
pub mod poses;
#[cfg(feature = "train")]
pub mod train;
#[cfg(not(feature = "train"))]
pub mod untrained;
