//! `landline poses`: poses of pictures that have none, as a COLMAP model.

use crate::args::{ExtractorArgs, PosingArgs};
use crate::dataset::OneOnly;
use crate::extract::Extraction;
use crate::posing::pose_pictures;
use crate::progress::Progress;
use anyhow::{Result, bail};
use landline::front_end::FrontEndOptions;
use std::path::PathBuf;

/// Find the poses of pictures or of a video (structure from motion) and write a COLMAP model.
///
/// The unit of length is arbitrary, unless `--scale-from` or `--positions` says what it is. Pictures of one size share one camera. If the place falls into several pieces, the largest
/// is written and the others are told.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of pictures in the order of their names, or a video (read by the program `ffmpeg`).
    pictures: PathBuf,
    #[command(flatten)]
    _one: OneOnly,
    /// Folder of the COLMAP model to write, binary and text; it must not be there yet.
    #[arg(long, short)]
    out: PathBuf,
    /// The camera of all pictures: MODEL,width,height,parameters in COLMAP's order.
    #[arg(long, value_name = "MODEL,W,H,...", value_parser = crate::dataset::parse_camera)]
    camera: Option<landline::geometry::CameraRecord>,
    #[command(flatten)]
    posing: PosingArgs,
    /// Folder of cached features; an interrupted run goes on from there.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    #[command(flatten)]
    extractor: ExtractorArgs,
}

/// Poses the pictures.
///
/// # Errors
/// When there are too few pictures, they cannot be read, nothing can be reconstructed, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    if std::fs::read_dir(&args.out).is_ok_and(|mut entries| entries.next().is_some()) {
        bail!(
            "{} is there already and not empty: name another folder, or remove it",
            args.out.display()
        );
    }
    let request = args.posing.request(&args.pictures, args.camera.as_ref())?;
    let extractor = args.extractor.read()?;
    let options = FrontEndOptions::new(extractor.kind);
    let extraction = Extraction::new(extractor, options, args.features.as_deref());
    let posed = pose_pictures(&request, &extraction, &args.out, Progress::Terminal)?;
    print!("{}", posed.summary);
    println!("wrote {}", args.out.display());
    println!("look at {}", posed.report.display());
    Ok(())
}
