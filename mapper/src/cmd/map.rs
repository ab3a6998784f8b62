//! `landline map`: from pictures, with poses or without, to a scene file in one go.

use crate::args::{PosingArgs, RefiningArgs, SceneArgs, TeachingArgs, privacy};
use crate::aside::Aside;
use crate::dataset::{has_poses, open};
use crate::extract::Extraction;
use crate::files;
use crate::picture::is_video;
use crate::posing::{POSED_FILES, pose_pictures};
use crate::privacy::{Privacy, hold_back};
use crate::progress::Progress;
use crate::refining::refine;
use crate::run_lock::RunLock;
use crate::teach::{Request, teach};
use crate::terminal::Terminal;
#[cfg(feature = "train")]
use crate::{
    args::{TrainingArgs, WhenArgs},
    teach::Training,
};
use anyhow::{Context, Result, bail};
use landline::front_end::FrontEndOptions;
use landline::geometry::Units;
use std::path::PathBuf;

/// Teach a place: features, points and lines of its pictures, one scene file.
///
/// A folder of pictures without poses, or a video, is posed first (structure from motion); the unit of length is arbitrary
/// then, unless `--scale-from` or `--positions` says what it is. The networks begin as the place's landmarks, which locate by themselves. They are trained only where pictures that were
/// kept back show that these are not enough, or where options ask for it. Features are cached in the run folder, or where
/// `--features` says; an interrupted run goes on from there.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    teaching: TeachingArgs,
    /// The scene file to write.
    #[arg(long, short)]
    out: PathBuf,
    /// Write the labels too, as `landline labels` does.
    #[arg(long, value_name = "FILE")]
    labels: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArgs,
    /// What the scene holds back from strangers, at a cost in accuracy; several with commas.
    #[arg(long, value_delimiter = ',', value_name = "WHAT", value_parser = privacy())]
    privacy: Vec<Privacy>,
    #[command(flatten)]
    posing: PosingArgs,
    #[command(flatten)]
    refining: RefiningArgs,
    #[cfg(feature = "train")]
    #[command(flatten)]
    when: WhenArgs,
    /// Image-space variants of each picture (turned, scaled, blurred, lit differently), where networks are trained.
    #[cfg(feature = "train")]
    #[arg(long, value_name = "N", default_value_t = 2)]
    variants: usize,
    #[cfg(feature = "train")]
    #[command(flatten)]
    how: TrainingArgs,
    #[cfg(not(feature = "train"))]
    #[command(flatten)]
    _untrained: crate::args::Untrained,
}

/// Teaches a place.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated or learned, or the disk refuses.
pub fn run(mut args: Args) -> Result<()> {
    // Before anything expensive happens.
    let scene = args.scene.request()?;
    #[cfg(feature = "train")]
    let training = args.training()?;
    if args.out.is_dir() {
        bail!(
            "{} is a folder: --out names the scene's file, such as {}",
            args.out.display(),
            args.out.join("room.landline").display()
        );
    }
    let folder = args.scene.run_folder(&args.out);
    let _held = RunLock::hold(&folder)?;
    let data = &args.teaching.data;
    let has_own_poses = !is_video(&data.data) && has_poses(data);
    if let Some(option) = args.posing.metres_option() {
        if has_own_poses {
            bail!(
                "{option} is for pictures without poses, and {} has some: say what its lengths are with --units or --scale",
                data.data.display()
            );
        }
        if data.scale.is_some() || data.units.is_some() {
            bail!(
                "{option} says what lengths are, and so does --scale or --units: give one of them"
            );
        }
    }
    let model = folder.join("poses");
    let mut before = None;
    if !has_own_poses {
        if data.units == Some(Units::Metres) {
            bail!(
                "--units metres is for data whose poses are in metres: pictures alone do not tell how long anything is; \
                 --scale-from (a distance that you measured) or --positions does"
            );
        }
        std::fs::create_dir_all(&folder).with_context(|| format!("{}", folder.display()))?;
        // Another run's poses may be of other pictures.
        before = Aside::put(&model, &POSED_FILES)?;
    }
    let extractor = args.teaching.extractor.read()?;
    let options = FrontEndOptions::new(extractor.kind);
    let own_cache = folder.join("features");
    let cache = args.teaching.features.as_deref().unwrap_or(&own_cache);
    let extraction = Extraction::new(extractor, options, Some(cache));
    let data = &mut args.teaching.data;
    if !has_own_poses {
        let request = args.posing.request(&data.data, data.camera.as_ref())?;
        println!(
            "{} has no poses: they are found from the pictures",
            data.data.display()
        );
        let posed = pose_pictures(&request, &extraction, &model, Progress::Terminal)?;
        drop(before);
        print!("{}", posed.summary);
        println!("look at {}", posed.report.display());
        data.pictures = Some(posed.pictures);
        data.data = model;
        data.camera = None;
        if args.posing.metres_option().is_some() {
            data.units = Some(Units::Metres);
        }
    }
    let mut dataset = open(&args.teaching.data)?;
    print!("{}", dataset.table());
    if has_own_poses {
        let refining = args.refining.request(args.posing.unordered);
        let model_points = args.teaching.has_model_points();
        let progress = Progress::Terminal;
        let did = refine(
            &mut dataset,
            &extraction,
            refining,
            &scene,
            model_points,
            progress,
        )?;
        if let Some(line) = did {
            println!("poses: {line}");
        }
    }
    let precision = scene.precision;
    let request = Request {
        dataset: &dataset,
        extraction: &extraction,
        model_points: args.teaching.has_model_points(),
        scene,
        #[cfg(feature = "train")]
        training: Some(training),
    };
    let mut taught = teach(&request, &mut Terminal)
        .with_context(|| format!("teaching {}", args.out.display()))?;
    if let Some(path) = &args.labels {
        let labels = taught.labels.write(path);
        labels.with_context(|| format!("writing labels to {}", path.display()))?;
    }
    hold_back(&mut taught.scene, &args.privacy)?;
    let bytes = taught.scene.to_bytes(precision)?;
    files::write_bytes(&args.out, &bytes)?;
    println!("wrote {} ({} bytes)", args.out.display(), bytes.len());
    Ok(())
}

#[cfg(feature = "train")]
impl Args {
    fn training(&self) -> Result<Training> {
        let when = self.when.when(&self.how);
        let folder = self.scene.run_folder(&self.out);
        let mut training = self.how.training(when, &self.scene, folder)?;
        training.variants = self.variants;
        Ok(training)
    }
}
