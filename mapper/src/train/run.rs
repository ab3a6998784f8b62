//! A whole training run: both branches, a run folder with options, log, curves and checkpoints, a progress bar.
//!
//! The folder holds `options.json` (written first), `log.csv`, `curves.svg` and `checkpoint.safetensors`. A run that was
//! interrupted goes on from its checkpoint with `resume`, and ends with the same tensors as one that was not. A checkpoint
//! belongs to the options and the labels of its run: with others it is refused.

use super::buffer::{Buffer, Kind};
use super::held_out::{Judgement, judge};
use super::identity::Identity;
use super::recipe::{self, Recipe};
use super::session::{BranchConfig, Session, StepReport};
use super::{checkpoint, curves};
use crate::eval::held_range;
use crate::files;
use crate::labels::{Labelled, Labels, Targets};
use crate::units::Ruler;
use burn::tensor::Device;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use landline::geometry::SceneScale;
use landline::models::{Preset, RegressorConfig, TensorSpec};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Why a run could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The run folder cannot be written or read.
    #[error("run folder {folder}: {source}")]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// From the operating system.
        source: io::Error,
    },
    /// The folder belongs to another run.
    #[error(
        "run folder {folder} holds a run of {what}: --resume would mix the two; choose another folder (--run DIR), or \
         begin anew without --resume"
    )]
    OtherRun {
        /// The folder.
        folder: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// A damaged checkpoint.
    #[error("checkpoint {path}: {what}; delete it to start the run again")]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// Nothing to learn from.
    #[error(
        "{labelled} of {features} {kind} have a 3D target, {needed} are needed; are the poses right and do the pictures overlap?"
    )]
    TooFewLabels {
        /// `keypoints` or `segments`.
        kind: &'static str,
        /// Features in all pictures.
        features: usize,
        /// Those with a target.
        labelled: usize,
        /// Least number.
        needed: usize,
    },
    /// [`Control::stop`] asked for it.
    #[error("training was stopped at step {step}; go on with --resume and run folder {folder}")]
    Stopped {
        /// Holds the checkpoint.
        folder: PathBuf,
        /// Steps of all branches.
        step: usize,
    },
    /// A change to the network that it does not take.
    #[error("{0}")]
    Network(String),
    /// Numbers that are not finite.
    #[error(
        "training of the {kind} diverged at step {step} (loss {loss}); lower the rate (now {rate})"
    )]
    Diverged {
        /// Which branch.
        kind: &'static str,
        /// When.
        step: usize,
        /// The loss.
        loss: f64,
        /// The learning rate.
        rate: f64,
    },
}

/// What to train, and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunOptions {
    /// Sizes and recipe.
    pub preset: Preset,
    /// Of everything random.
    pub seed: u64,
    /// Length of both branches together; their recipes' steps shrink or grow in proportion.
    pub minutes: Option<f64>,
    /// Overrides the steps of both branches.
    pub steps: Option<usize>,
    /// Most landmarks of the point branch.
    pub anchors: Option<usize>,
    /// Whether the line branch is trained.
    pub lines: bool,
    /// One picture in so many is kept back, in one stretch: the best state on them is delivered. 0 keeps none.
    pub hold_out_every: usize,
    /// Changes to the recipes: `field=value`, for both branches.
    pub overrides: Vec<String>,
    /// Changes to the networks: `point.field=value` or `line.field=value`.
    pub network: Vec<String>,
}

/// What training gained on the held-out pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// Which branch.
    pub kind: Kind,
    /// Before the first step.
    pub start: Judgement,
    /// What is delivered.
    pub delivered: Judgement,
    /// Step that it is from.
    pub step: usize,
}

/// A trained tensor.
pub type NamedTensor = (TensorSpec, Vec<f32>);

/// What comes out.
#[derive(Debug)]
pub struct Trained {
    /// With the number of anchors that there were landmarks for.
    pub config: RegressorConfig,
    /// Normalisation of coordinates.
    pub scale: SceneScale,
    /// In the configuration's order.
    pub tensors: Vec<NamedTensor>,
    /// The pictures of the labels that were kept back.
    pub held: Range<usize>,
    /// Held-out numbers of each branch.
    pub held_out: Vec<Judged>,
    /// Training alone.
    pub seconds: f64,
    /// Steps of each branch.
    pub steps: Vec<(Kind, usize)>,
}

fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Points => "keypoints",
        Kind::Segments => "segments",
    }
}

/// Fewest labelled features that a branch is trained on.
const MIN_LABELLED: usize = 100;
/// Time between checkpoints: what a kill can cost, whatever a step takes.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(20);
/// Judgements on the held-out pictures in a run.
const JUDGEMENTS: usize = 10;
const CHECKPOINT: &str = "checkpoint.safetensors";
/// Where a checkpoint goes that a run without `resume` begins over.
const CHECKPOINT_BEFORE: &str = "checkpoint-before.safetensors";
const OPTIONS: &str = "options.json";

