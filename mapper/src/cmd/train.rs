//! `landline train`: from labels to a scene.

use crate::cmd::convert::PrecisionArg;
use crate::cmd::landmarks::{self, SizeArgs};
use crate::files;
use crate::labels::Labels;
use crate::timestamp::now;
use crate::train::export::{self, Statement};
use crate::train::run::{self, Control, RunOptions, Trained};
use crate::units::{Ruler, accuracy};
use crate::weights::load_extractor;
use anyhow::{Context, Result, bail};
use landline::models::{Preset, RegressorConfig};
use std::path::{Path, PathBuf};

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
    training: TrainingArgs,
}

/// What `train` and `map` share.
#[derive(Debug, clap::Args)]
pub struct TrainingArgs {
    /// Size and recipe: compact, standard or paper.
    #[arg(long, default_value = "compact", value_parser = parse_preset)]
    pub preset: Preset,
    /// Length of training; without it the preset's number of steps.
    #[arg(long)]
    pub minutes: Option<f64>,
    /// Steps of each branch.
    #[arg(long, conflicts_with = "minutes")]
    pub steps: Option<usize>,
    /// Most landmarks of the point branch.
    #[arg(long)]
    pub anchors: Option<usize>,
    /// Leave the line branch out.
    #[arg(long)]
    pub no_lines: bool,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Keep one picture in so many back, in one stretch, and deliver the state that locates them best; 0 keeps none.
    #[arg(long, default_value_t = 20)]
    pub hold_out_every: usize,
    /// Change a number of the recipe: FIELD=VALUE; may be repeated.
    #[arg(long = "set", value_name = "FIELD=VALUE", value_parser = parse_override)]
    pub overrides: Vec<String>,
    /// Change the network: point.FIELD=VALUE or line.FIELD=VALUE; may be repeated.
    #[arg(long = "network", value_name = "PATH=VALUE", value_parser = parse_network)]
    pub network: Vec<String>,
    /// Licence of the map; goes into the file.
    #[arg(long, default_value = "")]
    pub licence: String,
    /// Folder for options, log, curves and checkpoint; without it OUT with the ending `.run`.
    #[arg(long)]
    pub run: Option<PathBuf>,
    /// How large the scene may become.
    #[command(flatten)]
    pub size: SizeArgs,
    /// How weights are stored.
    #[arg(long, value_enum, default_value_t = PrecisionArg::Int8)]
    pub precision: PrecisionArg,
    /// Go on with an interrupted run in that folder.
    #[arg(long)]
    pub resume: bool,
}

fn parse_preset(text: &str) -> Result<Preset, String> {
    Preset::ALL
        .into_iter()
        .find(|p| p.name() == text)
        .ok_or_else(|| {
            let names: Vec<_> = Preset::ALL.iter().map(|p| p.name()).collect();
            format!("there is {}, not `{text}`", names.join(", "))
        })
}

fn parse_override(text: &str) -> Result<String, String> {
    run::check_override(text).map(|()| text.to_owned())
}

fn parse_network(text: &str) -> Result<String, String> {
    let fits = |preset| {
        let network = RegressorConfig::preset(preset, DESCRIPTOR_LEN);
        run::changed_network(&network, text)
    };
    // Which preset it is for is not known here; it must fit one.
    let outcomes: Vec<_> = Preset::ALL.into_iter().map(fits).collect();
    match outcomes.iter().find(|o| o.is_ok()) {
        Some(_) => Ok(text.to_owned()),
        None => outcomes
            .into_iter()
            .next()
            .map_or(Ok(text.to_owned()), |o| o.map(|_| text.to_owned())),
    }
}

/// Any that the presets accept, to check options before the labels are read.
const DESCRIPTOR_LEN: usize = 64;

impl TrainingArgs {
    /// The options of a run.
    pub fn options(&self) -> RunOptions {
        RunOptions {
            preset: self.preset,
            seed: self.seed,
            minutes: self.minutes,
            steps: self.steps,
            anchors: self.anchors,
            lines: !self.no_lines,
            hold_out_every: self.hold_out_every,
            overrides: self.overrides.clone(),
            network: self.network.clone(),
        }
    }
}

impl TrainingArgs {
    /// Runs from the command line go on until they end.
    pub fn control(&self) -> Control<'static> {
        Control {
            resume: self.resume,
            stop: &|_| false,
        }
    }

    /// Refuses a length that is none, before anything expensive happens.
    ///
    /// # Errors
    /// When `--minutes` is not positive.
    pub fn check(&self) -> Result<()> {
        if let Some(minutes) = self.minutes
            && !(minutes > 0.0 && minutes.is_finite())
        {
            bail!("--minutes is {minutes}; give a positive number");
        }
        Ok(())
    }

    /// The run folder that belongs to a scene file.
    pub fn run_folder(&self, out: &Path) -> PathBuf {
        self.run
            .clone()
            .unwrap_or_else(|| out.with_extension("run"))
    }
}

/// Trains and writes the scene.
///
/// # Errors
/// When there is too little to learn from, the run folder belongs to another run, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    args.training.check()?;
    let extractor = load_extractor(&args.extractor)?;
    let labels = Labels::read_for(&args.labels, extractor.kind, &extractor.source_sha256)?;
    train_and_write(&labels, &args.training, &args.out)
}

/// The part after the labels.
///
/// # Errors
/// As [`run`].
pub fn train_and_write(labels: &Labels, training: &TrainingArgs, out: &Path) -> Result<()> {
    // Before anything expensive happens.
    let created = now()?;
    let folder = training.run_folder(out);
    let device = crate::train::cpu_device();
    let options = training.options();
    let trained = run::train(labels, &options, &folder, &training.control(), &device)
        .with_context(|| format!("training {}", out.display()))?;
    print_summary(&trained, labels);
    let statement = Statement {
        preset: options.preset,
        licence: training.licence.clone(),
        created,
    };
    let mut scene = export::scene(&trained, labels, statement)?;
    let precision = training.precision.into();
    export::measure(&mut scene, labels, &trained.held, precision)?;
    landmarks::add(&mut scene, &labels.map, training.size, precision)?;
    let bytes = scene.to_bytes(precision)?;
    files::write_bytes(out, &bytes)?;
    println!("wrote {} ({} bytes)", out.display(), bytes.len());
    Ok(())
}

/// What the run learned, on standard output.
pub fn print_summary(trained: &Trained, labels: &Labels) {
    let units = labels.origin.units;
    let ruler = Ruler::of(units);
    for judged in &trained.held_out {
        println!(
            "{:?}: {} held-out pictures, best at step {}",
            judged.kind, judged.delivered.poses.num_images, judged.step
        );
        for (when, h) in [("before", &judged.start), ("after", &judged.delivered)] {
            println!(
                "  {when:6} {}, mean {}; features {:.2} px, {:.1} % within 6 px",
                accuracy(&h.poses, units),
                ruler.text(h.score),
                h.median_px,
                100.0 * h.share_within_6px
            );
        }
    }
    println!(
        "trained in {:.0} s, steps {:?}",
        trained.seconds, trained.steps
    );
}
