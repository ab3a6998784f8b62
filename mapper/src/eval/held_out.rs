//! Accuracy of a scene on pictures of labels that it was not taught: the networks of the scene file on the features of the
//! labels, the solver of the relocalizer on what they predict.

use super::{PoseError, solver_options};
use crate::labels::Labels;
use landline::math::order::Best;
use landline::pose::{self, LineCorrespondence, PointCorrespondence, PoseScratch};
use landline::reconstruction::View;
use landline::regress::{Predictions, RegressError, Regressor};
use landline::relocalizer::{LiveOptions, correspondences};
use landline::scene_file::{HeldOut, SceneFile};
use std::ops::Range;

/// How far from a view's own pose the solver ends with correspondences in the view's pixels, as the relocalizer would call
/// it; `None` without a pose.
pub fn pose_error(
    labels: &Labels,
    view: &View,
    points: &[PointCorrespondence],
    lines: &[LineCorrespondence],
) -> Option<PoseError> {
    let camera = &view.camera;
    let max_side = labels.origin.working_max_side as usize;
    let options = LiveOptions::default().pose;
    let solver = solver_options(&options, max_side, camera.width, camera.height);
    let mut scratch = PoseScratch::new();
    let mut clock = || 0.0;
    // A picture that the solver refuses has no pose.
    let outcome = pose::estimate(points, lines, camera, &solver, &mut scratch, &mut clock).ok()?;
    let located = outcome.located()?;
    Some(PoseError::between(
        &located.cam_from_world,
        &view.cam_from_world?,
    ))
}

/// Accuracy of a scene on some views of labels, all of them posed.
///
/// # Errors
/// [`RegressError`] when the features are not those that the scene's networks take.
pub fn held_out(
    scene: &SceneFile,
    labels: &Labels,
    views: &[View],
) -> Result<HeldOut, RegressError> {
    let options = LiveOptions::default();
    let most = |count: fn(&View) -> usize| views.iter().map(count).max().unwrap_or(0).max(1);
    let mut regressor = Regressor::new(
        &scene.config,
        scene.weights.clone(),
        scene.info.scale,
        most(|v| v.features.keypoints.len()),
        most(|v| v.features.segments.len()),
    )?;
    let mut predictions = Predictions::default();
    let (mut best, mut points, mut lines) = (Best::default(), Vec::new(), Vec::new());
    let mut errors = Vec::with_capacity(views.len());
    for view in views {
        regressor.run(&view.features, &mut predictions)?;
        correspondences(
            &view.features,
            &predictions,
            &options,
            &mut best,
            &mut points,
            &mut lines,
        );
        let error = pose_error(labels, view, &points, &lines);
        errors.push(error.map(|e| (e.position, e.rotation_deg)));
    }
    Ok(HeldOut::of(&errors, scene.info.units))
}

/// The pictures that are kept back: one stretch in the middle, so that they are no neighbours of taught ones. One in `every`
/// pictures; 0 keeps none.
pub fn held_range(num_images: usize, every: usize) -> Range<usize> {
    let len = num_images.checked_div(every).unwrap_or(0);
    let start = (num_images - len) / 2;
    start..start + len
}

#[cfg(test)]
mod tests {
    use super::held_range;

    #[test]
    fn one_stretch_in_the_middle() {
        assert_eq!(held_range(800, 20), 380..420);
        assert_eq!(held_range(10, 20), 5..5);
        assert_eq!(held_range(10, 0), 5..5);
        assert_eq!(held_range(3, 1), 0..3);
    }
}
