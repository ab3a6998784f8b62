//! `landline train` of a build without training.

use crate::args::UNTRAINED;
use anyhow::{Result, bail};

/// Trains a scene from labels, in a build with training.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Whatever was asked for.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    rest: Vec<String>,
}

/// Says that there is none.
///
/// # Errors
/// In any case.
pub fn run(_: Args) -> Result<()> {
    bail!("{UNTRAINED}")
}