/// How a run begins and may end.
pub struct Control<'a> {
    /// Go on from the folder's checkpoint, if there is one.
    pub resume: bool,
    /// Asked after each step with the number of steps of all branches; `true` ends the run with a checkpoint.
    pub stop: &'a dyn Fn(usize) -> bool,
}

/// Trains a scene from its labels.
///
/// # Errors
/// [`TrainError`].
pub fn train(
    labels: &Labels,
    options: &RunOptions,
    folder: &Path,
    control: &Control<'_>,
    device: &Device,
) -> Result<Trained, TrainError> {
    let folder_error = |source| TrainError::Folder {
        folder: folder.to_owned(),
        source,
    };
    std::fs::create_dir_all(folder).map_err(folder_error)?;
    let targets = labels.targets();
    let scale = SceneScale::of(labels.map.points.iter().map(|p| p.point_in_world));
    let held = held_range(labels.map.views.len(), options.hold_out_every);
    let mut sessions = sessions(labels, &targets, options, &held, &scale, device)?;
    let fresh = sessions.clone();
    let checkpoint_path = folder.join(CHECKPOINT);
    let identity = Identity::new(options, labels);
    let options_text =
        serde_json::to_string_pretty(&identity).map_err(|e| folder_error(e.into()))?;
    let options_path = folder.join(OPTIONS);
    let mut log = String::from(
        "branch,step,total,scene_m,reprojection_px,reliability,gradient,rate,seconds,held_out_m\n",
    );
    let mut seconds_before = 0.0;
    if control.resume && checkpoint_path.exists() {
        let found = std::fs::read_to_string(&options_path).map_err(folder_error)?;
        // Folders of earlier versions did not note their labels, so nobody can say that they belong here.
        let what = match serde_json::from_str::<Identity>(&found) {
            Ok(found) => found.difference(&identity),
            Err(_) => Some("another version of this tool"),
        };
        if let Some(what) = what {
            return Err(TrainError::OtherRun {
                folder: folder.to_owned(),
                what,
            });
        }
        seconds_before = checkpoint::read(&checkpoint_path, &mut sessions).map_err(|what| {
            TrainError::Checkpoint {
                path: checkpoint_path.clone(),
                what,
            }
        })?;
        log = std::fs::read_to_string(folder.join("log.csv")).unwrap_or(log);
    } else {
        if checkpoint_path.exists() {
            // Not asked to go on: what is there stays at hand, for hours may be in it.
            std::fs::rename(&checkpoint_path, folder.join(CHECKPOINT_BEFORE))
                .map_err(folder_error)?;
        }
        files::write_bytes(&options_path, options_text.as_bytes()).map_err(folder_error)?;
    }
    let started = Instant::now();
    let mut saved = started;
    let seconds = || seconds_before + started.elapsed().as_secs_f64();
    let mut held_out = Vec::new();
    for index in 0..sessions.len() {
        let kind = sessions[index].config.kind();
        let buffer = Buffer::new(
            kind,
            &labels.map,
            taught(labels, &targets, &held, sessions[index].recipe.variants),
            &scale,
        );
        let at_start = judge(&fresh[index], labels, &targets, &held);
        if sessions[index].step == 0 {
            set_length(&mut sessions, index, options, &buffer);
            if let Some(h) = &at_start {
                sessions[index].judged(h.score, buffer.num_images());
                // Writing to a string cannot fail.
                let _ = writeln!(log, "{},0,,,,,,,{:.1},{}", name(kind), seconds(), h.score);
            }
        }
        let steps = sessions[index].recipe.steps;
        let judge_every = steps.div_ceil(JUDGEMENTS).max(1);
        let bar = progress(name(kind), steps, sessions[index].step);
        let mut mean = StepReport::default();
        while sessions[index].step < sessions[index].end() {
            let session = &mut sessions[index];
            let report = session.train_step(&buffer);
            if !report.total.is_finite() {
                return Err(TrainError::Diverged {
                    kind: name(kind),
                    step: session.step,
                    loss: report.total,
                    rate: report.rate,
                });
            }
            mean = smoothed(&mean, &report, session.step);
            bar.inc(1);
            let step = session.step;
            let is_last = step == session.end();
            let mut held_out_m = None;
            if (step.is_multiple_of(judge_every) || is_last)
                && let Some(h) = judge(session, labels, &targets, &held)
            {
                session.judged(h.score, buffer.num_images());
                held_out_m = Some(h.score);
                bar.set_length(session.end() as u64);
            }
            bar.set_message(message(&mean, session, labels));
            if step.is_multiple_of(10) || is_last || held_out_m.is_some() {
                let _ = writeln!(
                    log,
                    "{},{step},{},{},{},{},{},{},{:.1},{}",
                    name(kind),
                    report.total,
                    report.scene,
                    report.reprojection_px,
                    report.reliability,
                    report.gradient,
                    report.rate,
                    seconds(),
                    held_out_m.map_or(String::new(), |m| m.to_string())
                );
            }
            let steps_of_all: usize = sessions.iter().map(|s| s.step).sum();
            let is_stopped = (control.stop)(steps_of_all);
            if saved.elapsed() >= CHECKPOINT_EVERY || is_last || is_stopped {
                files::write_bytes(&folder.join("log.csv"), log.as_bytes())
                    .map_err(folder_error)?;
                let curves =
                    curves::plot(&log, &Ruler::of(labels.map.units)).map_err(folder_error)?;
                files::write_bytes(&folder.join("curves.svg"), curves.as_bytes())
                    .map_err(folder_error)?;
                checkpoint::write(&checkpoint_path, &sessions, seconds()).map_err(folder_error)?;
                saved = Instant::now();
            }
            if is_stopped {
                return Err(TrainError::Stopped {
                    folder: folder.to_owned(),
                    step: steps_of_all,
                });
            }
        }
        bar.finish();
        if let (Some(start), Some(best)) = (at_start, sessions[index].best.clone()) {
            let best_session = sessions[index].with_averages(&best.values);
            let delivered = judge(&best_session, labels, &targets, &held);
            held_out.push(Judged {
                kind,
                start,
                delivered: delivered.unwrap_or_default(),
                step: best.step,
            });
        }
    }
    let mut tensors = Vec::new();
    for session in &sessions {
        let values = session.result();
        tensors.extend(session.parameters().specs().cloned().zip(values));
    }
    Ok(Trained {
        config: whole(&sessions),
        scale,
        tensors,
        held,
        held_out,
        seconds: seconds(),
        steps: sessions.iter().map(|s| (s.config.kind(), s.step)).collect(),
    })
}

