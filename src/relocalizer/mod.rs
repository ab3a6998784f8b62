//! To be written.

pub mod focal;
pub mod smoothing;
pub mod timings;
pub mod tracking;
