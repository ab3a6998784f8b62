//! `landline landmarks`: gives a scene the landmarks of its labels.

use crate::args::{SizeArgs, precision};
use crate::files;
use crate::labels::Labels;
use crate::scene::read_scene;
use crate::teach::add_landmarks;
use crate::terminal::Terminal;
use anyhow::{Context, Result};
use landline::scene_file::Precision;
use std::path::PathBuf;

/// Give a scene the landmarks that are looked for again once a pose is known.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// The labels that it was taught with.
    labels: PathBuf,
    /// Scene file to write.
    #[arg(long, short)]
    out: PathBuf,
    #[command(flatten)]
    size: SizeArgs,
    /// How weights are stored.
    #[arg(long, default_value = "int8", value_name = "PRECISION", value_parser = precision())]
    precision: Precision,
}

/// Adds the landmarks.
///
/// # Errors
/// When a file cannot be read or written, or the budget is too small.
pub fn run(args: Args) -> Result<()> {
    let (mut scene, _) = read_scene(&args.scene)?;
    let labels = Labels::read_for(
        &args.labels,
        scene.info.extractor,
        &scene.info.extractor_sha256,
    )?;
    let max_bytes = args.size.max_bytes;
    add_landmarks(
        &mut scene,
        &labels.map,
        max_bytes,
        args.precision,
        &mut Terminal,
    )?;
    let bytes = scene.to_bytes(args.precision)?;
    files::write_bytes(&args.out, &bytes)
        .with_context(|| format!("writing {}", args.out.display()))?;
    println!("wrote {} ({} bytes)", args.out.display(), bytes.len());
    Ok(())
}
