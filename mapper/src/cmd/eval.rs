//! `landline eval`: accuracy of a scene on pictures with known poses.

use crate::dataset::{DataArgs, Dataset, DatasetImage, Split, open};
use crate::draw;
use crate::eval::{EvalOptions, Evaluator, Landmarks, baseline_size, table, to_json, write_report};
use crate::extract::Extraction;
use crate::labels::{LabelParams, Labels, build};
use crate::picture;
use crate::progress::Progress;
use crate::scene::{ExtractorArgs, KernelArgs, front_end_options, read_scene, relocalizer};
use anyhow::{Context, Result, bail};
use landline::geometry::CamFromWorld;
use landline::scene_file::SceneFile;
use std::path::{Path, PathBuf};

/// Evaluate a scene on the test pictures of a data set, with the nearest-landmark baseline beside it.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    extractor: ExtractorArgs,
    /// Label file whose tracks give the baseline its landmarks; made from the training pictures when not given.
    #[arg(long, value_name = "FILE")]
    labels: Option<PathBuf>,
    /// Landmarks of the baseline; as many as fit the scene file's bytes when not given.
    #[arg(long, value_name = "N")]
    landmarks: Option<usize>,
    /// Leave the baseline out.
    #[arg(long)]
    no_baseline: bool,
    /// Folder of cached features.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Most points that go to the solver.
    #[arg(long, value_name = "N")]
    max_points: Option<usize>,
    /// Most lines that go to the solver.
    #[arg(long, value_name = "N")]
    max_lines: Option<usize>,
    #[command(flatten)]
    kernels: KernelArgs,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
    /// Folder for report.json, report.txt, per_image.csv and pictures of the failures.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
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
    let dataset = open(&args.data)?;
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
    let (scene, num_bytes) = read_scene(&args.scene)?;
    let extractor = args.extractor.read()?;
    let extraction = Extraction::new(
        extractor.clone(),
        front_end_options(&scene),
        args.features.as_deref(),
    );
    let landmarks = if args.no_baseline {
        None
    } else {
        let labels = baseline_labels(&args, &dataset, &extraction)?;
        let most = args
            .landmarks
            .unwrap_or_else(|| baseline_size(num_bytes, labels.descriptor_len));
        Some(Landmarks::from_labels(&labels, most))
    };
    let mut relocalizer = relocalizer(scene.clone(), extractor, |options| {
        options.max_points = args.max_points.unwrap_or(options.max_points);
        options.max_lines = args.max_lines.unwrap_or(options.max_lines);
        options.kernels = args.kernels.level();
    })?;
    let bar = Progress::Terminal.bar("locating", tests.len());
    let evaluation = Evaluator::new(
        &mut relocalizer,
        EvalOptions {
            baseline: landmarks.as_ref().map(|l| (l, &extraction)),
        },
    )
    .run(&tests, |_| bar.inc(1))?;
    bar.finish();
    let name = args.scene.display().to_string();
    if args.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&to_json(&evaluation, &name, num_bytes))?
        );
    } else {
        println!("{name}: {num_bytes} bytes");
        print!("{}", table(&evaluation));
    }
    if let Some(folder) = &args.report {
        write_report(&evaluation, &name, num_bytes, folder)
            .with_context(|| format!("writing the report to {}", folder.display()))?;
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
        for (_, i) in failures.iter().take(MAX_DRAWN) {
            let (Some(image), Some(result)) = (tests.get(*i), evaluation.images.get(*i)) else {
                continue;
            };
            draw_failure(image, result.cam_from_world, &scene, folder)?;
        }
        if !args.json {
            println!(
                "report in {} ({} failures, {} drawn)",
                folder.display(),
                failures.len(),
                failures.len().min(MAX_DRAWN)
            );
        }
    }
    Ok(())
}

fn baseline_labels(args: &Args, dataset: &Dataset, extraction: &Extraction) -> Result<Labels> {
    if let Some(path) = &args.labels {
        return Ok(Labels::read(path)?);
    }
    let chosen: Vec<&DatasetImage> = dataset
        .of_split(Split::Train)
        .into_iter()
        .map(|i| &dataset.images[i])
        .collect();
    if chosen.len() < 2 {
        bail!(
            "the baseline needs training pictures, and the data set has {}; give --labels FILE or --no-baseline",
            chosen.len()
        );
    }
    let features = extraction.all(&chosen, Progress::Terminal)?;
    let (labels, _) = build(
        &chosen,
        features,
        &extraction.maker(),
        &LabelParams::default(),
        &Progress::Terminal,
    )
    .context("labels for the baseline; --no-baseline leaves it out")?;
    Ok(labels)
}

/// The map's segments where the truth puts them (yellow) and where the estimate puts them (red).
fn draw_failure(
    image: &DatasetImage,
    estimate: Option<CamFromWorld>,
    scene: &SceneFile,
    folder: &Path,
) -> Result<()> {
    let mut rgb = picture::read(&image.path)?.into_rgb8();
    let map = crate::export::scene_map(scene);
    for (pose, color) in [(image.cam_from_world, draw::YELLOW), (estimate, draw::RED)] {
        let Some(pose) = pose else { continue };
        for [a, b] in &map.segments {
            draw::world_segment(&mut rgb, &image.camera, &pose, [a, b], 1.2, color);
        }
        for point in &map.points {
            let in_cam = pose.transform_point(point);
            if let Some(pixel) = image.camera.pixel_from_cam(&in_cam) {
                draw::ring(&mut rgb, pixel, 2.0, color);
            }
        }
    }
    let name = image.name.replace(['/', '\\'], "_");
    picture::write_png(&rgb, &folder.join("failures").join(format!("{name}.png")))?;
    Ok(())
}
