//! `landline labels`: features and 3D targets of training pictures in one file.

use crate::dataset::{DataArgs, Split, open};
use crate::feature_cache::FeatureCache;
use crate::labels::{LabelParams, build};
use crate::progress::Progress;
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::time::Instant;

/// Make training labels: extract features, match, triangulate points and lines, write one file.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    data: DataArgs,
    /// The label file to write.
    #[arg(long, short)]
    out: PathBuf,
    /// Folder of cached features.
    #[arg(long, value_name = "DIR")]
    features: PathBuf,
}

/// Makes the labels.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    let dataset = open(&args.data)?;
    print!("{}", dataset.table());
    let cache = FeatureCache::new(&args.features, "xfeat");
    let chosen: Vec<_> = dataset
        .of_split(Split::Train)
        .into_iter()
        .map(|i| &dataset.images[i])
        .collect();
    let mut features = Vec::with_capacity(chosen.len());
    for image in &chosen {
        match cache.read(&image.name)? {
            Some(f) => features.push(f),
            None => bail!(
                "no cached features of {} in {}",
                image.name,
                args.features.display()
            ),
        }
    }
    let start = Instant::now();
    let (labels, stats) = build(
        &chosen,
        features,
        cache.maker(),
        &LabelParams::default(),
        &Progress::Terminal,
    )?;
    print!("{stats}");
    println!(
        "  time               {:.1} s",
        start.elapsed().as_secs_f64()
    );
    labels
        .write(&args.out)
        .with_context(|| format!("writing labels to {}", args.out.display()))?;
    println!("wrote {}", args.out.display());
    Ok(())
}
