//! Arguments that several commands share. A command imports these and what does its work, never another command.

use crate::dataset::DataArgs;
use crate::metres::{Distance, Metres, parse_distance};
use crate::posing::PosingRequest;
use crate::privacy::Privacy;
use crate::refining::{RefinePoses, RefiningRequest};
use crate::teach::SceneRequest;
use crate::timestamp::now;
use crate::weights::{customary_extractor, load_extractor};
use crate::words::words;
#[cfg(feature = "train")]
use crate::{
    teach::{Training, When},
    train::run::{self, RunOptions},
};
use anyhow::Result;
#[cfg(feature = "train")]
use anyhow::bail;
use clap::builder::TypedValueParser;
use landline::formats::expressed;
use landline::geometry::CameraRecord;
#[cfg(feature = "train")]
use landline::models::{Preset, RegressorConfig};
use landline::nn::cpu::Level;
use landline::relocalizer::Device;
use landline::scene_file::{ExtractorFile, Precision};
use std::path::{Path, PathBuf};

/// How weights are stored.
pub fn precision() -> impl TypedValueParser<Value = Precision> {
    words([
        ("f32", Precision::F32, "32-bit"),
        ("f16", Precision::F16, "16-bit"),
        ("int8", Precision::Int8, "8-bit matrices"),
    ])
}

/// What may run the networks.
pub fn device() -> impl TypedValueParser<Value = Device> {
    words([
        (
            "auto",
            Device::Auto,
            "The faster of a hardware GPU and the CPU, as measured on the first pictures",
        ),
        (
            "gpu",
            Device::Gpu,
            "A GPU, also one that is simulated in software; refused when there is none",
        ),
        ("cpu", Device::Cpu, "The CPU"),
    ])
}

/// What a scene holds back.
pub fn privacy() -> impl TypedValueParser<Value = Privacy> {
    words([
        (
            "sparse",
            Privacy::Sparse,
            "A quarter of the points and lines: those that cover the place best",
        ),
        (
            "no-lines",
            Privacy::NoLines,
            "No lines: edges of walls and furniture are what people recognise first",
        ),
        (
            "coarse-descriptors",
            Privacy::CoarseDescriptors,
            "Descriptors of one bit a number in place of eight: less to compute a picture from",
        ),
        (
            "no-second-look",
            Privacy::NoSecondLook,
            "No landmarks to look at again, and with them no viewing directions: not where the camera went",
        ),
    ])
}

/// Which kernels run the networks.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct KernelArgs {
    /// Kernels of the networks: the fastest of this machine, or those that give the same bits everywhere.
    #[arg(long, default_value = "auto", value_name = "KERNELS", value_parser = kernels())]
    kernels: Level,
}

impl KernelArgs {
    /// The level that was asked for.
    pub fn level(self) -> Level {
        self.kernels
    }
}

fn kernels() -> impl TypedValueParser<Value = Level> {
    words([
        ("auto", Level::best(), "The fastest of this machine"),
        (
            "portable",
            Level::Portable,
            "The same bits on every machine, and as in the browser",
        ),
    ])
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
    #[arg(long, default_value = "int8", value_name = "PRECISION", value_parser = precision())]
    pub precision: Precision,
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
            precision: self.precision,
        })
    }

    /// The run folder that belongs to a scene file.
    pub fn run_folder(&self, out: &Path) -> PathBuf {
        self.run.clone().unwrap_or_else(|| usual_run_folder(out))
    }
}

/// The run folder of a scene file, where nobody named another.
pub fn usual_run_folder(scene: &Path) -> PathBuf {
    scene.with_extension("run")
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
    #[arg(long, default_value = "off", value_name = "WHEN", value_parser = refine_poses())]
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

fn refine_poses() -> impl TypedValueParser<Value = RefinePoses> {
    words([
        (
            "auto",
            RefinePoses::Auto,
            "Where pictures and poses disagree, and only if tracks, labels and pictures kept back say that it helps",
        ),
        ("on", RefinePoses::On, "In any case"),
        ("off", RefinePoses::Off, "In none"),
    ])
}

/// When networks are trained.
#[cfg(feature = "train")]
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct WhenArgs {
    /// When networks are trained; options of training ask for it too.
    #[arg(long, default_value = "auto", value_name = "WHEN", value_parser = when())]
    training: When,
}

#[cfg(feature = "train")]
impl WhenArgs {
    /// When they are, beside these options of training.
    pub fn when(self, how: &TrainingArgs) -> When {
        match self.training {
            When::Auto if how.is_asked_for() => When::Always,
            when => when,
        }
    }
}

#[cfg(feature = "train")]
fn when() -> impl TypedValueParser<Value = When> {
    words([
        (
            "auto",
            When::Auto,
            "When the landmarks alone do not locate the pictures that were kept back, or options of training are given",
        ),
        ("always", When::Always, "In any case"),
        ("never", When::Never, "In none"),
    ])
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

/// Options of training in a build without it: they are known, and refused with how to have them.
#[cfg(not(feature = "train"))]
#[derive(Debug, Default, clap::Args)]
pub struct Untrained {
    #[arg(long, hide = true, value_parser = untrained_when)]
    training: Option<String>,
    #[arg(long, hide = true, value_parser = untrained)]
    variants: Option<String>,
    #[arg(long, hide = true, value_parser = untrained)]
    preset: Option<String>,
    #[arg(long, hide = true, value_parser = untrained)]
    minutes: Option<String>,
    #[arg(long, hide = true, value_parser = untrained)]
    steps: Option<String>,
    #[arg(long, hide = true, value_parser = untrained)]
    seed: Option<String>,
    #[arg(long = "set", hide = true, value_parser = untrained)]
    overrides: Option<String>,
    #[arg(long, hide = true, value_parser = untrained)]
    network: Option<String>,
    #[arg(long, hide = true, num_args = 0..=1, default_missing_value = "", value_parser = untrained)]
    resume: Option<String>,
}

/// What whoever asks for training is told.
#[cfg(not(feature = "train"))]
pub const UNTRAINED: &str = "this build was made without training; `cargo build --release -p landline-mapper`, without \
                             `--no-default-features`, makes one with it";

#[cfg(not(feature = "train"))]
fn untrained(_: &str) -> Result<String, &'static str> {
    Err(UNTRAINED)
}

/// Not to train is what such a build does.
#[cfg(not(feature = "train"))]
fn untrained_when(when: &str) -> Result<String, &'static str> {
    match when {
        "auto" | "never" => Ok(when.to_owned()),
        _ => Err(UNTRAINED),
    }
}
