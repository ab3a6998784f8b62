//! From labels to a scene file.

use super::{Event, Observer, TeachError};
use crate::eval::{held_out, held_range};
use crate::labels::Labels;
#[cfg(feature = "train")]
use crate::train::run::{Control, RunOptions, train};
#[cfg(feature = "train")]
use landline::mapping::Networks;
use landline::mapping::{self, SceneError, SceneRequest, landmark_networks, scene_of};
#[cfg(feature = "train")]
use landline::nn::WeightTensor;
#[cfg(feature = "train")]
use landline::nn::Weights;
use landline::reconstruction::Reconstruction;
use landline::scene_file::{HeldOut, Precision, SceneFile};
use std::ops::Range;
#[cfg(feature = "train")]
use std::path::PathBuf;

/// When networks are trained.
#[cfg(feature = "train")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// When the landmarks alone do not locate the pictures that were kept back, or options of training are given.
    Auto,
    /// In any case.
    Always,
    /// In none.
    Never,
}

/// How networks are trained.
#[cfg(feature = "train")]
#[derive(Debug, Clone)]
pub struct Training {
    /// Whether they are.
    pub when: When,
    /// Sizes and recipe.
    pub options: RunOptions,
    /// Holds options, log, curves and checkpoint.
    pub folder: PathBuf,
    /// Go on from the folder's checkpoint.
    pub resume: bool,
    /// Changed copies of each picture to train on.
    pub variants: usize,
}

/// Share of the pictures kept back that the landmarks alone have to locate, and how well, as a share of the scene's scale, for
/// training to be left out: what is looked at again from there ends where a trained network's would.
#[cfg(feature = "train")]
const ENOUGH_LOCATED: f64 = 0.95;
#[cfg(feature = "train")]
const ENOUGH_ACCURATE: f64 = 0.01;

/// How landmarks do on pictures that they do not know.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Their accuracy.
    pub held_out: HeldOut,
    /// World length of one network unit.
    pub scale: f64,
}

/// A scene whose networks are the map's landmarks, all of them, without the table that is looked at again.
///
/// # Errors
/// [`TeachError::Scene`] without any landmark.
pub fn scene_of_landmarks(
    labels: &Labels,
    request: &SceneRequest,
    measured: Option<Measured>,
) -> Result<SceneFile, TeachError> {
    let mut scene = scene_of(
        landmark_networks(&labels.map, request, &(0..0)).map_err(SceneError::from)?,
        &labels.map,
        &labels.origin,
        request,
    );
    scene.info.training.get_or_insert_default().held_out = measured.map(|m| m.held_out);
    Ok(scene)
}

/// Measures networks that are landmarks on a stretch of pictures that is left out of them; `None` when none is to be.
///
/// # Errors
/// [`TeachError::Scene`] without any landmark.
pub fn measure_landmarks(
    labels: &Labels,
    request: &SceneRequest,
    observer: &mut dyn Observer,
) -> Result<Option<Measured>, TeachError> {
    let held = held_range(labels.map.views.len(), request.hold_out_every);
    if held.is_empty() {
        return Ok(None);
    }
    let networks = landmark_networks(&labels.map, request, &held).map_err(SceneError::from)?;
    let mut scene = scene_of(networks, &labels.map, &labels.origin, request);
    let Some(held_out) = measure(&mut scene, labels, &held, request.precision)? else {
        return Ok(None);
    };
    observer.happened(&Event::Untrained {
        held_out: &held_out,
        units: labels.map.units,
    });
    Ok(Some(Measured {
        held_out,
        scale: scene.info.scale.scale,
    }))
}

/// Notes the held-out accuracy of a scene, of its weights as they are stored, on the pictures that were kept back. It is that
/// of the networks alone: landmarks are of all pictures.
fn measure(
    scene: &mut SceneFile,
    labels: &Labels,
    held: &Range<usize>,
    precision: Precision,
) -> Result<Option<HeldOut>, TeachError> {
    let views = labels.map.views.get(held.clone());
    let Some(views) = views.filter(|v| !v.is_empty()) else {
        return Ok(None);
    };
    let stored = SceneFile::from_bytes(&scene.to_bytes(precision)?)?;
    let accuracy = held_out(&stored, labels, views)?;
    scene.info.training.get_or_insert_default().held_out = Some(accuracy);
    Ok(Some(accuracy))
}

/// [`mapping::add_landmarks`], told.
///
/// # Errors
/// [`TeachError::Scene`] when the map has none, or the size is too small.
pub fn add_landmarks(
    scene: &mut SceneFile,
    map: &Reconstruction,
    max_bytes: Option<usize>,
    precision: Precision,
    observer: &mut dyn Observer,
) -> Result<(), TeachError> {
    mapping::add_landmarks(scene, map, max_bytes, precision)?;
    if let Some(table) = &scene.landmarks {
        observer.happened(&Event::Landmarks(table));
    }
    Ok(())
}

#[cfg(feature = "train")]
impl Training {
    /// Whether training runs, given how the landmarks do without.
    pub fn is_needed(&self, measured: Option<Measured>) -> bool {
        match self.when {
            When::Always => true,
            When::Never => false,
            // Where nothing is kept back, nothing says that training helps.
            When::Auto => measured.is_some_and(|m| !m.is_enough()),
        }
    }
}

#[cfg(feature = "train")]
impl Measured {
    fn is_enough(&self) -> bool {
        let all = self.held_out.num_images as f64;
        let located = all - self.held_out.num_not_located as f64;
        let accurate = self
            .held_out
            .median_position
            .is_some_and(|m| m <= ENOUGH_ACCURATE * self.scale);
        located >= ENOUGH_LOCATED * all && accurate
    }
}

/// A scene of trained networks, without landmarks.
///
/// # Errors
/// When there is too little to learn from, the run folder belongs to another run, or the disk refuses.
#[cfg(feature = "train")]
pub fn trained_scene(
    labels: &Labels,
    request: &SceneRequest,
    training: &Training,
    observer: &mut dyn Observer,
) -> Result<SceneFile, TeachError> {
    let control = Control {
        resume: training.resume,
        stop: &|_| false,
    };
    let device = crate::train::cpu_device();
    let trained = train(
        labels,
        &training.options,
        &training.folder,
        &control,
        &device,
    )?;
    observer.happened(&Event::Trained {
        trained: &trained,
        units: labels.map.units,
    });
    let mut weights = Weights::new();
    for (spec, values) in &trained.tensors {
        weights.insert(
            spec.name.clone(),
            WeightTensor::f32(&spec.shape, values.clone())?,
        );
    }
    let networks = Networks {
        preset: training.options.preset,
        config: trained.config.clone(),
        scale: trained.scale,
        weights,
        num_images: labels.map.views.len() - trained.held.len(),
        num_steps: trained.steps.iter().map(|(_, s)| *s as u64).sum(),
        seconds: trained.seconds,
    };
    let mut scene = scene_of(networks, &labels.map, &labels.origin, request);
    measure(&mut scene, labels, &trained.held, request.precision)?;
    Ok(scene)
}
