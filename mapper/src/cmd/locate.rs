//! `landline locate`: the camera pose of pictures.

use crate::args::{ExtractorArgs, KernelArgs, device};
use crate::device;
use crate::eval::{CONFIDENT, PoseError};
use crate::files::names_apart;
use crate::overlay;
use crate::picture;
use crate::posing;
use crate::scene::{read_scene, relocalizer};
use crate::shown::shown;
use anyhow::{Context, Result, bail, ensure};
use landline::formats::expressed;
use landline::geometry::{Camera, CameraRecord};
use landline::image::{FrameView, PixelFormat};
use landline::relocalizer::{
    Device, NotLocated, Outcome, Query, Relocalizer, RelocalizerOptions, Report,
};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Locate pictures in a scene.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// Pictures, or folders of them.
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    #[command(flatten)]
    extractor: ExtractorArgs,
    /// Camera of the pictures: MODEL,width,height,parameters in COLMAP's order. Otherwise a camera of the scene
    /// where one takes pictures of the same shape, else the focal length is solved with the pose.
    #[arg(long, value_name = "MODEL,W,H,...", value_parser = crate::dataset::parse_camera)]
    camera: Option<CameraRecord>,
    /// Focal length of the pictures in pixels, without distortion and with the principal point in the middle.
    #[arg(long, value_name = "PX", conflicts_with = "camera")]
    focal: Option<f64>,
    #[command(flatten)]
    kernels: KernelArgs,
    /// What runs the networks.
    #[arg(long, default_value = "cpu", value_name = "DEVICE", value_parser = device())]
    device: Device,
    /// Locate each picture on the CPU too and say how far the two answers are apart: a test of a GPU and its driver.
    #[arg(long)]
    against_cpu: bool,
    /// Print JSON, one object a line.
    #[arg(long)]
    json: bool,
    /// Folder for the pictures with the scene's lines where the pose puts them, coloured by confidence, with what was seen
    /// and what does not agree, and a legend.
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
}

/// Locates.
///
/// # Errors
/// When the scene or the extractor cannot be read, or, once all others are done, when a picture could not. That a picture
/// is not located is a result.
pub fn run(args: Args) -> Result<()> {
    // Before anything expensive happens.
    let pictures = pictures(&args.pictures)?;
    if let Some(folder) = &args.overlay {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("--overlay: cannot make the folder {}", folder.display()))?;
    }
    let (scene, _) = read_scene(&args.scene)?;
    let extractor = args.extractor.read()?;
    let given = args.camera.as_ref().map(expressed).transpose()?;
    let change = |options: &mut RelocalizerOptions| options.kernels = args.kernels.level();
    let on_cpu = args
        .against_cpu
        .then(|| relocalizer(scene.clone(), extractor.clone(), change))
        .transpose()?;
    let mut relocalizer = relocalizer(scene.clone(), extractor.clone(), change)?;
    let runs_on = device::place(&mut relocalizer, args.device, &scene, &extractor)?;
    drop((scene, extractor));
    if !args.json {
        println!("networks on {runs_on}");
    }
    let mut both = Both {
        relocalizer,
        on_cpu,
        worst: Apart::default(),
    };
    let (mut num_unread, mut num_refused) = (0, 0);
    let names = names_apart(&pictures, Path::file_stem);
    for (path, name) in pictures.iter().zip(&names) {
        // A picture that cannot be read does not keep the others from being located.
        let rgb = match picture::read(path) {
            Ok(picture) => picture.into_rgb8(),
            Err(error) => {
                eprintln!("error: {}", crate::shown::told(&error.into()));
                num_unread += 1;
                continue;
            }
        };
        let drawn = match locate(&mut both, (path, &rgb), given, &args) {
            Ok(drawn) => drawn,
            Err(error) => {
                eprintln!("error: {}", crate::shown::told(&error));
                num_refused += 1;
                continue;
            }
        };
        if let (Some(folder), Some(drawn)) = (&args.overlay, drawn) {
            let target = folder.join(format!("{name}.overlay.png"));
            // Where one cannot be written, none can.
            picture::write_png(&drawn, &target).context("--overlay")?;
            if !args.json {
                println!("  overlay    {}", target.display());
            }
        }
    }
    if args.against_cpu && !args.json {
        println!("farthest from the CPU over all pictures: {}", both.worst);
    }
    let counts = [
        (num_unread, "could not be read"),
        (num_refused, "do not go with what was given"),
    ];
    let failed: Vec<String> = counts
        .iter()
        .filter(|(num_failed, _)| *num_failed > 0)
        .map(|(num_failed, what)| format!("{num_failed} of {} pictures {what}", pictures.len()))
        .collect();
    ensure!(failed.is_empty(), "{}", failed.join(", "));
    Ok(())
}

