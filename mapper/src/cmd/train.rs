//! `landline train`: from labels to a scene.

use crate::args::{SceneArgs, TrainingArgs};
use crate::files;
use crate::labels::Labels;
use crate::run_lock::RunLock;
use crate::teach::{When, add_landmarks, trained_scene};
use crate::terminal::Terminal;
use crate::weights::load_extractor;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Trains a scene from labels.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Labels, as `landline labels` writes them.
    labels: PathBuf,
    /// Scene file to write.
    #[arg(long)]
    out: PathBuf,
    /// The extractor that the labels were made with: a converted file or its published checkpoint.
    #[arg(long, value_name = "FILE", env = "LANDLINE_EXTRACTOR")]
    extractor: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    training: TrainingArgs,
}

/// Trains and writes the scene.
///
/// # Errors
/// When there is too little to learn from, the run folder belongs to another run, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    // Before anything expensive happens.
    let request = args.scene.request()?;
    let folder = args.scene.run_folder(&args.out);
    let _held = RunLock::hold(&folder)?;
    let training = args.training.training(When::Always, &args.scene, folder)?;
    let extractor = load_extractor(&args.extractor)?;
    let labels = Labels::read_for(&args.labels, extractor.kind, &extractor.source_sha256)?;
    let mut scene = trained_scene(&labels, &request, &training, &mut Terminal)
        .with_context(|| args.out.display().to_string())?;
    let (max_bytes, precision) = (request.max_bytes, request.precision);
    add_landmarks(&mut scene, &labels.map, max_bytes, precision, &mut Terminal)?;
    let bytes = scene.to_bytes(precision)?;
    files::write_bytes(&args.out, &bytes)?;
    println!("wrote {} ({} bytes)", args.out.display(), bytes.len());
    Ok(())
}
