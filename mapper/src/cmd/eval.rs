//! `landline eval`: accuracy of a scene on pictures with known poses.

use crate::args::{KernelArgs, TeachingArgs, device, usual_run_folder};
use crate::dataset::{Dataset, DatasetImage, Split, open};
use crate::device;
use crate::eval::{
    EvalOptions, Evaluation, Evaluator, FullMatching, Landmarks, LineTruth, Subject, baseline_size,
    table, to_json, write_report,
};
use crate::extract::Extraction;
use crate::files::write_bytes;
use crate::labels::Labels;
use crate::picture;
use crate::progress::Progress;
use crate::scene::{front_end_options, read_scene, relocalizer};
use crate::teach;
use crate::terminal::Bars;
use crate::units::Ruler;
use crate::{export, overlay};
use anyhow::{Context, Result, bail};
use landline::relocalizer::{Device, RelocalizerOptions};
use landline::scene_file::{HeldOut, SceneFile, Units};
use std::path::{Path, PathBuf};

/// Evaluate a scene on the test pictures of a data set, with the nearest-landmark baseline beside it.
///
/// Printed are medians and recall of points with lines, points only, lines only and the baseline (as many landmarks as fit
/// the scene file's bytes, same features, same solver); whether lines help, with a bootstrap over pictures; the share of
/// predicted lines that lie on triangulated ones; and the time of each stage. Features are those of the run that made the
/// scene where its folder is there, or of `--features`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    #[command(flatten)]
    teaching: TeachingArgs,
    /// Label file whose tracks give the baseline its landmarks and the lines their truth; made from the training pictures
    /// when not given.
    #[arg(long, value_name = "FILE")]
    labels: Option<PathBuf>,
    /// Landmarks of the baseline; as many as fit the scene file's bytes when not given.
    #[arg(long, value_name = "N")]
    landmarks: Option<usize>,
    /// Measure another method on the same pictures, with all features of the taught ones.
    #[arg(
        long,
        value_enum,
        value_name = "METHOD",
        conflicts_with = "no_baseline"
    )]
    peer: Option<Peer>,
    /// Leave out what needs labels: the baseline and the comparison of lines.
    #[arg(long)]
    no_baseline: bool,
    /// Most points that go to the solver.
    #[arg(long, value_name = "N")]
    max_points: Option<usize>,
    /// Most lines that go to the solver.
    #[arg(long, value_name = "N")]
    max_lines: Option<usize>,
    #[command(flatten)]
    kernels: KernelArgs,
    /// What runs the networks.
    #[arg(long, default_value = "cpu", value_name = "DEVICE", value_parser = device())]
    device: Device,
    /// Solve each picture so many times, with different seeds; figures are of all of them.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
    /// Write the accuracy into the scene file, as its held-out accuracy; nothing else of the file changes.
    #[arg(long)]
    record: bool,
    /// Folder for report.html, report.json, report.txt, per_image.csv and pictures of the failures.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
}

/// What a scene can be measured beside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Peer {
    /// The most similar taught pictures by VLAD, mutual matches with each, their points, the same solver.
    Full,
}

/// Farther than this is a failure that is drawn.
const FAILURE: (f64, f64) = (0.05, 5.0);
/// So many failures are drawn, the worst first.
const MAX_DRAWN: usize = 20;

/// Evaluates.
///
/// # Errors
/// When a file cannot be read, or the data set has no test pictures with poses.
pub fn run(args: Args) -> Result<()> {
    let (scene, num_bytes) = read_scene(&args.scene)?;
    let dataset = open(&args.teaching.data)?;
    if !args.json {
        print!("{}", dataset.table());
    }
    let tests: Vec<&DatasetImage> = dataset
        .of_split(Split::Test)
        .into_iter()
        .map(|i| &dataset.images[i])
        .collect();
    if tests.is_empty() {
        bail!(
            "the data set has no test pictures; choose some with --test (for example --test 800-899)"
        );
    }
    // What the scene says, unless the user knows better: the data set's own format says nothing of another's scene.
    let said = args.teaching.data.units;
    let units = match args.teaching.data.scale {
        Some(_) => Units::Metres,
        None => said.unwrap_or(scene.info.units),
    };
    let extractor = args.teaching.extractor.read()?;
    let cache = args.cache();
    let extraction = Extraction::new(
        extractor.clone(),
        front_end_options(&scene),
        cache.as_deref(),
    );
    let labels = match (&args.labels, args.no_baseline) {
        (_, true) => None,
        (Some(path), _) => Some(Labels::read_for(
            path,
            extractor.kind,
            &extractor.source_sha256,
        )?),
        (None, _) => Some(labels_of(&args, &dataset, &extraction)?),
    };
    let landmarks = labels.as_ref().map(|labels| {
        let most = args
            .landmarks
            .unwrap_or_else(|| baseline_size(num_bytes, labels.map.descriptor_channels()));
        Landmarks::from_map(&labels.map, most)
    });
    let lines = labels.as_ref().map(|l| LineTruth::from_map(&l.map));
    let peer = labels
        .as_ref()
        .filter(|_| args.peer == Some(Peer::Full))
        .map(|l| FullMatching::new(&l.map));
    let change = |options: &mut RelocalizerOptions| {
        let live = &mut options.live;
        live.max_points = args.max_points.unwrap_or(live.max_points);
        live.max_lines = args.max_lines.unwrap_or(live.max_lines);
        options.kernels = args.kernels.level();
    };
    let mut relocalizer = relocalizer(scene.clone(), extractor.clone(), change)?;
    let runs_on = device::place(&mut relocalizer, args.device, &scene, &extractor)?;
    let bar = Progress::Terminal.bar("locating", tests.len());
    let options = EvalOptions {
        extraction: Some(&extraction),
        baseline: landmarks.as_ref(),
        peer: peer.as_ref(),
        lines: lines.as_ref(),
        num_seeds: args.seeds,
        units,
    };
    let evaluation = Evaluator::new(&mut relocalizer, options).run(&tests, |_| bar.inc(1))?;
    bar.finish();
    let subject = Subject {
        scene: args.scene.display().to_string(),
        num_bytes,
        data: format!("{}, {}", dataset.format, sources(&dataset)),
    };
    if args.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&to_json(&evaluation, &subject))?
        );
    } else {
        println!(
            "{}: {num_bytes} bytes, networks on {runs_on}",
            subject.scene
        );
        if let Some(why) = relocalizer.gpu_failure() {
            println!("later on the CPU: {why}");
        }
        print!("{}", table(&evaluation));
    }
    if args.record {
        record(&args.scene, &evaluation)?;
    }
    if let Some(folder) = &args.report {
        let (drawn, num_failures) = draw_failures(&tests, &evaluation, &scene, folder)?;
        write_report(&evaluation, &subject, &drawn, folder)
            .with_context(|| format!("writing the report to {}", folder.display()))?;
        if !args.json {
            println!(
                "report in {} ({num_failures} failures, {} drawn)",
                folder.join("report.html").display(),
                drawn.len()
            );
        }
    }
    Ok(())
}

