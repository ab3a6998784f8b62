//! Networks made from foreign checkpoints against numbers of the reference implementations.

mod extractors;
mod golden;
mod gpu;
mod hostile;
mod memory;
mod regressors;
mod threads;
mod torch;