/// The pictures that were given, with those of folders in their place.
fn pictures(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut pictures = Vec::with_capacity(given.len());
    for path in given {
        if !path.is_dir() {
            pictures.push(path.clone());
            continue;
        }
        let found = picture::listed(path)?;
        if found.pictures.is_empty() {
            bail!("{} has {}", path.display(), found.instead());
        }
        if !found.undecoded.is_empty() {
            eprintln!("not read: {}", found.instead());
        }
        pictures.extend(found.pictures);
    }
    Ok(pictures)
}

/// The relocalizer, and another one that stays on the CPU for comparison.
struct Both {
    relocalizer: Relocalizer,
    on_cpu: Option<Relocalizer>,
    worst: Apart,
}

/// How far two answers for a picture are apart.
#[derive(Debug, Clone, Copy, Default)]
struct Apart {
    position: f64,
    rotation_deg: f64,
}

impl Apart {
    /// Infinitely far where only one of them located the picture.
    fn between(a: &Report, b: &Report) -> Self {
        match (a.outcome.located(), b.outcome.located()) {
            (Some(a), Some(b)) => {
                let error = PoseError::between(&a.cam_from_world, &b.cam_from_world);
                Self {
                    position: error.position,
                    rotation_deg: error.rotation_deg,
                }
            }
            (None, None) => Self::default(),
            _ => Self {
                position: f64::INFINITY,
                rotation_deg: f64::INFINITY,
            },
        }
    }

    fn max(self, other: Self) -> Self {
        Self {
            position: self.position.max(other.position),
            rotation_deg: self.rotation_deg.max(other.rotation_deg),
        }
    }
}

impl core::fmt::Display for Apart {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            position,
            rotation_deg,
        } = self;
        write!(f, "{position:.6} in position, {rotation_deg:.5} deg")
    }
}

/// What ran the networks of a picture, why not a GPU that was given, and how far the answer is from the CPU's.
struct Told {
    name: &'static str,
    why: Option<String>,
    apart: Option<Apart>,
}

/// Locates a picture and tells of it; gives what is to be drawn, where drawings are asked for.
fn locate(
    both: &mut Both,
    (path, rgb): (&Path, &image::RgbImage),
    given: Option<Camera>,
    args: &Args,
) -> Result<Option<image::RgbImage>> {
    let (width, height) = rgb.dimensions();
    let of_focal = |focal| {
        posing::check_focal(focal, width, height)?;
        Ok::<_, posing::PosingError>(Camera::centered(width, height, focal))
    };
    let query = Query {
        camera: match given {
            Some(camera) => Some(camera),
            None => args.focal.map(of_focal).transpose()?,
        },
        ..Query::default()
    };
    let frame = FrameView::tight(rgb.as_raw(), rgb.width(), rgb.height(), PixelFormat::Rgb8);
    let start = Instant::now();
    let mut clock = || start.elapsed().as_secs_f64() * 1e3;
    let refused = || format!("locating {}", path.display());
    let relocalizer = &mut both.relocalizer;
    let report = pollster::block_on(relocalizer.locate_with_gpu(&frame, &query, &mut clock))
        .with_context(refused)?;
    let mut told = Told {
        name: if report.on_gpu { "gpu" } else { "cpu" },
        why: relocalizer.gpu_failure().map(str::to_owned),
        apart: None,
    };
    if let Some(on_cpu) = &mut both.on_cpu {
        let expected = on_cpu
            .locate(&frame, &query, &mut clock)
            .with_context(refused)?;
        let apart = Apart::between(&report, &expected);
        both.worst = both.worst.max(apart);
        told.apart = Some(apart);
    }
    // Before other things are tried: it shows what was found in it as it is.
    let drawn = args
        .overlay
        .as_ref()
        .map(|_| overlay(rgb, relocalizer, &report));
    let report = relocalizer.explain(&query, &report).with_context(refused)?;
    if args.json {
        println!("{}", to_json(path, &report, &told));
    } else {
        print_report(path, &report, &told);
    }
    Ok(drawn)
}

