//! Library behind the native tool `landline`: data set readers, labels, training, evaluation, model conversion.

// First, because modules below it print with its macros.
#[macro_use]
pub mod output;

pub mod args;
pub mod aside;
pub mod asked;
pub mod augment;
pub mod cmd;
pub mod dataset;
pub mod device;
pub mod draw;
pub mod eval;
pub mod export;
pub mod extract;
pub mod feature_cache;
pub mod files;
mod html;
pub mod import;
pub mod labels;
pub mod metres;
pub mod overlay;
pub mod paper;
pub mod picture;
pub mod place;
mod plot;
pub mod posing;
pub mod privacy;
pub mod progress;
pub mod refining;
pub mod reveals;
pub mod run_lock;
pub mod scene;
pub mod shown;
pub mod teach;
pub mod terminal;
pub mod timestamp;
#[cfg(feature = "train")]
pub mod train;
pub mod units;
pub mod unposed;
pub mod weights;
pub mod words;
pub mod working;
