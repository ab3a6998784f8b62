//! `landline convert`: a foreign checkpoint becomes an extractor file or a scene file; a file of ours is stored anew.

use crate::files::write_bytes;
use crate::import::{ImportOptions, Imported, import};
use crate::weights::load_extractor;
use anyhow::{Context as _, Result, bail, ensure};
use clap::ValueEnum;
use landline::models::{ExtractorKind, RegressorConfig, Sampler};
use landline::nn::Weights;
use landline::scene_file::{
    ExtractorFile, Precision, SceneFile, SceneFileError, SceneInfo, TrainingSummary,
};
use std::path::PathBuf;

/// Convert a checkpoint (XFeat, SuperPoint, PL2Map, the paper's network) to Landline's format, or a Landline file to another
/// precision.
///
/// Reads PyTorch files (.pt, .pth, .pth.tar) without executing anything in them, and safetensors. An extractor becomes an
/// extractor file; a regressor becomes a scene file and needs `--trained-with`, the extractor of its training. Of a scene or
/// extractor file only the storage of its weights changes.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The checkpoint, or a Landline file.
    checkpoint: PathBuf,
    /// The file to write: NAME.safetensors for an extractor, NAME.landline for a scene.
    out: PathBuf,
    /// Refuse the checkpoint unless it holds this extractor: xfeat, superpoint-v1 or superpoint-open.
    #[arg(long, value_name = "NAME")]
    extractor: Option<String>,
    /// How weights are stored.
    #[arg(long, alias = "weights", value_enum, default_value_t = PrecisionArg::F16)]
    precision: PrecisionArg,
    /// Refuse the checkpoint unless it has this SHA-256.
    #[arg(long)]
    sha256: Option<String>,
    /// Regressors: the extractor that it was trained with, converted or as checkpoint.
    #[arg(long, value_name = "FILE")]
    trained_with: Option<PathBuf>,
    /// Regressors: attention heads; 4 when not given.
    #[arg(long)]
    heads: Option<usize>,
    /// Regressors: confidence threshold of points instead of the published one.
    #[arg(long)]
    min_point_confidence: Option<f32>,
    /// Regressors: confidence threshold of lines instead of the published one.
    #[arg(long)]
    min_line_confidence: Option<f32>,
    /// Where the checkpoint came from; goes into the file.
    #[arg(long)]
    source: Option<String>,
    /// Licence of the weights; goes into the file.
    #[arg(long)]
    licence: Option<String>,
}

/// Storage of weights on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PrecisionArg {
    /// 32-bit.
    F32,
    /// 16-bit.
    F16,
    /// 8-bit matrices.
    Int8,
}

impl From<PrecisionArg> for Precision {
    fn from(arg: PrecisionArg) -> Self {
        match arg {
            PrecisionArg::F32 => Self::F32,
            PrecisionArg::F16 => Self::F16,
            PrecisionArg::Int8 => Self::Int8,
        }
    }
}

/// What goes into the file.
enum Content {
    Extractor(ExtractorFile),
    Scene(Box<SceneFile>),
}

