//! The demo's scene, from rendering to the scene file: `cargo xtask sample`.
//!
//! Renders a room whose poses and points are known exactly, takes pictures of a walk through it, teaches a scene from them
//! as from any other pictures, and writes it with pictures taken elsewhere in the room and their true poses.

use anyhow::Result;
use clap::Parser;
use image::{ExtendedColorType, ImageEncoder};
use landline::features::FeatureSet;
use landline::front_end::{FrontEnd, FrontEndOptions};
use landline::image::{FrameView, PixelFormat};
use landline::scene_file::{ExtractorFile, Units};
use landline_mapper::args::SceneArgs;
use landline_mapper::dataset::{DatasetImage, Split};
use landline_mapper::feature_cache::FeatureCache;
use landline_mapper::files;
use landline_mapper::labels::{Labels, Origin, TrackParams, build};
use landline_mapper::progress::Progress;
use landline_mapper::teach::{add_landmarks, measure_landmarks, scene_of_landmarks};
use landline_mapper::terminal::Terminal;
use landline_mapper::weights::load_extractor;
use landline_testkit::room::{Picture, RenderOptions, Room, View, query_views, training_views};
use nalgebra::Vector3;
use serde_json::json;
use std::path::PathBuf;

/// Make the demo's sample scene and pictures anew.
#[derive(Debug, Parser)]
struct Args {
    /// Folder for `sample.landline`, `sample.json` and the pictures.
    #[arg(long, default_value = "www/scenes/sample")]
    out: PathBuf,
    /// XFeat's published checkpoint.
    #[arg(long, env = "LANDLINE_XFEAT_CHECKPOINT")]
    checkpoint: PathBuf,
    /// Pictures of the walk.
    #[arg(long, default_value_t = 180)]
    walk: usize,
    /// Pictures to locate.
    #[arg(long, default_value_t = 24)]
    queries: usize,
    /// Of the room and the places.
    #[arg(long, default_value_t = 7)]
    room_seed: u64,
    /// Folder that keeps features of the walk, for another run.
    #[arg(long, default_value = "target/sample")]
    work: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
}

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
/// The room's floor is at z = 0.
const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

/// Renders, teaches, writes.
fn main() -> Result<()> {
    let args = Args::parse();
    let extractor = load_extractor(&args.checkpoint)?;
    let mut request = args.scene.request()?;
    env!("CARGO_PKG_LICENSE").clone_into(&mut request.licence);
    eprintln!("furnishing the room");
    let room = Room::new(args.room_seed);
    let walk = training_views(&room, args.room_seed, args.walk, WIDTH, HEIGHT);
    let features = features_of_walk(&args, &room, &walk, &extractor)?;
    let images: Vec<DatasetImage> = walk
        .iter()
        .enumerate()
        .map(|(i, view)| DatasetImage {
            name: format!("walk-{i:03}"),
            path: PathBuf::new(),
            camera: view.camera,
            cam_from_world: Some(view.cam_from_world),
            split: Split::Train,
        })
        .collect();
    let origin = Origin {
        source: format!(
            "rendered room, seed {}, {} pictures",
            args.room_seed, args.walk
        ),
        ..Origin::of_extractor(&extractor, WIDTH)
    };
    let borrowed: Vec<&DatasetImage> = images.iter().collect();
    let (mut labels, stats) = build(
        &borrowed,
        features,
        origin,
        &TrackParams::default(),
        Progress::Terminal,
    )?;
    labels.map.units = Units::Metres;
    labels.map.gravity = Some(GRAVITY);
    print!("{stats}");
    println!("{}", make_exact(&room, &mut labels));
    let measured = measure_landmarks(&labels, &request, &mut Terminal)?;
    let mut scene = scene_of_landmarks(&labels, &request, measured)?;
    let (max_bytes, precision) = (request.max_bytes, request.precision);
    add_landmarks(&mut scene, &labels.map, max_bytes, precision, &mut Terminal)?;
    let bytes = scene.to_bytes(precision)?;
    let path = args.out.join("sample.landline");
    files::write_bytes(&path, &bytes)?;
    println!("wrote {} ({} bytes)", path.display(), bytes.len());
    write_queries(&args, &room)
}

fn frame(picture: &Picture) -> FrameView<'_> {
    FrameView::tight(
        &picture.rgb,
        picture.width,
        picture.height,
        PixelFormat::Rgb8,
    )
}

