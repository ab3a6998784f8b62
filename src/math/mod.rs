//! Numbers without meaning: polynomial roots, robust statistics, sorting, the seeded generator, the software libm, a parallel loop.
//!
//! Input and output are plain `f64`; no spaces, no units.
//! Nothing here but [`parallel`], [`cholesky`] and [`order`] allocates; nothing reads a clock or depends on the target: native and wasm give the same bits.

pub mod cholesky;
pub mod elementary;
pub mod least_squares;
pub mod order;
pub mod parallel;
pub mod poly;
pub mod precise;
mod rng;
pub mod stats;

pub use rng::Rng;
