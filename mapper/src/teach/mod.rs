//! From pictures with poses to a scene, as a library: no command line, nothing printed.
//!
//! * **In**: an opened data set, an extractor, and what the scene is to hold ([`Request`]).
//! * **Out**: a [`Teaching`]: the labels and the scene; an [`Observer`] is told what happens meanwhile.
//! * **Method**: features, tracks ([`crate::labels`]); the networks begin as the map's landmarks, which is a scene already
//!   ([`landline::models::landmarks`]); they are trained where the pictures that were kept back show that they need it
//!   ([`When`]); last comes the table of landmarks that is looked at again.
//! * **Invariants**: the same input gives the same scene, whatever the number of threads.
//! * **Cost**: features and matching; training, where it runs, takes longer than all else.

mod observer;
mod scene;
mod turned;

pub use landline::mapping::SceneRequest;
pub use observer::{Event, Observer};
pub use scene::{Measured, add_landmarks, measure_landmarks, scene_of_landmarks};
#[cfg(feature = "train")]
pub use scene::{Training, When, trained_scene};
pub use turned::Turned;

use crate::dataset::{Dataset, DatasetImage, Split};
use crate::extract::{ExtractError, Extraction};
use crate::labels::{Imported, LabelError, Labels, Origin, add_variants, build_from};
use crate::working::{self, Shrink};
use landline::mapping::{SceneError, TrackError, TrackParams, TrackStats};
use landline::reconstruction::{Misreading, View, vertical};
use landline::regress::RegressError;
use landline::scene_file::{SceneFile, SceneFileError};
use std::time::Instant;

