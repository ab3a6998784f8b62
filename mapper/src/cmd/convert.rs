//! `landline convert`: a foreign checkpoint becomes an extractor file or a scene file; a file of ours is stored anew.

use crate::args::{precision, privacy};
use crate::dataset::{check_scale, gravity_from_up, parse_vector, units};
use crate::files::write_bytes;
use crate::import::{ImportOptions, Imported, import};
use crate::privacy::{Privacy, hold_back};
use crate::timestamp::now;
use crate::weights::load_extractor;
use anyhow::{Context as _, Result, bail, ensure};
use landline::models::{ExtractorKind, RegressorConfig, Sampler};
use landline::nn::Weights;
use landline::scene_file::{
    ExtractorFile, Precision, SceneFile, SceneFileError, SceneInfo, Timestamp, TrainingSummary,
    Units,
};
use std::path::PathBuf;

/// Convert a checkpoint (XFeat, SuperPoint, PL2Map, the paper's network) to Landline's format, or a Landline file to another
/// precision or another description.
///
/// Reads PyTorch files (.pt, .pth, .pth.tar) without executing anything in them, and safetensors. An extractor becomes an
/// extractor file; a regressor becomes a scene file and needs `--trained-with`, the extractor of its training. Of a scene or
/// extractor file only what is asked for changes: the storage of its weights (`--precision`), what is said about its world
/// (`--units`, `--scale`, `--up`), source and licence.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The checkpoint, or a Landline file.
    checkpoint: PathBuf,
    /// The file to write: NAME.safetensors for an extractor, NAME.landline for a scene.
    out: PathBuf,
    /// Refuse the checkpoint unless it holds this extractor: xfeat, superpoint-v1 or superpoint-open.
    #[arg(long, value_name = "NAME")]
    extractor: Option<String>,
    /// How weights are stored; without it a scene file of ours keeps them as they are, anything else has 16 bits.
    #[arg(long, alias = "weights", value_name = "PRECISION", value_parser = precision())]
    precision: Option<Precision>,
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
    /// Scenes: what one unit of length of the world is.
    #[arg(long, value_name = "UNITS", value_parser = units())]
    units: Option<Units>,
    /// Scenes: metres for one unit of length of the world, which is multiplied by it and in metres then.
    #[arg(
        long,
        value_name = "F",
        conflicts_with = "units",
        allow_hyphen_values = true
    )]
    scale: Option<f64>,
    /// Scenes: which way is up in the world.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_vector)]
    up: Option<[f64; 3]>,
    /// Scenes: when it was made, in UTC as ISO 8601, for files that do not say.
    #[arg(long, value_name = "YYYY-MM-DD[Thh:mm:ssZ]", value_parser = parse_timestamp)]
    created: Option<Timestamp>,
    /// Scenes: what it holds back from strangers, at a cost in accuracy; several with commas. Weights have 8 bits then unless
    /// `--precision` says otherwise.
    #[arg(long, value_delimiter = ',', value_name = "WHAT", value_parser = privacy())]
    privacy: Vec<Privacy>,
    /// Where the checkpoint came from; goes into the file.
    #[arg(long)]
    source: Option<String>,
    /// Licence of the weights; goes into the file.
    #[arg(long)]
    licence: Option<String>,
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

    /// Notes what the command line says: where the weights came from, under which licence they are, what the world is.
    fn describe(&mut self, args: &Args) -> Result<()> {
        let (source, licence) = (args.source.clone(), args.licence.clone());
        match self {
            Self::Extractor(file) => {
                ensure!(
                    args.units.is_none()
                        && args.scale.is_none()
                        && args.up.is_none()
                        && args.created.is_none()
                        && args.privacy.is_empty(),
                    "{} is an extractor: --units, --scale, --up, --created and --privacy are for scenes",
                    args.checkpoint.display()
                );
                file.source = source.unwrap_or(std::mem::take(&mut file.source));
                file.licence = licence.unwrap_or(std::mem::take(&mut file.licence));
            }
            Self::Scene(scene) => {
                let info = &mut scene.info;
                if let Some(source) = source {
                    info.training.get_or_insert_default().source = source;
                }
                if let Some(licence) = licence {
                    info.licence = licence;
                }
                info.created = args.created.clone().or(info.created.take());
                describe_world(scene, args)?;
                hold_back(scene, &args.privacy)?;
            }
        }
        Ok(())
    }

    fn to_bytes(&self, precision: Precision) -> Result<Vec<u8>, SceneFileError> {
        match self {
            Self::Extractor(file) => file.to_bytes(precision),
            Self::Scene(scene) => scene.to_bytes(precision),
        }
    }
}

fn parse_timestamp(text: &str) -> Result<Timestamp, String> {
    Timestamp::parse(text).map_err(|e| e.to_string())
}

/// Notes unit, scale and gravity of a scene's world.
fn describe_world(scene: &mut SceneFile, args: &Args) -> Result<()> {
    let info = &mut scene.info;
    if let Some(up) = args.up {
        info.gravity = Some(gravity_from_up(&args.checkpoint, up)?);
    }
    let units = args.units.unwrap_or(info.units);
    let is_other = units != info.units || args.scale.is_some();
    info.units = units;
    if let Some(scale) = args.scale {
        check_scale(&args.checkpoint, scale)?;
        info.units = Units::Metres;
        info.scale.centre *= scale;
        info.scale.scale *= scale;
        if let Some(table) = &mut scene.landmarks {
            table.grid.origin *= scale;
            table.grid.step *= scale;
        }
    }
    if let (true, Some(held_out)) = (
        is_other,
        info.training.as_mut().and_then(|t| t.held_out.as_mut()),
    ) {
        held_out.median_position = held_out
            .median_position
            .map(|m| args.scale.unwrap_or(1.0) * m);
        // A share within centimetres of another unit cannot be turned into one of this.
        held_out.recall_5cm_5deg = None;
    }
    Ok(())
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
    let is_own = own.is_some();
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
    content.describe(&args)?;
    let precision = match (args.precision, args.privacy.is_empty()) {
        (None, false) => Some(Precision::Int8),
        (said, _) => said,
    };
    let written = match (&content, is_own, precision) {
        (Content::Scene(scene), true, None) => {
            SceneFile::redescribed(&bytes, |stored| stored.clone_from(scene))?
        }
        (_, _, precision) => content.to_bytes(precision.unwrap_or(Precision::F16))?,
    };
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
            let scene = imported_scene(&extractor, config, weights)?;
            Ok(Content::Scene(Box::new(scene)))
        }
    }
}

/// A scene for an imported regressor: raw world coordinates, the reference's sampler, segments half a pixel off.
fn imported_scene(
    extractor: &ExtractorFile,
    config: RegressorConfig,
    weights: Weights,
) -> Result<SceneFile> {
    let mut info = SceneInfo::new(extractor.kind, extractor.source_sha256.clone());
    info.sampler = match extractor.kind {
        ExtractorKind::Xfeat => Sampler::Xfeat,
        ExtractorKind::SuperPointV1 => Sampler::Legacy,
        ExtractorKind::SuperPointOpen => Sampler::Exact,
    };
    info.line_halfpixel = false;
    info.working_max_side = 1024;
    info.training = Some(TrainingSummary::default());
    info.created = Some(now()?);
    Ok(SceneFile {
        info,
        config,
        weights,
        landmarks: None,
    })
}