fn features_of_walk(
    args: &Args,
    room: &Room,
    walk: &[View],
    extractor: &ExtractorFile,
) -> Result<Vec<FeatureSet>> {
    let options = FrontEndOptions::new(extractor.kind);
    let maker = format!(
        "sample room {} {} {} {options:?}",
        args.room_seed,
        walk.len(),
        extractor.source_sha256
    );
    let cache = FeatureCache::new(args.work.join("features"), maker);
    let mut front_end = FrontEnd::new(extractor.clone(), options)?;
    let bar = Progress::Terminal.bar("rendering the walk", walk.len());
    let mut all = Vec::with_capacity(walk.len());
    for (i, view) in walk.iter().enumerate() {
        let name = format!("walk-{i:03}");
        let features = match cache.read(&name)? {
            Some(features) => features,
            None => {
                // Four rays a pixel are enough for the extractor; exposure drifts as that of a real camera.
                let taken = RenderOptions {
                    supersampling: 2,
                    exposure: 1.2 * (1.0 + 0.15 * (0.31 * i as f64).sin()),
                    seed: i as u64,
                    ..RenderOptions::default()
                };
                let picture = room.render(&view.camera, &view.cam_from_world, &taken);
                let mut features = front_end.run(&frame(&picture))?.clone();
                features.map_pixels(&front_end.working_from_sensor().inverse());
                cache.write(&name, &features)?;
                features
            }
        };
        all.push(features);
        bar.inc(1);
    }
    bar.finish();
    Ok(all)
}

/// Replaces triangulated points by the exact ones: the median over a track's observations of what the room has behind each
/// pixel. Observations that look at something else are dropped, tracks without two are left as triangulated.
fn make_exact(room: &Room, labels: &mut Labels) -> String {
    const SAME_PLACE_M: f64 = 0.03;
    let mut errors = Vec::new();
    let mut strays = 0usize;
    let map = &mut labels.map;
    for track in &mut map.points {
        let seen: Vec<Option<Vector3<f64>>> = track
            .observations
            .iter()
            .map(|o| {
                let view = map.views.get(o.view as usize)?;
                let keypoint = view.features.keypoints.get(o.feature as usize)?;
                room.point_at(&view.camera, &view.cam_from_world?, keypoint.pixel)
            })
            .collect();
        let axis = |i: usize| {
            let mut values: Vec<f64> = seen.iter().flatten().map(|p| p[i]).collect();
            landline::math::stats::median_in_place(&mut values)
        };
        let (Some(x), Some(y), Some(z)) = (axis(0), axis(1), axis(2)) else {
            continue;
        };
        let exact = Vector3::new(x, y, z);
        let agrees =
            |p: &Option<Vector3<f64>>| p.is_some_and(|p| (p - exact).norm() < SAME_PLACE_M);
        let mut keep = seen.iter().map(agrees);
        if keep.clone().filter(|k| *k).count() < 2 {
            continue;
        }
        errors.push((track.point_in_world - exact).norm());
        track.point_in_world = exact;
        track.observations.retain(|_| {
            let kept = keep.next().unwrap_or(false);
            strays += usize::from(!kept);
            kept
        });
    }
    let count = errors.len();
    let median = landline::math::stats::median_in_place(&mut errors).unwrap_or(0.0);
    format!(
        "exact points       {count} of {}; triangulation was {:.2} cm off in the median; {strays} observations dropped",
        map.points.len(),
        100.0 * median
    )
}

fn write_queries(args: &Args, room: &Room) -> Result<()> {
    let views = query_views(room, args.room_seed, args.queries, WIDTH, HEIGHT);
    let bar = Progress::Terminal.bar("rendering the queries", views.len());
    let mut pictures = Vec::with_capacity(views.len());
    for (i, view) in views.iter().enumerate() {
        let name = format!("query-{i:02}.jpg");
        let taken = RenderOptions {
            seed: 1000 + i as u64,
            ..RenderOptions::default()
        };
        let picture = room.render(&view.camera, &view.cam_from_world, &taken);
        let mut bytes = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90).write_image(
            &picture.rgb,
            picture.width,
            picture.height,
            ExtendedColorType::Rgb8,
        )?;
        files::write_bytes(&args.out.join(&name), &bytes)?;
        let m = view.cam_from_world.to_row_major();
        let rows: Vec<&[f64]> = m.chunks_exact(4).collect();
        pictures.push(json!({ "name": name, "cam_from_world": rows }));
        bar.inc(1);
    }
    bar.finish();
    let (fx, fy) = views.first().map_or((0.0, 0.0), |v| v.camera.focal_px());
    let camera = json!({
        "fx": fx, "fy": fy, "cx": 0.5 * f64::from(WIDTH), "cy": 0.5 * f64::from(HEIGHT),
        "width": WIDTH, "height": HEIGHT,
    });
    let list = serde_json::to_string_pretty(&json!({ "camera": camera, "pictures": pictures }))?;
    let path = args.out.join("sample.json");
    files::write_bytes(&path, list.as_bytes())?;
    println!("wrote {} and {} pictures", path.display(), views.len());
    Ok(())
}