impl Args {
    /// The folder of cached features: the one that was given, or that of the run that made the scene, where it is there.
    fn cache(&self) -> Option<PathBuf> {
        let given = self.teaching.features.clone();
        given.or_else(|| {
            let of_run = usual_run_folder(&self.scene).join("features");
            of_run.is_dir().then_some(of_run)
        })
    }
}

/// Writes the scene's own accuracy into its file.
fn record(path: &Path, evaluation: &Evaluation) -> Result<()> {
    let errors: Vec<_> = evaluation
        .images
        .iter()
        .filter_map(|image| image.methods.first())
        .map(|method| method.error.map(|e| (e.position, e.rotation_deg)))
        .collect();
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let bytes = SceneFile::redescribed(&bytes, |scene| {
        let info = &mut scene.info;
        let held_out = HeldOut::of(&errors, info.units);
        info.training.get_or_insert_default().held_out = Some(held_out);
    })?;
    write_bytes(path, &bytes)?;
    eprintln!("recorded in {}", path.display());
    Ok(())
}

fn sources(dataset: &Dataset) -> String {
    let names: Vec<String> = dataset
        .sources
        .iter()
        .map(|s| s.display().to_string())
        .collect();
    names.join(", ")
}

fn labels_of(args: &Args, dataset: &Dataset, extraction: &Extraction) -> Result<Labels> {
    let num_train = dataset.of_split(Split::Train).len();
    if num_train < 2 {
        bail!(
            "the baseline needs training pictures, and the data set has {num_train}; give --labels FILE or --no-baseline"
        );
    }
    let model_points = args.teaching.has_model_points();
    let (labels, _) = teach::labels(dataset, extraction, model_points, &mut Bars)
        .context("labels for the baseline; --no-baseline leaves it out")?;
    Ok(labels)
}

/// Draws the worst failures; returns each file with what it shows, and how many failures there are.
fn draw_failures(
    tests: &[&DatasetImage],
    evaluation: &Evaluation,
    scene: &SceneFile,
    folder: &Path,
) -> Result<(Vec<(String, String)>, usize)> {
    let map = export::scene_map(scene);
    let mut failures: Vec<(f64, usize)> = evaluation
        .images
        .iter()
        .enumerate()
        .filter_map(|(i, image)| {
            let error = image.methods.first().and_then(|m| m.error);
            let far = error.map_or(f64::INFINITY, |e| e.position);
            let is_failure =
                error.is_none_or(|e| e.position >= FAILURE.0 || e.rotation_deg >= FAILURE.1);
            is_failure.then_some((far, i))
        })
        .collect();
    failures.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut drawn = Vec::new();
    for (_, i) in failures.iter().take(MAX_DRAWN) {
        let (Some(image), Some(result)) = (tests.get(*i), evaluation.images.get(*i)) else {
            continue;
        };
        let Some(found) = result.methods.first() else {
            continue;
        };
        let what = match found.error {
            Some(e) => format!(
                "{}, {:.2} deg off",
                Ruler::of(evaluation.units).text(e.position),
                e.rotation_deg
            ),
            None => found.reason.clone().unwrap_or_default(),
        };
        let rgb = picture::read(&image.path)?.into_rgb8();
        let agreeing = format!(
            "{} points, {} lines agree",
            found.inliers.0, found.inliers.1
        );
        let picture = overlay::failure(
            &rgb,
            &image.camera,
            &[Some(result.truth), result.cam_from_world],
            &map,
            (image.name.clone(), vec![what.clone(), agreeing]),
        );
        let name = image.name.replace(['/', '\\'], "_");
        let file = format!("failures/{name}.png");
        picture::write_png(&picture, &folder.join(&file))?;
        drawn.push((file, format!("{}: {what}", image.name)));
    }
    Ok((drawn, failures.len()))
}
