//! `landline convert`: a foreign checkpoint becomes an extractor file or a scene file.

use crate::files::write_bytes;
use crate::import::{ImportOptions, Imported, import};
use crate::weights::load_extractor;
use anyhow::{Context as _, Result, bail, ensure};
use clap::ValueEnum;
use landline::models::{ExtractorKind, RegressorConfig, Sampler};
use landline::scene_file::{ExtractorFile, Precision, SceneFile, SceneInfo};
use std::path::PathBuf;

/// Convert a checkpoint (XFeat, SuperPoint, PL2Map, the paper's network) to Landline's format.
///
/// Reads PyTorch files (.pt, .pth, .pth.tar) without executing anything in them, and safetensors. An extractor becomes an
/// extractor file; a regressor becomes a scene file and needs `--trained-with`, the extractor of its training.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The checkpoint.
    checkpoint: PathBuf,
    /// The file to write: NAME.safetensors for an extractor, NAME.landline for a scene.
    out: PathBuf,
    /// Refuse the checkpoint unless it holds this extractor: xfeat, superpoint-v1 or superpoint-open.
    #[arg(long, value_name = "NAME")]
    extractor: Option<String>,
    /// How weights are stored.
    #[arg(long, value_enum, default_value_t = PrecisionArg::F16)]
    precision: PrecisionArg,
    /// Refuse the checkpoint unless it has this SHA-256.
    #[arg(long)]
    sha256: Option<String>,
    /// Regressors: the extractor that it was trained with, converted or as checkpoint.
    #[arg(long, value_name = "FILE")]
    trained_with: Option<PathBuf>,
    /// Regressors: attention heads.
    #[arg(long, default_value_t = 4)]
    heads: usize,
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

/// Runs the command.
///
/// # Errors
/// When the checkpoint cannot be read or converted, or the file cannot be written.
pub fn run(args: Args) -> Result<()> {
    let bytes = std::fs::read(&args.checkpoint)
        .with_context(|| format!("cannot read {}", args.checkpoint.display()))?;
    if let Some(expected) = &args.sha256 {
        let found = crate::import::sha256_hex(&bytes);
        ensure!(
            found.eq_ignore_ascii_case(expected),
            "{} has SHA-256 {found}, expected {expected}",
            args.checkpoint.display()
        );
    }
    let options = ImportOptions {
        heads: args.heads,
        min_point_confidence: args.min_point_confidence,
        min_line_confidence: args.min_line_confidence,
        ..ImportOptions::default()
    };
    let imported = import(&bytes, &options)
        .with_context(|| format!("cannot convert {}", args.checkpoint.display()))?;
    if let Some(expected) = &args.extractor {
        let found = match &imported {
            Imported::Extractor(file) => file.kind.name(),
            Imported::Regressor { config, .. } => config.variant().name(),
        };
        ensure!(
            found == expected,
            "{} holds {found}, not {expected}",
            args.checkpoint.display()
        );
    }
    let precision = args.precision.into();
    let (written, what) = match imported {
        Imported::Extractor(mut file) => {
            if let Some(source) = args.source {
                file.source = source;
            }
            if let Some(licence) = args.licence {
                file.licence = licence;
            }
            (
                file.to_bytes(precision)?,
                format!("extractor {}", file.kind.name()),
            )
        }
        Imported::Regressor { config, weights } => {
            let Some(path) = &args.trained_with else {
                bail!(
                    "{} is a regressor ({}); give the extractor that it was trained with as --trained-with FILE",
                    args.checkpoint.display(),
                    config.variant().name()
                );
            };
            let extractor = load_extractor(path)?;
            let scene = imported_scene(&extractor, config, weights, args.source, args.licence)?;
            (
                scene.to_bytes(precision)?,
                format!("scene of variant {}", scene.config.variant().name()),
            )
        }
    };
    write_bytes(&args.out, &written)?;
    println!("{}: {what}, {} bytes", args.out.display(), written.len());
    Ok(())
}

/// A scene file for an imported regressor: raw world coordinates, the reference's sampler, segments half a pixel off.
fn imported_scene(
    extractor: &ExtractorFile,
    config: RegressorConfig,
    weights: landline::nn::Weights,
    source: Option<String>,
    licence: Option<String>,
) -> Result<SceneFile> {
    let mut info = SceneInfo::new(extractor.kind, extractor.source_sha256.clone());
    info.sampler = match extractor.kind {
        ExtractorKind::Xfeat => Sampler::Xfeat,
        ExtractorKind::SuperPointV1 => Sampler::Legacy,
        ExtractorKind::SuperPointOpen => Sampler::Exact,
    };
    info.line_halfpixel = false;
    info.working_max_side = 1024;
    info.licence = licence.unwrap_or_default();
    info.training = Some(landline::scene_file::TrainingSummary {
        source: source.unwrap_or_default(),
        ..Default::default()
    });
    Ok(SceneFile {
        info,
        config,
        weights,
    })
}
