//! `landline data`: what a data set holds.

use crate::dataset::{DataArgs, open};
use anyhow::Result;

/// Show what a data set holds, what would not be used, and why.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    data: DataArgs,
}

/// Prints the import table.
///
/// # Errors
/// When the data set cannot be read.
pub fn run(args: Args) -> Result<()> {
    print!("{}", open(&args.data)?.table());
    Ok(())
}
