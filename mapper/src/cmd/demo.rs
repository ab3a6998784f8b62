//! `landline demo`: locates the sample pictures and compares with their exact poses.

use crate::args::{ExtractorArgs, KernelArgs};
use crate::picture;
use crate::scene::{read_scene, relocalizer};
use anyhow::{Context as _, Result, bail, ensure};
use landline::geometry::{CamFromWorld, Camera, CameraModel};
use landline::image::{FrameView, PixelFormat};
use landline::math::stats::median_in_place;
use landline::relocalizer::{Outcome, Query, Relocalizer};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Locate the sample pictures and print their poses and errors.
///
/// Any folder works that holds a list like the sample's: `{ "camera": { fx, fy, cx, cy, width, height }, "pictures":
/// [ { "name", "cam_from_world": 4 rows } ] }`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with the pictures and their list.
    #[arg(long, default_value = "www/scenes/sample")]
    dir: PathBuf,
    /// The list, if it lies elsewhere.
    #[arg(long)]
    list: Option<PathBuf>,
    /// The scene file, if it lies elsewhere.
    #[arg(long)]
    scene: Option<PathBuf>,
    #[command(flatten)]
    extractor: ExtractorArgs,
    #[command(flatten)]
    kernels: KernelArgs,
    /// Also writes the results as `poses.json` into this folder, and each picture's pixels beside it as `NAME.rgb` (rows
    /// of 8-bit RGB), so that other programs can be held against the same input.
    #[arg(long)]
    save: Option<PathBuf>,
}

#[derive(Debug, Deserialize)]
struct List {
    camera: Intrinsics,
    pictures: Vec<Picture>,
}

#[derive(Debug, Deserialize)]
struct Intrinsics {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: u32,
    height: u32,
}

#[derive(Debug, Deserialize)]
struct Picture {
    name: String,
    cam_from_world: Option<[[f64; 4]; 4]>,
}

#[derive(Debug, Serialize)]
struct Row {
    name: String,
    located: bool,
    reason: Option<&'static str>,
    cam_from_world: Option<[f64; 16]>,
    position_error_m: Option<f64>,
    rotation_error_deg: Option<f64>,
    point_inliers: usize,
    line_inliers: usize,
    features_ms: f64,
    lines_ms: f64,
    regress_ms: f64,
    solve_ms: f64,
    total_ms: f64,
}

/// Runs the command.
///
/// # Errors
/// When a file is missing or damaged, or no picture could be located.
pub fn run(args: Args) -> Result<()> {
    let list_path = args.list.unwrap_or_else(|| args.dir.join("sample.json"));
    let text = std::fs::read_to_string(&list_path).with_context(|| {
        format!(
            "cannot read {}: the sample is in landline's repository, so run this in a checkout of it, or give --dir FOLDER",
            list_path.display()
        )
    })?;
    let list: List = serde_json::from_str(&text)
        .with_context(|| format!("{} is not a list of pictures", list_path.display()))?;
    ensure!(
        !list.pictures.is_empty(),
        "{} names no picture",
        list_path.display()
    );
    let scene = args
        .scene
        .unwrap_or_else(|| args.dir.join("sample.landline"));
    let (scene, _) = read_scene(&scene)?;
    let mut relocalizer = relocalizer(scene, args.extractor.read()?, |options| {
        options.kernels = args.kernels.level();
    })?;
    let mut rows = Vec::with_capacity(list.pictures.len());
    for picture in &list.pictures {
        let image = picture::read(&args.dir.join(&picture.name))?.into_rgb8();
        if let Some(folder) = &args.save {
            write(folder, &format!("{}.rgb", picture.name), image.as_raw())?;
        }
        rows.push(locate(&mut relocalizer, &list.camera, picture, &image)?);
    }
    if let Some(folder) = &args.save {
        write(folder, "poses.json", &serde_json::to_vec_pretty(&rows)?)?;
    }
    print_table(&rows);
    if !rows.iter().any(|row| row.located) {
        bail!(
            "none of {} pictures was located: the scene is not of this place",
            rows.len()
        );
    }
    Ok(())
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, bytes))
        .with_context(|| format!("cannot write {}", path.display()))
}