impl Content {
    fn name(&self) -> &'static str {
        match self {
            Self::Extractor(file) => file.kind.name(),
            Self::Scene(scene) => scene.config.variant().name(),
        }
    }

    /// Notes where the weights came from and under which licence they are.
    fn describe(&mut self, source: Option<String>, licence: Option<String>) {
        match self {
            Self::Extractor(file) => {
                file.source = source.unwrap_or(std::mem::take(&mut file.source));
                file.licence = licence.unwrap_or(std::mem::take(&mut file.licence));
            }
            Self::Scene(scene) => {
                if let Some(source) = source {
                    scene.info.training.get_or_insert_default().source = source;
                }
                if let Some(licence) = licence {
                    scene.info.licence = licence;
                }
            }
        }
    }

    fn to_bytes(&self, precision: Precision) -> Result<Vec<u8>, SceneFileError> {
        match self {
            Self::Extractor(file) => file.to_bytes(precision),
            Self::Scene(scene) => scene.to_bytes(precision),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// When the file cannot be read or converted, or the new one cannot be written.
pub fn run(args: Args) -> Result<()> {
    let name = args.checkpoint.display();
    let bytes = std::fs::read(&args.checkpoint).with_context(|| format!("cannot read {name}"))?;
    if let Some(expected) = &args.sha256 {
        let found = crate::import::sha256_hex(&bytes);
        ensure!(
            found.eq_ignore_ascii_case(expected),
            "{name} has SHA-256 {found}, expected {expected}"
        );
    }
    let own = read_own(&bytes).with_context(|| format!("cannot convert {name}"))?;
    let mut content = match own {
        Some(own) => {
            let foreign = args.trained_with.is_some()
                || args.heads.is_some()
                || args.min_point_confidence.is_some()
                || args.min_line_confidence.is_some();
            ensure!(
                !foreign,
                "{name} is a Landline file and knows its network: --trained-with, --heads and the thresholds are for foreign checkpoints"
            );
            own
        }
        None => read_foreign(&args, &bytes)?,
    };
    if let Some(expected) = &args.extractor {
        let found = content.name();
        ensure!(found == expected, "{name} holds {found}, not {expected}");
    }
    content.describe(args.source, args.licence);
    let written = content.to_bytes(args.precision.into())?;
    write_bytes(&args.out, &written)?;
    let kind = match &content {
        Content::Extractor(_) => "extractor",
        Content::Scene(_) => "scene of variant",
    };
    println!(
        "{}: {kind} {}, {} bytes",
        args.out.display(),
        content.name(),
        written.len()
    );
    Ok(())
}

/// A file of our own, to be stored in another precision; `None` for foreign and for damaged ones.
fn read_own(bytes: &[u8]) -> Result<Option<Content>, SceneFileError> {
    match SceneFile::from_bytes(bytes) {
        Ok(scene) => Ok(Some(Content::Scene(Box::new(scene)))),
        Err(SceneFileError::Kind { found, .. }) if found == "extractor" => {
            Ok(Some(Content::Extractor(ExtractorFile::from_bytes(bytes)?)))
        }
        // What cannot be parsed may be a PyTorch checkpoint; the importer says what is wrong with it otherwise.
        Err(
            SceneFileError::NotLandline { .. }
            | SceneFileError::TooLarge { .. }
            | SceneFileError::Truncated { .. }
            | SceneFileError::HeaderTooLong { .. }
            | SceneFileError::Header { .. },
        ) => Ok(None),
        Err(error) => Err(error),
    }
}

fn read_foreign(args: &Args, bytes: &[u8]) -> Result<Content> {
    let name = args.checkpoint.display();
    let default = ImportOptions::default();
    let options = ImportOptions {
        heads: args.heads.unwrap_or(default.heads),
        min_point_confidence: args.min_point_confidence,
        min_line_confidence: args.min_line_confidence,
        ..default
    };
    match import(bytes, &options).with_context(|| format!("cannot convert {name}"))? {
        Imported::Extractor(file) => Ok(Content::Extractor(file)),
        Imported::Regressor { config, weights } => {
            let Some(path) = &args.trained_with else {
                bail!(
                    "{name} is a regressor ({}); give the extractor that it was trained with as --trained-with FILE",
                    config.variant().name()
                );
            };
            let extractor = load_extractor(path)?;
            Ok(Content::Scene(Box::new(imported_scene(
                &extractor, config, weights,
            ))))
        }
    }
}

/// A scene for an imported regressor: raw world coordinates, the reference's sampler, segments half a pixel off.
fn imported_scene(
    extractor: &ExtractorFile,
    config: RegressorConfig,
    weights: Weights,
) -> SceneFile {
    let mut info = SceneInfo::new(extractor.kind, extractor.source_sha256.clone());
    info.sampler = match extractor.kind {
        ExtractorKind::Xfeat => Sampler::Xfeat,
        ExtractorKind::SuperPointV1 => Sampler::Legacy,
        ExtractorKind::SuperPointOpen => Sampler::Exact,
    };
    info.line_halfpixel = false;
    info.working_max_side = 1024;
    info.training = Some(TrainingSummary::default());
    SceneFile {
        info,
        config,
        weights,
        landmarks: None,
    }
}