fn print_report(path: &Path, report: &Report, told: &Told) {
    println!("{}", shown(&path.display().to_string()));
    let c = &report.counts;
    match &report.outcome {
        Outcome::Located(l) => {
            let center = l.cam_from_world.center_in_world();
            let [w, x, y, z] = l.cam_from_world.quaternion_wxyz();
            let t = l.cam_from_world.translation;
            println!(
                "  position   {:.4} {:.4} {:.4}",
                center.x, center.y, center.z
            );
            println!(
                "  cam_from_world  qwxyz {w:.6} {x:.6} {y:.6} {z:.6}  t {:.6} {:.6} {:.6}",
                t.x, t.y, t.z
            );
            println!(
                "  agreeing   {} of {} points, {} of {} lines, median {:.2} px",
                c.num_point_inliers,
                c.num_point_correspondences,
                c.num_line_inliers,
                c.num_line_correspondences,
                l.median_error_px
            );
            println!(
                "  sure to    {:.4} in position, {:.3} deg (one sigma), confidence {:.3}{}",
                l.estimate.sigma_m,
                l.estimate.sigma_rad.to_degrees(),
                l.confidence,
                if l.confidence > CONFIDENT {
                    ""
                } else {
                    ": it may be wrong"
                }
            );
        }
        Outcome::NotLocated(reason) => println!(
            "  not located: {} ({} keypoints, {} segments, {} + {} correspondences)",
            reason.message(),
            c.num_keypoints,
            c.num_segments,
            c.num_point_correspondences,
            c.num_line_correspondences
        ),
    }
    println!(
        "  focal      {:.1} px ({:?})",
        report.camera.focal_px().0,
        report.camera_source
    );
    if report.has_focal_mismatch {
        println!(
            "  focal mismatch: the given intrinsics contradict what is seen; these are solved ones"
        );
    }
    println!("  time       {:.1} ms", report.timings.total_ms);
    match &told.why {
        Some(why) => println!("  networks   {} ({why})", told.name),
        None => println!("  networks   {}", told.name),
    }
    if let Some(apart) = told.apart {
        println!("  from CPU   {apart}");
    }
}

fn to_json(path: &Path, report: &Report, told: &Told) -> serde_json::Value {
    let c = &report.counts;
    let (pose, reason, quality) = match &report.outcome {
        Outcome::Located(l) => (
            json!({
                "cam_from_world": {
                    "qwxyz": l.cam_from_world.quaternion_wxyz(),
                    "t": <[f64; 3]>::from(l.cam_from_world.translation),
                },
                "position": <[f64; 3]>::from(l.cam_from_world.center_in_world()),
            }),
            json!(null),
            json!({
                "median_error_px": l.median_error_px,
                "confidence": l.confidence,
                "sigma": l.estimate.sigma_m,
                "sigma_deg": l.estimate.sigma_rad.to_degrees(),
                "log_evidence": l.estimate.log_evidence,
            }),
        ),
        Outcome::NotLocated(reason) => (json!(null), json!(reason.message()), json!(null)),
    };
    json!({
        "picture": path.display().to_string(),
        "pose": pose,
        "reason": reason,
        "quality": quality,
        "inliers": { "points": c.num_point_inliers, "lines": c.num_line_inliers },
        "correspondences": { "points": c.num_point_correspondences, "lines": c.num_line_correspondences },
        "found_again": report.found_again.map(|f| json!({
            "points": [f.found_points, f.visible_points],
            "lines": [f.found_lines, f.visible_lines],
        })),
        "turn_clockwise_deg": match report.outcome {
            Outcome::NotLocated(NotLocated::Turned { clockwise_deg }) => Some(clockwise_deg),
            _ => None,
        },
        "focal_mismatch": report.has_focal_mismatch
            || matches!(report.outcome, Outcome::NotLocated(NotLocated::FocalMismatch)),
        "focal_px": report.camera.focal_px().0,
        "camera_source": format!("{:?}", report.camera_source).to_lowercase(),
        "total_ms": report.timings.total_ms,
        "backend": told.name,
        "backend_reason": told.why,
        "from_cpu": told.apart.map(|a| json!({ "position": a.position, "rotation_deg": a.rotation_deg })),
    })
}

fn overlay(rgb: &image::RgbImage, relocalizer: &Relocalizer, report: &Report) -> image::RgbImage {
    let c = &report.counts;
    let points: Vec<_> = relocalizer.points().collect();
    let lines: Vec<_> = relocalizer.lines().collect();
    let located = report.outcome.located();
    let (title, text) = match &report.outcome {
        Outcome::Located(l) => {
            let center = l.cam_from_world.center_in_world();
            (
                format!("located at {:.3} {:.3} {:.3}", center.x, center.y, center.z),
                vec![
                    format!(
                        "{} of {} points, {} of {} lines agree",
                        c.num_point_inliers,
                        c.num_point_correspondences,
                        c.num_line_inliers,
                        c.num_line_correspondences
                    ),
                    format!(
                        "median {:.2} px, sure to {:.4}, {:.2} deg",
                        l.median_error_px,
                        l.estimate.sigma_m,
                        l.estimate.sigma_rad.to_degrees()
                    ),
                ],
            )
        }
        Outcome::NotLocated(reason) => {
            ("not located".to_owned(), vec![reason.message().to_owned()])
        }
    };
    overlay::located(
        rgb,
        &overlay::Located {
            points: &points,
            lines: &lines,
            camera: report.camera,
            cam_from_world: located.map(|l| l.cam_from_world),
            title,
            text,
        },
    )
}
