//! Scenes that tell strangers less, at a cost in accuracy: parts of a file are left out or made coarser before it is written.
//!
//! In: a scene with everything. Out: the same scene with less; what was measured of its accuracy goes, for it is another scene.
//! `docs/guides/privacy.md` has what each choice costs and what is left.

use landline::models::{LineBranchConfig, PointBranchConfig, RegressorConfig};
use landline::nn::{NnError, WeightTensor, Weights};
use landline::scene_file::SceneFile;

/// What a scene holds back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Privacy {
    /// A quarter of the points and lines: those that cover the place best.
    Sparse,
    /// No lines: edges of walls and furniture are what people recognise first.
    NoLines,
    /// Descriptors of one bit a number in place of eight: less to compute a picture from.
    CoarseDescriptors,
    /// No landmarks to look at again, and with them no viewing directions: not where the camera went.
    NoSecondLook,
}

/// Of so many landmarks one stays.
const SPARSE: usize = 4;

/// Why a scene cannot hold something back.
#[derive(Debug, thiserror::Error)]
pub enum PrivacyError {
    /// The place is in weights that cannot be thinned out.
    #[error(
        "--privacy {what}: this scene's networks do not choose among landmarks (variant {variant}); make it from landmarks, or leave \
         --privacy out"
    )]
    Variant {
        /// The choice.
        what: &'static str,
        /// The scene's network.
        variant: &'static str,
    },
    /// A tensor that the configuration names is of another form.
    #[error(transparent)]
    Tensor(#[from] NnError),
}

/// Leaves out what the choices say.
///
/// # Errors
/// [`PrivacyError`] where the scene's networks have no landmarks.
pub fn hold_back(scene: &mut SceneFile, choices: &[Privacy]) -> Result<(), PrivacyError> {
    for choice in choices {
        match choice {
            Privacy::Sparse => thin_out(scene)?,
            Privacy::NoLines => remove_lines(scene)?,
            Privacy::CoarseDescriptors => coarsen(&mut scene.weights)?,
            Privacy::NoSecondLook => scene.landmarks = None,
        }
    }
    if let (false, Some(training)) = (choices.is_empty(), &mut scene.info.training) {
        training.held_out = None;
    }
    Ok(())
}

fn variant_error(scene: &SceneFile, what: &'static str) -> PrivacyError {
    PrivacyError::Variant {
        what,
        variant: scene.config.variant().name(),
    }
}

/// Landmarks stand in the order in which they were chosen to cover the pictures: the first ones cover the place.
fn thin_out(scene: &mut SceneFile) -> Result<(), PrivacyError> {
    let fewer = |n: usize| n.div_ceil(SPARSE);
    let RegressorConfig::Branches { point, line } = &mut scene.config else {
        return Err(variant_error(scene, "sparse"));
    };
    let PointBranchConfig::Anchored(point) = point else {
        return Err(variant_error(scene, "sparse"));
    };
    point.num_anchors = fewer(point.num_anchors);
    let mut kept = vec![
        ("point.anchor.keys", point.num_anchors),
        ("point.anchor.positions", point.num_anchors),
    ];
    if let Some(LineBranchConfig::Anchored(line)) = line {
        line.num_anchors = fewer(line.num_anchors);
        kept.push(("line.anchor.keys", line.num_anchors));
        kept.push(("line.anchor.segments", line.num_anchors));
    }
    for (name, rows) in kept {
        change(&mut scene.weights, name, |shape, numbers| {
            let len = numbers.len() / shape[0].max(1) * rows;
            shape[0] = rows;
            numbers.truncate(len);
        })?;
    }
    if let Some(table) = &mut scene.landmarks {
        let (points, lines) = (
            fewer(table.point_positions.len()),
            fewer(table.line_positions.len()),
        );
        table.point_positions.truncate(points);
        table.point_codes.truncate(points);
        table.point_views.truncate(points);
        table.point_clusters.truncate(points);
        table.line_positions.truncate(lines);
        table.line_codes.truncate(lines);
        table.line_views.truncate(lines);
    }
    Ok(())
}

fn remove_lines(scene: &mut SceneFile) -> Result<(), PrivacyError> {
    let RegressorConfig::Branches { line, .. } = &mut scene.config else {
        return Err(variant_error(scene, "no-lines"));
    };
    *line = None;
    let names = scene.weights.iter().map(|(name, _)| name.to_owned());
    let of_lines: Vec<String> = names.filter(|n| n.starts_with("line.")).collect();
    for name in of_lines {
        scene.weights.remove(&name);
    }
    if let Some(table) = &mut scene.landmarks {
        table.line_positions.clear();
        table.line_codes.clear();
        table.line_views.clear();
    }
    Ok(())
}

/// Signs in place of numbers, of the same length.
fn coarsen(weights: &mut Weights) -> Result<(), PrivacyError> {
    for name in ["point.anchor.keys", "line.anchor.keys"] {
        change(weights, name, |shape, numbers| {
            let one = 1.0 / (shape[1] as f32).sqrt();
            for v in numbers {
                *v = if *v < 0.0 { -one } else { one };
            }
        })?;
    }
    Ok(())
}

/// Changes shape and numbers of a matrix that is there.
fn change(
    weights: &mut Weights,
    name: &str,
    change: impl FnOnce(&mut Vec<usize>, &mut Vec<f32>),
) -> Result<(), PrivacyError> {
    if let Some(tensor) = weights.get(name) {
        let mut shape = tensor.shape().to_vec();
        let mut numbers = tensor.to_f32();
        change(&mut shape, &mut numbers);
        weights.insert(name.to_owned(), WeightTensor::f32(&shape, numbers)?);
    }
    Ok(())
}
