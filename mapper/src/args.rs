//! Arguments that several commands share. A command imports these and what does its work, never another command.

use crate::dataset::DataArgs;
use crate::metres::{Distance, Metres, parse_distance};
use crate::posing::PosingRequest;
use crate::refining::{RefinePoses, RefiningRequest};
use crate::scene::ExtractorArgs;
use crate::teach::SceneRequest;
use crate::timestamp::now;
#[cfg(feature = "train")]
use crate::{
    teach::{Training, When},
    train::run::{self, RunOptions},
};
use anyhow::Result;
#[cfg(feature = "train")]
use anyhow::bail;
use clap::ValueEnum;
use landline::formats::expressed;
use landline::geometry::CameraRecord;
#[cfg(feature = "train")]
use landline::models::{Preset, RegressorConfig};
use landline::scene_file::Precision;
use std::path::{Path, PathBuf};

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

/// What is taught: pictures with poses, by which extractor, with which 3D targets.
#[derive(Debug, Clone, clap::Args)]
pub struct TeachingArgs {
    /// The pictures.
    #[command(flatten)]
    pub data: DataArgs,
    /// What describes them.
    #[command(flatten)]
    pub extractor: ExtractorArgs,
    /// Folder of cached features; an interrupted run goes on from there.
    #[arg(long, value_name = "DIR")]
    pub features: Option<PathBuf>,
    /// Where 3D points come from.
    #[arg(long, value_enum, default_value_t = PointSource::Pictures)]
    pub points_from: PointSource,
}

/// Where the 3D points of labels come from. Lines come from the line map that `--lines` gives, or from the pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PointSource {
    /// Matched and triangulated under the poses.
    Pictures,
    /// The data set's own model (COLMAP): a keypoint takes the point whose observation lies nearest.
    Model,
}

impl TeachingArgs {
    /// Whether points are the data set's own.
    pub fn has_model_points(&self) -> bool {
        self.points_from == PointSource::Model
    }
}

/// How large a scene may become.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct SizeArgs {
    /// Most bytes of the scene file: landmarks take what the networks leave. Without it 400,000, or what the networks take
    /// and 140,000.
    #[arg(long, value_name = "N")]
    pub max_bytes: Option<usize>,
}

/// What a scene file says and holds, whoever makes its networks.
#[derive(Debug, clap::Args)]
pub struct SceneArgs {
    /// Most landmarks of the point branch.
    #[arg(long)]
    pub anchors: Option<usize>,
    /// Leave the line branch out.
    #[arg(long)]
    pub no_lines: bool,
    /// Keep one picture in so many back, in one stretch, to measure the networks on; 0 keeps none.
    #[arg(long, default_value_t = 20)]
    pub hold_out_every: usize,
    /// Licence of the map; goes into the file.
    #[arg(long, default_value = "")]
    pub licence: String,
    /// Folder for what a run keeps: features, options, log, curves, checkpoint; without it OUT with the ending `.run`.
    #[arg(long)]
    pub run: Option<PathBuf>,
    /// How large the scene may become.
    #[command(flatten)]
    pub size: SizeArgs,
    /// How weights are stored.
    #[arg(long, value_enum, default_value_t = PrecisionArg::Int8)]
    pub precision: PrecisionArg,
}

impl SceneArgs {
    /// What is asked of the scene, made now.
    ///
    /// # Errors
    /// When the environment's moment is none.
    pub fn request(&self) -> Result<SceneRequest> {
        Ok(SceneRequest {
            anchors: self.anchors,
            lines: !self.no_lines,
            hold_out_every: self.hold_out_every,
            licence: self.licence.clone(),
            created: Some(now()?),
            max_bytes: self.size.max_bytes,
            precision: self.precision.into(),
        })
    }

    /// The run folder that belongs to a scene file.
    pub fn run_folder(&self, out: &Path) -> PathBuf {
        self.run
            .clone()
            .unwrap_or_else(|| out.with_extension("run"))
    }
}

/// How pictures without poses are posed.
#[derive(Debug, Clone, clap::Args)]
pub struct PosingArgs {
    /// Focal length in pixels of pictures without poses; found out when not given.
    #[arg(long, value_name = "PX", conflicts_with = "camera")]
    pub focal: Option<f64>,
    /// Pictures without poses are not in the order in which they were taken.
    #[arg(long)]
    pub unordered: bool,
    /// Frames of a video that are taken for each second of it.
    #[arg(long, value_name = "N", default_value_t = 3.0)]
    pub frames_per_second: f64,
    /// Metres for pictures without poses: the distance between the places where two of them were taken.
    #[arg(long, value_name = "NAME,NAME,METRES", value_parser = parse_distance, conflicts_with = "positions")]
    pub scale_from: Option<Distance>,
    /// Metres and axes for pictures without poses: a list `name x y z` of places where some of them were taken.
    #[arg(long, value_name = "FILE")]
    pub positions: Option<PathBuf>,
}

