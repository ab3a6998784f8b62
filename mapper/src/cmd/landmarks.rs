//! `landline landmarks`: gives a scene the landmarks of its labels.

use crate::cmd::convert::PrecisionArg;
use crate::files;
use crate::labels::Labels;
use crate::scene::read_scene;
use anyhow::{Context, Result};
use landline::landmarks::from_map::{Budget, table};
use landline::reconstruction::Reconstruction;
use landline::scene_file::{Precision, SceneFile};
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
    #[arg(long, value_enum, default_value_t = PrecisionArg::Int8)]
    precision: PrecisionArg,
}

/// How large a scene may become.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct SizeArgs {
    /// Most bytes of the scene file: landmarks take what the networks leave. Without it 400,000, or what the networks take
    /// and 140,000.
    #[arg(long, value_name = "N")]
    pub max_bytes: Option<usize>,
}

/// Bytes of a scene, and of its landmarks at least, when nobody says.
const USUAL_BYTES: usize = 400_000;
const USUAL_TABLE: usize = 140_000;

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
    let precision = args.precision.into();
    add(&mut scene, &labels.map, args.size, precision)?;
    let bytes = scene.to_bytes(precision)?;
    files::write_bytes(&args.out, &bytes)
        .with_context(|| format!("writing {}", args.out.display()))?;
    println!("wrote {} ({} bytes)", args.out.display(), bytes.len());
    Ok(())
}

/// Gives a scene the landmarks of its map, as many as the size allows, and says how many.
///
/// # Errors
/// When the map has none, or the size is too small.
pub fn add(
    scene: &mut SceneFile,
    map: &Reconstruction,
    size: SizeArgs,
    precision: Precision,
) -> Result<()> {
    scene.landmarks = None;
    let networks = scene.to_bytes(precision)?.len();
    let usual = USUAL_BYTES.max(networks + USUAL_TABLE);
    let budget = Budget {
        max_bytes: size.max_bytes.unwrap_or(usual),
        networks,
    };
    let table = table(map, budget).context("landmarks")?;
    println!(
        "landmarks: {} points and {} lines, {} clusters of views",
        table.point_positions.len(),
        table.line_positions.len(),
        table.num_clusters
    );
    scene.landmarks = Some(table);
    Ok(())
}
