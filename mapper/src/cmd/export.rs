//! `landline export`: a map for other programs.

use crate::export::{
    from_reconstruction, scene_map, write_colmap, write_glb, write_obj, write_ply,
};
use crate::labels::Labels;
use crate::scene::read_scene;
use anyhow::{Context, Result, bail, ensure};
use std::path::PathBuf;

/// Export the points and lines of a scene file, or of a label file, for other programs.
///
/// A scene file holds points and lines of its own only when its branches are anchored; a label file holds the triangulated
/// tracks and the cameras.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene file (NAME.landline) or a label file.
    map: PathBuf,
    /// Binary PLY: points, and segments as edges.
    #[arg(long, value_name = "FILE")]
    ply: Option<PathBuf>,
    /// OBJ: points, and segments as lines.
    #[arg(long, value_name = "FILE")]
    obj: Option<PathBuf>,
    /// GLB: points, lines, cameras; y up.
    #[arg(long, value_name = "FILE")]
    glb: Option<PathBuf>,
    /// Folder for a COLMAP text model; needs a label file.
    #[arg(long, value_name = "DIR")]
    colmap: Option<PathBuf>,
}

/// Exports.
///
/// # Errors
/// When the map cannot be read, holds nothing to export, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    if args.ply.is_none() && args.obj.is_none() && args.glb.is_none() && args.colmap.is_none() {
        bail!("nothing to write: give --ply FILE, --obj FILE, --glb FILE or --colmap DIR");
    }
    let is_scene = args.map.extension().is_some_and(|e| e == "landline");
    let map = if is_scene {
        let (scene, _) = read_scene(&args.map)?;
        let map = scene_map(&scene);
        ensure!(
            !map.points.is_empty() || !map.segments.is_empty(),
            "{} keeps its map in the weights of its network (variant {}), not as points and lines; export the labels \
             that it was trained on",
            args.map.display(),
            scene.config.variant().name()
        );
        map
    } else {
        from_reconstruction(&Labels::read(&args.map)?.map)
    };
    println!(
        "{} points, {} segments, {} cameras",
        map.points.len(),
        map.segments.len(),
        map.cameras.len()
    );
    let wrote = |path: &PathBuf| println!("wrote {}", path.display());
    if let Some(path) = &args.ply {
        write_ply(&map, path).context("writing PLY")?;
        wrote(path);
    }
    if let Some(path) = &args.obj {
        write_obj(&map, path).context("writing OBJ")?;
        wrote(path);
    }
    if let Some(path) = &args.glb {
        write_glb(&map, path).context("writing GLB")?;
        wrote(path);
    }
    if let Some(folder) = &args.colmap {
        ensure!(
            !map.cameras.is_empty(),
            "a COLMAP model needs cameras, and a scene file has none; give the label file"
        );
        write_colmap(&map, folder).context("writing the COLMAP model")?;
        wrote(folder);
    }
    Ok(())
}
