//! `landline map`: from pictures with poses to a scene file in one go.

use crate::cmd::labels;
use crate::cmd::train::{TrainingArgs, train_and_write};
use crate::dataset::{DataArgs, Split, open};
use crate::extract::Extraction;
use crate::train::export::Origin;
use crate::weights::load_extractor;
use anyhow::Result;
use landline::relocalizer::FrontEndOptions;
use std::path::PathBuf;

/// Teach a place: features, labels and training of its posed pictures, one scene file.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    data: DataArgs,
    /// The extractor: a converted file or its published checkpoint.
    #[arg(long, value_name = "FILE", env = "LANDLINE_EXTRACTOR")]
    extractor: PathBuf,
    /// The scene file to write.
    #[arg(long, short)]
    out: PathBuf,
    /// Folder of cached features; an interrupted run goes on from there. Without it they lie in the run folder.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Image-space variants of each picture (turned, scaled, blurred, lit differently) to train on.
    #[arg(long, value_name = "N", default_value_t = 2)]
    variants: usize,
    /// Licence of the map; goes into the file.
    #[arg(long, default_value = "")]
    licence: String,
    #[command(flatten)]
    training: TrainingArgs,
}

/// Teaches a place.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated or learned, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    args.training.check()?;
    let dataset = open(&args.data)?;
    print!("{}", dataset.table());
    let extractor = load_extractor(&args.extractor)?;
    let options = FrontEndOptions::new(extractor.kind);
    let folder = args.training.run_folder(&args.out);
    let cache = args
        .features
        .clone()
        .unwrap_or_else(|| folder.join("features"));
    let extraction = Extraction::new(extractor, options, Some(&cache));
    let chosen: Vec<_> = dataset
        .of_split(Split::Train)
        .into_iter()
        .map(|i| &dataset.images[i])
        .collect();
    let labels = labels::make(&extraction, &chosen, args.variants)?;
    let origin = Origin {
        source: format!("{} pictures, {}", chosen.len(), dataset.format),
        licence: args.licence.clone(),
        working_max_side: options.max_side as u32,
        ..Origin::default()
    };
    train_and_write(
        &labels,
        &args.training,
        extraction.extractor(),
        origin,
        &args.out,
    )
}
