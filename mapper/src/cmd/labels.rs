//! `landline labels`: features and 3D targets of training pictures in one file.

use crate::dataset::{DataArgs, DatasetImage, Split, open};
use crate::extract::Extraction;
use crate::labels::{LabelParams, Labels, add_variants, build};
use crate::progress::Progress;
use crate::scene::ExtractorArgs;
use anyhow::{Context, Result};
use landline::relocalizer::FrontEndOptions;
use std::path::PathBuf;
use std::time::Instant;

/// Make training labels: extract features, match, triangulate points and lines, write one file.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    extractor: ExtractorArgs,
    /// The label file to write.
    #[arg(long, short)]
    out: PathBuf,
    /// Folder of cached features; an interrupted run goes on from there.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Image-space variants of each picture (turned, scaled, blurred, lit differently) to train on.
    #[arg(long, value_name = "N", default_value_t = 0)]
    variants: usize,
}

/// Makes the labels.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    let dataset = open(&args.data)?;
    print!("{}", dataset.table());
    let extractor = args.extractor.read()?;
    let options = FrontEndOptions::new(extractor.kind);
    let extraction = Extraction::new(extractor, options, args.features.as_deref());
    let chosen: Vec<_> = dataset
        .of_split(Split::Train)
        .into_iter()
        .map(|i| &dataset.images[i])
        .collect();
    let labels = make(&extraction, &chosen, args.variants)?;
    labels
        .write(&args.out)
        .with_context(|| format!("writing labels to {}", args.out.display()))?;
    println!("wrote {}", args.out.display());
    Ok(())
}

/// Features and labels of training pictures, with so many variants of each, and a report on standard output.
///
/// # Errors
/// When a picture cannot be read or nothing can be triangulated.
pub fn make(extraction: &Extraction, images: &[&DatasetImage], variants: usize) -> Result<Labels> {
    let start = Instant::now();
    let features = extraction.all(images, Progress::Terminal)?;
    let posed: Vec<&DatasetImage> = images
        .iter()
        .filter(|i| i.cam_from_world.is_some())
        .copied()
        .collect();
    let changed = extraction.all_variants(&posed, variants, Progress::Terminal)?;
    println!("Features: {:.1} s", start.elapsed().as_secs_f64());
    let start = Instant::now();
    let (mut labels, stats) = build(
        images,
        features,
        &extraction.maker(),
        &LabelParams::default(),
        &Progress::Terminal,
    )?;
    print!("{stats}");
    if variants > 0 {
        print!("{}", add_variants(&mut labels, changed));
    }
    println!("Labels: {:.1} s", start.elapsed().as_secs_f64());
    Ok(labels)
}
