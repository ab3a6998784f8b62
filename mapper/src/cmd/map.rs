//! `landline map`: from pictures with poses to a scene file in one go.

use crate::cmd::labels::TeachingArgs;
use crate::cmd::train::{TrainingArgs, train_and_write};
use anyhow::Result;
use std::path::PathBuf;

/// Teach a place: features, labels and training of its posed pictures, one scene file.
///
/// Features are cached in the run folder, or where `--features` says; an interrupted run goes on from there.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    teaching: TeachingArgs,
    /// Image-space variants of each picture (turned, scaled, blurred, lit differently) to train on.
    #[arg(long, value_name = "N", default_value_t = 2)]
    variants: usize,
    /// The scene file to write.
    #[arg(long, short)]
    out: PathBuf,
    #[command(flatten)]
    training: TrainingArgs,
}

/// Teaches a place.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated or learned, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    args.training.check()?;
    let folder = args.training.run_folder(&args.out);
    let taught = args
        .teaching
        .teach(Some(&folder.join("features")), args.variants)?;
    train_and_write(&taught.labels, &args.training, &args.out)
}
