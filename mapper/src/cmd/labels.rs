//! `landline labels`: features and 3D targets of training pictures in one file.

use crate::args::TeachingArgs;
use crate::dataset::open;
use crate::extract::Extraction;
use crate::teach::{labels, variants};
use crate::terminal::Terminal;
use anyhow::{Context, Result};
use landline::front_end::FrontEndOptions;
use std::path::PathBuf;

/// Make training labels: extract features, match, triangulate points and lines, write one file.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    teaching: TeachingArgs,
    /// Image-space variants of each picture (turned, scaled, blurred, lit differently) to train on.
    #[arg(long, value_name = "N", default_value_t = 0)]
    variants: usize,
    /// The label file to write.
    #[arg(long, short)]
    out: PathBuf,
}

/// Makes the labels.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    let teaching = &args.teaching;
    let dataset = open(&teaching.data)?;
    print!("{}", dataset.table());
    let extractor = teaching.extractor.read()?;
    let options = FrontEndOptions::new(extractor.kind);
    let extraction = Extraction::new(extractor, options, teaching.features.as_deref());
    let model_points = teaching.has_model_points();
    let (mut made, _) = labels(&dataset, &extraction, model_points, &mut Terminal)?;
    variants(
        &dataset,
        &extraction,
        &mut made,
        args.variants,
        &mut Terminal,
    )?;
    made.write(&args.out)
        .with_context(|| format!("writing labels to {}", args.out.display()))?;
    println!("wrote {}", args.out.display());
    Ok(())
}