/// The pictures that are not held out, with their variants if there are and if they are wanted.
fn taught<'a>(
    labels: &'a Labels,
    targets: &'a Targets,
    held: &Range<usize>,
    variants: bool,
) -> impl Iterator<Item = Labelled<'a>> {
    let held = held.clone();
    let copies = labels.changed_copies(targets).filter(move |_| variants);
    labels
        .pictures(targets)
        .enumerate()
        .chain(copies)
        .filter(move |(i, _)| !held.contains(i))
        .map(|(_, labelled)| labelled)
}

fn message(mean: &StepReport, session: &Session, labels: &Labels) -> String {
    let ruler = Ruler::of(labels.map.units);
    let held_out = session.best.as_ref().map_or(String::new(), |best| {
        format!("  best held-out pose {}", ruler.text(best.score))
    });
    format!(
        "{}  {:.1} px  reliability {:.3}{held_out}",
        ruler.text(mean.scene),
        mean.reprojection_px,
        mean.reliability
    )
}

fn sessions(
    labels: &Labels,
    targets: &Targets,
    options: &RunOptions,
    held: &Range<usize>,
    scale: &SceneScale,
    device: &Device,
) -> Result<Vec<Session>, TrainError> {
    let mut network = RegressorConfig::preset(options.preset, labels.map.descriptor_channels());
    for change in &options.network {
        network = changed_network(&network, change).map_err(TrainError::Network)?;
    }
    let RegressorConfig::Branches { point, line } = network else {
        unreachable!("all presets have two branches");
    };
    let mut point = BranchConfig::Point(point);
    if let (Some((num_anchors, _)), Some(anchors)) = (point.choice(), options.anchors) {
        *num_anchors = anchors;
    }
    let mut branches = vec![point];
    let of_views = targets.views.iter();
    let labelled_segments: usize = of_views
        .clone()
        .map(|t| t.segments.iter().flatten().count())
        .sum();
    if options.lines && labelled_segments >= MIN_LABELLED {
        branches.extend(line.map(BranchConfig::Line));
    }
    let labelled: usize = of_views
        .clone()
        .map(|t| t.points.iter().flatten().count())
        .sum();
    if labelled < MIN_LABELLED {
        return Err(TrainError::TooFewLabels {
            kind: name(Kind::Points),
            features: of_views.map(|t| t.points.len()).sum(),
            labelled,
            needed: MIN_LABELLED,
        });
    }
    Ok(branches
        .into_iter()
        .map(|config| {
            let mut recipe = recipe::recipe(options.preset, config.kind());
            if let Some(steps) = options.steps {
                recipe.steps = steps;
            }
            for change in &options.overrides {
                apply(&mut recipe, change);
            }
            Session::new(
                config,
                recipe,
                &labels.map,
                held,
                *scale,
                options.seed,
                device,
            )
        })
        .collect())
}