impl PosingArgs {
    /// What is asked, for pictures of this folder or video.
    ///
    /// # Errors
    /// When the camera is of a model that is not known, or the list of positions cannot be read.
    pub fn request(&self, pictures: &Path, camera: Option<&CameraRecord>) -> Result<PosingRequest> {
        Ok(PosingRequest {
            pictures: pictures.to_owned(),
            focal_px: self.focal,
            camera: camera.map(expressed).transpose()?,
            is_unordered: self.unordered,
            frames_per_second: self.frames_per_second,
            metres: match (&self.scale_from, &self.positions) {
                (Some(distance), _) => Some(Metres::Distance(distance.clone())),
                (None, Some(path)) => Some(Metres::read_positions(path)?),
                (None, None) => None,
            },
        })
    }

    /// The option that gives pictures without poses metres.
    pub fn metres_option(&self) -> Option<&'static str> {
        let positions = self.positions.as_ref().map(|_| "--positions");
        self.scale_from
            .as_ref()
            .map(|_| "--scale-from")
            .or(positions)
    }
}

/// How poses that came with the pictures are refined.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct RefiningArgs {
    /// When poses that came with the pictures are adjusted to what the pictures show; `auto` keeps the outcome only where it
    /// is better.
    #[arg(long, value_enum, default_value_t = RefinePoses::Off, value_name = "WHEN")]
    pub refine_poses: RefinePoses,
    /// Refine focal length and one radial term with the poses.
    #[arg(long)]
    pub refine_camera: bool,
}

impl RefiningArgs {
    /// What is asked.
    pub fn request(&self, is_unordered: bool) -> RefiningRequest {
        RefiningRequest {
            when: self.refine_poses,
            camera: self.refine_camera,
            is_unordered,
        }
    }
}

/// How networks are trained.
#[cfg(feature = "train")]
#[derive(Debug, clap::Args)]
pub struct TrainingArgs {
    /// Size and recipe: compact, standard or paper.
    #[arg(long, default_value = "compact", value_parser = parse_preset)]
    pub preset: Preset,
    /// Length of training; without it the preset's number of steps.
    #[arg(long)]
    pub minutes: Option<f64>,
    /// Steps of each branch.
    #[arg(long, conflicts_with = "minutes")]
    pub steps: Option<usize>,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Change a number of the recipe: FIELD=VALUE; may be repeated.
    #[arg(long = "set", value_name = "FIELD=VALUE", value_parser = parse_override)]
    pub overrides: Vec<String>,
    /// Change the network: point.FIELD=VALUE or line.FIELD=VALUE; may be repeated.
    #[arg(long = "network", value_name = "PATH=VALUE", value_parser = parse_network)]
    pub network: Vec<String>,
    /// Go on with an interrupted run in that folder.
    #[arg(long)]
    pub resume: bool,
}

#[cfg(feature = "train")]
fn parse_preset(text: &str) -> Result<Preset, String> {
    Preset::ALL
        .into_iter()
        .find(|p| p.name() == text)
        .ok_or_else(|| {
            let names: Vec<_> = Preset::ALL.iter().map(|p| p.name()).collect();
            format!("there is {}, not `{text}`", names.join(", "))
        })
}

#[cfg(feature = "train")]
fn parse_override(text: &str) -> Result<String, String> {
    run::check_override(text).map(|()| text.to_owned())
}

#[cfg(feature = "train")]
fn parse_network(text: &str) -> Result<String, String> {
    let fits = |preset| {
        let network = RegressorConfig::preset(preset, DESCRIPTOR_LEN);
        run::changed_network(&network, text)
    };
    // Which preset it is for is not known here; it must fit one.
    let outcomes: Vec<_> = Preset::ALL.into_iter().map(fits).collect();
    match outcomes.iter().find(|o| o.is_ok()) {
        Some(_) => Ok(text.to_owned()),
        None => outcomes
            .into_iter()
            .next()
            .map_or(Ok(text.to_owned()), |o| o.map(|_| text.to_owned())),
    }
}

#[cfg(feature = "train")]
/// Any that the presets accept, to check options before the labels are read.
const DESCRIPTOR_LEN: usize = 64;

#[cfg(feature = "train")]
impl TrainingArgs {
    /// A training in `folder`, where something changes the networks: in any case, or when it can help.
    ///
    /// # Errors
    /// When `--minutes` is not positive.
    pub fn training(&self, when: When, scene: &SceneArgs, folder: PathBuf) -> Result<Training> {
        if let Some(minutes) = self.minutes
            && !(minutes > 0.0 && minutes.is_finite())
        {
            bail!("--minutes is {minutes}; give a positive number");
        }
        Ok(Training {
            when,
            folder,
            resume: self.resume,
            variants: 0,
            options: RunOptions {
                preset: self.preset,
                seed: self.seed,
                minutes: self.minutes,
                steps: self.steps,
                anchors: scene.anchors,
                lines: !scene.no_lines,
                hold_out_every: scene.hold_out_every,
                overrides: self.overrides.clone(),
                network: self.network.clone(),
            },
        })
    }

    /// Whether options say more than the defaults do, so that training is meant.
    pub fn is_asked_for(&self) -> bool {
        self.preset != Preset::Compact
            || self.minutes.is_some()
            || self.steps.is_some()
            || self.resume
            || !self.overrides.is_empty()
            || !self.network.is_empty()
    }
}