/// Why a place could not be taught.
#[derive(Debug, thiserror::Error)]
pub enum TeachError {
    /// Features cannot be made.
    #[error(transparent)]
    Extract(#[from] ExtractError),
    /// Nothing to see in the pictures.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// The map makes no scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The scene cannot be written as a file.
    #[error(transparent)]
    File(#[from] SceneFileError),
    /// The networks do not run on the labels' features.
    #[error("measuring the held-out accuracy: {0}")]
    Measure(#[from] RegressError),
    /// Training failed.
    #[cfg(feature = "train")]
    #[error("training: {0}")]
    Train(#[from] crate::train::run::TrainError),
    /// A trained tensor is not finite.
    #[cfg(feature = "train")]
    #[error(transparent)]
    Tensor(#[from] landline::nn::NnError),
}

/// What is to be taught.
pub struct Request<'a> {
    /// Pictures; those to train on need poses.
    pub dataset: &'a Dataset,
    /// Makes features of them.
    pub extraction: &'a Extraction,
    /// Points of the data set's own model in place of triangulated ones.
    pub model_points: bool,
    /// What the scene holds and says.
    pub scene: SceneRequest,
    /// How, and when, its networks are trained; `None` never does.
    #[cfg(feature = "train")]
    pub training: Option<Training>,
}

/// A place that was taught.
#[derive(Debug)]
pub struct Teaching {
    /// Of the training pictures.
    pub labels: Labels,
    /// What locates in the place.
    pub scene: SceneFile,
}

/// Teaches a place.
///
/// # Errors
/// [`TeachError`].
pub fn teach(request: &Request<'_>, observer: &mut dyn Observer) -> Result<Teaching, TeachError> {
    let Request {
        dataset,
        extraction,
        model_points,
        ..
    } = *request;
    #[cfg_attr(
        not(feature = "train"),
        expect(unused_mut, reason = "variants are trained on")
    )]
    let (mut made, _) = labels(dataset, extraction, model_points, observer)?;
    let asked = &request.scene;
    let measured = measure_landmarks(&made, asked, observer)?;
    #[cfg(feature = "train")]
    let training = request
        .training
        .as_ref()
        .filter(|training| training.is_needed(measured));
    #[cfg(feature = "train")]
    let mut scene = match training {
        Some(training) => {
            let count = training.variants;
            variants(dataset, extraction, &mut made, count, observer)?;
            trained_scene(&made, asked, training, observer)?
        }
        None => scene_of_landmarks(&made, asked, measured)?,
    };
    #[cfg(not(feature = "train"))]
    let mut scene = scene_of_landmarks(&made, asked, measured)?;
    let (max_bytes, precision) = (asked.max_bytes, asked.precision);
    add_landmarks(&mut scene, &made.map, max_bytes, precision, observer)?;
    Ok(Teaching {
        labels: made,
        scene,
    })
}

/// Labels of a data set's training pictures.
///
/// # Errors
/// When features cannot be made or nothing can be triangulated.
pub fn labels(
    dataset: &Dataset,
    extraction: &Extraction,
    model_points: bool,
    observer: &mut dyn Observer,
) -> Result<(Labels, TrackStats), TeachError> {
    let positions = dataset.of_split(Split::Train);
    let chosen: Vec<&DatasetImage> = positions.iter().map(|i| &dataset.images[*i]).collect();
    let num_posed = chosen.iter().filter(|i| i.cam_from_world.is_some()).count();
    if num_posed < 2 {
        // Before anything expensive happens.
        return Err(LabelError::from(TrackError::TooFewPictures(num_posed)).into());
    }
    let progress = observer.progress();
    let start = Instant::now();
    let mut features = match &dataset.segments {
        None => extraction.all(&chosen, progress)?,
        Some(segments) => {
            let own: Vec<&[[f64; 4]]> = positions.iter().map(|i| segments[*i].as_slice()).collect();
            extraction.all_with_segments(&chosen, &own, progress)?
        }
    };
    observer.happened(&Event::Features {
        pictures: chosen.len(),
        seconds: start.elapsed().as_secs_f64(),
    });
    let small = working::shrunk(dataset, extraction.options().max_side);
    for (features, image) in features.iter_mut().zip(&chosen) {
        Shrink::of(&image.camera, extraction.options().max_side).features(features);
    }
    let dataset = small.as_ref().unwrap_or(dataset);
    let mut chosen: Vec<&DatasetImage> = positions.iter().map(|i| &dataset.images[*i]).collect();
    let origin = Origin {
        source: format!("{num_posed} pictures, {}", dataset.format),
        ..Origin::of_extractor(extraction.extractor(), extraction.options().max_side as u32)
    };
    let imported = Imported::new(dataset, &positions, model_points)?;
    let start = Instant::now();
    let params = TrackParams {
        trust_poses: dataset.trust_poses,
        ..TrackParams::default()
    };
    let decided = turned::decide(dataset, &positions, &features, &params);
    if let Some(decided) = &decided {
        observer.happened(&Event::Turned(decided));
        chosen = decided.chosen(dataset, &positions);
    }
    let mut made = build_from(&chosen, features, origin, &imported, &params, progress)
        .map_err(|error| by_format(error, dataset))?;
    made.0.map.units = dataset.units;
    made.0.map.gravity = dataset.gravity;
    if dataset.is_up_asked {
        let posed: Vec<_> = made.0.map.views.iter().filter_map(View::posed).collect();
        let found = vertical(&posed);
        observer.happened(&Event::Up(&found));
        made.0.map.gravity = found.ok().map(|v| -v.up_in_world);
    }
    observer.happened(&Event::Labels {
        stats: &made.1,
        seconds: start.elapsed().as_secs_f64(),
    });
    Ok(made)
}

/// Axes by those that the format has of itself, from which the option that names them goes out.
fn by_format(mut error: LabelError, dataset: &Dataset) -> LabelError {
    if let LabelError::Tracks(TrackError::PoseConvention {
        misreading: Misreading::Axes { axes, .. },
        ..
    }) = &mut error
    {
        axes.ours_from_file *= dataset.camera_axes.ours_from_file;
    }
    error
}

/// Adds so many changed copies of each training picture to its labels.
///
/// # Errors
/// When features cannot be made.
pub fn variants(
    dataset: &Dataset,
    extraction: &Extraction,
    labels: &mut Labels,
    count: usize,
    observer: &mut dyn Observer,
) -> Result<(), TeachError> {
    if count == 0 {
        return Ok(());
    }
    let posed: Vec<&DatasetImage> = dataset
        .of_split(Split::Train)
        .into_iter()
        .map(|i| &dataset.images[i])
        .filter(|i| i.cam_from_world.is_some())
        .collect();
    let mut changed = extraction.all_variants(&posed, count, observer.progress())?;
    for (i, features) in &mut changed {
        Shrink::of(&posed[*i].camera, extraction.options().max_side).features(features);
    }
    let stats = add_variants(labels, changed);
    observer.happened(&Event::Variants(&stats));
    Ok(())
}
