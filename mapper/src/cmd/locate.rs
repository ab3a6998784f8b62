//! `landline locate`: the camera pose of pictures.

use crate::dataset::camera::CameraRecord;
use crate::overlay;
use crate::picture;
use crate::scene::{ExtractorArgs, KernelArgs, read_scene, relocalizer};
use anyhow::{Context, Result, ensure};
use landline::geometry::Camera;
use landline::image::{FrameView, PixelFormat};
use landline::relocalizer::{CameraSource, Outcome, Query, Relocalizer, Report};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Locate pictures in a scene.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// Pictures.
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    #[command(flatten)]
    extractor: ExtractorArgs,
    /// Camera of the pictures: MODEL,width,height,parameters in COLMAP's order. Otherwise the scene's own camera where it
    /// has the same size, else the focal length is solved with the pose.
    #[arg(long, value_name = "MODEL,W,H,...", value_parser = crate::dataset::parse_camera)]
    camera: Option<CameraRecord>,
    #[command(flatten)]
    kernels: KernelArgs,
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
    let (scene, _) = read_scene(&args.scene)?;
    let extractor = args.extractor.read()?;
    let given = args
        .camera
        .as_ref()
        .map(CameraRecord::to_camera)
        .transpose()?;
    let scene_camera = scene.info.camera;
    let mut relocalizer = relocalizer(scene, extractor, |options| {
        options.kernels = args.kernels.level();
    })?;
    let mut num_failed = 0;
    for path in &args.pictures {
        // A picture that cannot be read does not keep the others from being located.
        if let Err(error) = locate(&mut relocalizer, path, given, scene_camera, &args) {
            eprintln!("error: {error:#}");
            num_failed += 1;
        }
    }
    ensure!(
        num_failed == 0,
        "{num_failed} of {} pictures could not be read",
        args.pictures.len()
    );
    Ok(())
}

fn locate(
    relocalizer: &mut Relocalizer,
    path: &Path,
    given: Option<Camera>,
    scene_camera: Option<Camera>,
    args: &Args,
) -> Result<()> {
    let rgb = picture::read(path)?.into_rgb8();
    let fits = |c: &Camera| (c.width, c.height) == rgb.dimensions();
    let query = Query {
        camera: given.or(scene_camera.filter(fits)),
        camera_source: CameraSource::Given,
        ..Query::default()
    };
    let frame = FrameView {
        bytes: rgb.as_raw(),
        width: rgb.width(),
        height: rgb.height(),
        stride: 3 * rgb.width() as usize,
        format: PixelFormat::Rgb8,
    };
    let start = Instant::now();
    let report = relocalizer
        .locate(&frame, &query, &mut || start.elapsed().as_secs_f64() * 1e3)
        .with_context(|| format!("locating {}", path.display()))?;
    if args.json {
        println!("{}", to_json(path, &report));
    } else {
        print_report(path, &report);
    }
    if let Some(folder) = &args.overlay {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let target = folder.join(format!("{name}.overlay.png"));
        picture::write_png(&overlay(&rgb, relocalizer, &report), &target)?;
        if !args.json {
            println!("  overlay    {}", target.display());
        }
    }
    Ok(())
}

fn print_report(path: &Path, report: &Report) {
    println!("{}", path.display());
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
                "  sure to    {:.4} in position, {:.3} deg (one sigma), confidence {:.3}",
                l.estimate.sigma_m,
                l.estimate.sigma_rad.to_degrees(),
                l.confidence
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
    println!("  time       {:.1} ms", report.timings.total_ms);
}

fn to_json(path: &Path, report: &Report) -> serde_json::Value {
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
            json!({ "median_error_px": l.median_error_px, "confidence": l.confidence }),
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
        "focal_px": report.camera.focal_px().0,
        "camera_source": format!("{:?}", report.camera_source).to_lowercase(),
        "total_ms": report.timings.total_ms,
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
