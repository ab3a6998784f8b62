//! What a branch is worth on pictures that it was not taught: the poses that the solver makes of its predictions.

use super::buffer::{Buffer, Kind};
use super::session::{Predicted, Session};
use crate::eval::{PoseError, pose_error};
use crate::labels::{Labelled, Labels, Targets};
use landline::math::order::Best;
use landline::math::stats::median_in_place;
use landline::pose::{LineCorrespondence, PointCorrespondence};
use landline::relocalizer::LiveOptions;
use landline::scene_file::HeldOut;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::ops::Range;

/// What a branch is worth on pictures that were kept back.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Judgement {
    /// Poses of this branch alone.
    pub poses: HeldOut,
    /// Features with a target: median distance to it, world units.
    pub median_scene: f64,
    /// Of the features that the solver gets: share that reprojects within 6 px.
    pub share_within_6px: f64,
    /// Of the same: median reprojection error in pixels.
    pub median_px: f64,
    /// Mean position error, those beyond a tenth of the scene's scale counting as that: what training is judged by.
    pub score: f64,
}

/// Judges the averaged parameters of a branch on held-out pictures; `None` without any.
pub fn judge(
    session: &Session,
    labels: &Labels,
    targets: &Targets,
    held: &Range<usize>,
) -> Option<Judgement> {
    let images: Vec<Labelled<'_>> = labels
        .pictures(targets)
        .skip(held.start)
        .take(held.len())
        .filter(|i| i.view.cam_from_world.is_some())
        .collect();
    if images.is_empty() {
        return None;
    }
    let kind = session.config.kind();
    let buffer = Buffer::new(kind, &labels.map, images.iter().copied(), &session.scale);
    let predictions: Vec<Predicted> = (0..images.len())
        .map(|i| session.predict(&buffer, i))
        .collect();
    let (mut distances, mut errors) = (Vec::new(), Vec::new());
    let mut chosen = Vec::with_capacity(images.len());
    for (i, p) in predictions.iter().enumerate() {
        let best = chosen_rows(kind, p);
        errors.extend(best.iter().map(|k| f64::from(p.reprojection_px[*k])));
        chosen.push(best);
        distances.extend(
            buffer
                .image_rows(i)
                .zip(&p.scene)
                .filter(|(row, _)| buffer.track(*row).is_some())
                .map(|(_, d)| f64::from(*d)),
        );
    }
    let poses: Vec<Option<PoseError>> = images
        .par_iter()
        .zip(predictions.par_iter().zip(&chosen))
        .map(|(image, (p, best))| solve(labels, kind, image, p, best, &session.scale.centre))
        .collect();
    let far = 0.1 * session.scale.scale;
    let position = |e: &Option<PoseError>| e.map_or(f64::INFINITY, |e| e.position);
    let median = |mut values: Vec<f64>| median_in_place(&mut values).unwrap_or(0.0);
    let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
    let pairs: Vec<_> = poses
        .iter()
        .map(|e| e.map(|e| (e.position, e.rotation_deg)))
        .collect();
    Some(Judgement {
        poses: HeldOut::of(&pairs, labels.map.units),
        share_within_6px: share(errors.iter().filter(|e| **e <= 6.0).count(), errors.len()),
        median_scene: median(distances),
        median_px: median(errors),
        score: poses.iter().map(|e| position(e).min(far)).sum::<f64>() / poses.len() as f64,
    })
}

/// The features that the relocalizer would pass to the solver.
fn chosen_rows(kind: Kind, p: &Predicted) -> Vec<usize> {
    let options = LiveOptions::default();
    let most = match kind {
        Kind::Points => options.max_points,
        Kind::Segments => options.max_lines,
    };
    let mut best = Best::default();
    let confidences = (0..).zip(p.confidence.iter().copied());
    best.choose(most, confidences.clone());
    let kept = confidences.filter(|(k, c)| best.keeps(*k, *c));
    kept.map(|(k, _)| k as usize).collect()
}

fn solve(
    labels: &Labels,
    kind: Kind,
    image: &Labelled<'_>,
    p: &Predicted,
    chosen: &[usize],
    centre: &Vector3<f64>,
) -> Option<PoseError> {
    let world = |at: usize| {
        let c = &p.coordinates[at..at + 3];
        centre + Vector3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2]))
    };
    let points = |k: &usize| PointCorrespondence {
        pixel: image.features.keypoints[*k].pixel,
        point_in_world: world(3 * k),
        confidence: p.confidence[*k],
        sigma_m: 0.0,
        sigma_px: 0.0,
    };
    let lines = |k: &usize| LineCorrespondence {
        start: image.features.segments[*k].start,
        end: image.features.segments[*k].end,
        start_in_world: world(6 * k),
        end_in_world: world(6 * k + 3),
        confidence: p.confidence[*k],
        sigma_m: 0.0,
        sigma_px: 0.0,
    };
    let (points, lines): (Vec<_>, Vec<_>) = match kind {
        Kind::Points => (chosen.iter().map(points).collect(), Vec::new()),
        Kind::Segments => (Vec::new(), chosen.iter().map(lines).collect()),
    };
    pose_error(labels, image.view, &points, &lines)
}
