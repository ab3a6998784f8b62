//! Scene files from disk, and the relocalizer made of them.

use crate::picture;
use anyhow::{Context, Result, ensure};
use landline::front_end::FrontEndOptions;
use landline::relocalizer::{Relocalizer, RelocalizerOptions};
use landline::scene_file::{ExtractorFile, SceneFile};
use std::path::Path;

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// A scene file and its size in bytes.
///
/// # Errors
/// When it is missing or no scene.
pub fn read_scene(path: &Path) -> Result<(SceneFile, usize)> {
    ensure!(
        !path.is_dir(),
        "{} is a folder: a scene file is wanted here, as `landline map` writes it, and other things after it",
        path.display()
    );
    let bytes = read(path)?;
    ensure!(
        !picture::is_picture(&bytes),
        "{} is a picture: a scene file is wanted here, as `landline map` writes it; pictures come after it",
        path.display()
    );
    let scene = SceneFile::from_bytes(&bytes)
        .with_context(|| format!("cannot use scene {}", path.display()))?;
    Ok((scene, bytes.len()))
}

/// The relocalizer of a scene.
///
/// # Errors
/// When scene and extractor do not belong together.
pub fn relocalizer(
    scene: SceneFile,
    extractor: ExtractorFile,
    change: impl FnOnce(&mut RelocalizerOptions),
) -> Result<Relocalizer> {
    Relocalizer::new(scene, extractor, change).context("cannot prepare the scene")
}

/// The front end that a scene was taught with, for features outside the relocalizer.
pub fn front_end_options(scene: &SceneFile) -> FrontEndOptions {
    FrontEndOptions {
        max_side: scene.info.working_max_side as usize,
        sampler: scene.info.sampler,
        ..FrontEndOptions::new(scene.info.extractor)
    }
}
