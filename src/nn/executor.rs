//! What every executor on the CPU can do.

use super::{error::NnError, graph::Graph};

/// Runs one graph. Write the counts, then the inputs, run, read the outputs.
///
/// Inputs are used up by a run: write them again before the next one.
pub trait Executor {
    /// The graph that is run.
    fn graph(&self) -> &Graph;

    /// Sets a run-time number of rows. Counts start at their capacity.
    ///
    /// # Errors
    /// [`NnError::UnknownName`], [`NnError::CountTooLarge`], [`NnError::CountIsDerived`].
    fn set_count(&mut self, name: &str, count: usize) -> Result<(), NnError>;

    /// Number of rows set, or computed by the last run.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    fn count(&self, name: &str) -> Result<usize, NnError>;

    /// Room for an input at the current counts: rows times channels numbers, row-major.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    fn input(&mut self, name: &str) -> Result<&mut [f32], NnError>;

    /// Computes all outputs. Allocates nothing.
    ///
    /// # Errors
    /// None on the CPU; [`NnError::Device`] from executors on a device, which can be lost.
    fn run(&mut self) -> Result<(), NnError>;

    /// An output of the last run at the current counts, row-major.
    ///
    /// # Errors
    /// [`NnError::UnknownName`].
    fn output(&self, name: &str) -> Result<&[f32], NnError>;
}