/// `field=value` on a recipe; the command line has checked both by [`check_override`].
fn apply(recipe: &mut Recipe, change: &str) {
    if let Some(changed) = overridden(recipe, change) {
        *recipe = changed;
    }
}

fn overridden(recipe: &Recipe, change: &str) -> Option<Recipe> {
    let (field, value) = change.split_once('=')?;
    let mut json = serde_json::to_value(recipe).ok()?;
    *json.get_mut(field)? = value_of(value);
    serde_json::from_value(json).ok()
}

/// JSON, or else the text itself.
fn value_of(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|_| text.into())
}

/// A network with `point.field=value` or `line.field=value` changed.
///
/// # Errors
/// A sentence for the user.
pub fn changed_network(network: &RegressorConfig, change: &str) -> Result<RegressorConfig, String> {
    let mut json = serde_json::to_value(network).map_err(|e| e.to_string())?;
    let refused = |why: String| {
        format!(
            "`{change}` does not change the network ({why}); give point.FIELD=VALUE or line.FIELD=VALUE"
        )
    };
    let (path, value) = change
        .split_once('=')
        .ok_or_else(|| refused("no `=`".to_owned()))?;
    let slot = json
        .pointer_mut(&format!("/{}", path.replace('.', "/")))
        .ok_or_else(|| refused(format!("no field `{path}`")))?;
    *slot = value_of(value);
    let changed: RegressorConfig =
        serde_json::from_value(json).map_err(|e| refused(e.to_string()))?;
    changed.validate().map_err(|e| refused(e.to_string()))?;
    Ok(changed)
}

/// Whether a recipe has such a field and takes such a value.
///
/// # Errors
/// A sentence for the user.
pub fn check_override(change: &str) -> Result<(), String> {
    let any = recipe::recipe(Preset::Compact, Kind::Points);
    overridden(&any, change).map(drop).ok_or_else(|| {
        format!(
            "`{change}` does not change a recipe; give FIELD=VALUE with a field of {}",
            serde_json::to_string(&any).unwrap_or_default()
        )
    })
}

/// Sets the number of steps from `--minutes`, by timing a few steps of a copy.
fn set_length(sessions: &mut [Session], index: usize, options: &RunOptions, buffer: &Buffer<'_>) {
    let Some(minutes) = options.minutes else {
        return;
    };
    let branches = sessions.len() as f64;
    // Lines learn from fewer rows and need less: a quarter of the time.
    let share = match sessions[index].config.kind() {
        _ if branches < 2.0 => 1.0,
        Kind::Points => 0.75,
        Kind::Segments => 0.25,
    };
    let mut probe = sessions[index].clone();
    probe.train_step(buffer);
    let started = Instant::now();
    for _ in 0..4 {
        probe.train_step(buffer);
    }
    let per_step = started.elapsed().as_secs_f64() / 4.0;
    let steps = (minutes * 60.0 * share / per_step.max(1e-6)) as usize;
    sessions[index].recipe.steps = steps.max(20);
}

fn progress(what: &'static str, steps: usize, done: usize) -> ProgressBar {
    let bar =
        ProgressBar::with_draw_target(Some(steps as u64), ProgressDrawTarget::stderr_with_hz(4));
    if let Ok(style) = ProgressStyle::with_template(
        "{prefix:9} {wide_bar} {pos}/{len}  {elapsed} (left {eta})  {msg}",
    ) {
        bar.set_style(style);
    }
    bar.set_prefix(what);
    bar.set_position(done as u64);
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

fn smoothed(mean: &StepReport, new: &StepReport, step: usize) -> StepReport {
    let k = if step <= 1 { 1.0 } else { 0.05 };
    let mix = |a: f64, b: f64| a + k * (b - a);
    StepReport {
        total: mix(mean.total, new.total),
        scene: mix(mean.scene, new.scene),
        reprojection_px: mix(mean.reprojection_px, new.reprojection_px),
        reliability: mix(mean.reliability, new.reliability),
        ..*new
    }
}

/// The configuration of all branches together.
fn whole(sessions: &[Session]) -> RegressorConfig {
    let mut point = None;
    let mut line = None;
    for session in sessions {
        match &session.config {
            BranchConfig::Point(c) => point = Some(c.clone()),
            BranchConfig::Line(c) => line = Some(c.clone()),
        }
    }
    let Some(point) = point else {
        unreachable!("a run always has a point branch");
    };
    RegressorConfig::Branches { point, line }
}