fn locate(
    relocalizer: &mut Relocalizer,
    intrinsics: &Intrinsics,
    picture: &Picture,
    image: &image::RgbImage,
) -> Result<Row> {
    let (width, height) = image.dimensions();
    let camera = Camera {
        width: intrinsics.width,
        height: intrinsics.height,
        model: CameraModel::Pinhole {
            fx: intrinsics.fx,
            fy: intrinsics.fy,
            cx: intrinsics.cx,
            cy: intrinsics.cy,
        },
    };
    let frame = FrameView::tight(image.as_raw(), width, height, PixelFormat::Rgb8);
    let start = Instant::now();
    let mut clock = || start.elapsed().as_secs_f64() * 1e3;
    let report = relocalizer
        .locate(&frame, &Query::with_camera(camera), &mut clock)
        .with_context(|| picture.name.clone())?;
    let mut row = Row {
        name: picture.name.clone(),
        located: false,
        reason: None,
        cam_from_world: None,
        position_error_m: None,
        rotation_error_deg: None,
        point_inliers: report.counts.num_point_inliers,
        line_inliers: report.counts.num_line_inliers,
        features_ms: report.timings.features_ms,
        lines_ms: report.timings.lines_ms,
        regress_ms: report.timings.regress_ms,
        solve_ms: report.timings.solve_ms,
        total_ms: report.timings.total_ms,
    };
    match &report.outcome {
        Outcome::NotLocated(reason) => row.reason = Some(reason.message()),
        Outcome::Located(found) => {
            row.located = true;
            row.cam_from_world = Some(found.cam_from_world.to_row_major());
            if let Some(rows) = &picture.cam_from_world {
                let (distance, angle) = found.cam_from_world.error_to(&known(rows));
                row.position_error_m = Some(distance);
                row.rotation_error_deg = Some(angle.to_degrees());
            }
        }
    }
    Ok(row)
}

fn known(rows: &[[f64; 4]; 4]) -> CamFromWorld {
    CamFromWorld::new(
        Matrix3::from_fn(|r, c| rows[r][c]),
        Vector3::from_fn(|r, _| rows[r][3]),
    )
}

fn print_table(rows: &[Row]) {
    println!(
        "{:<18} {:>28} {:>10} {:>9} {:>12} {:>8}",
        "picture", "position of the camera", "error", "error", "inliers", "ms"
    );
    for row in rows {
        let position = row.cam_from_world.map_or_else(
            || {
                row.reason
                    .unwrap_or("not located")
                    .chars()
                    .take(28)
                    .collect()
            },
            |m| {
                let rotation = Matrix3::from_fn(|r, c| m[4 * r + c]);
                let translation = Vector3::new(m[3], m[7], m[11]);
                let p = CamFromWorld::new(rotation, translation).center_in_world();
                format!("{:>8.3} {:>8.3} {:>8.3} m", p.x, p.y, p.z)
            },
        );
        let distance = row
            .position_error_m
            .map_or_else(|| "-".to_owned(), |e| format!("{:.1} mm", 1e3 * e));
        let angle = row
            .rotation_error_deg
            .map_or_else(|| "-".to_owned(), |e| format!("{e:.3}°"));
        println!(
            "{:<18} {position:>28} {distance:>10} {angle:>9} {:>5} + {:<4} {:>8.0}",
            row.name, row.point_inliers, row.line_inliers, row.total_ms
        );
    }
    let located = rows.iter().filter(|row| row.located).count();
    println!(
        "\n{located} of {} located; median error {:.1} mm, {:.3}°; median {:.0} ms a picture",
        rows.len(),
        1e3 * median(
            rows.iter()
                .map(|r| r.position_error_m.unwrap_or(f64::INFINITY))
        ),
        median(
            rows.iter()
                .map(|r| r.rotation_error_deg.unwrap_or(f64::INFINITY))
        ),
        median(rows.iter().map(|r| r.total_ms)),
    );
}

/// Pictures that were not located count as infinitely wrong.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    median_in_place(&mut values.collect::<Vec<_>>()).unwrap_or(f64::NAN)
}
