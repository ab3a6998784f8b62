//! Tracks from a model or a line map that came with the data set, in place of own triangulation.
//!
//! A model's points were seen at another detector's keypoints, so a keypoint takes the point whose observation in that
//! picture lies nearest, within [`MAX_DISTANCE_PX`]. Lines of a map are those of the very segments that were read with it.

use crate::dataset::{ModelLine, ModelPoint};
use landline::reconstruction::{
    LineTrack, Observation, PointParams, PointTrack, PosedView, describe_lines, describe_points,
    planar_from_pixel,
};
use nalgebra::Vector2;
use rayon::prelude::*;

/// A keypoint farther than this from an observation shows something else. Detectors agree on a corner to about a pixel.
pub const MAX_DISTANCE_PX: f64 = 2.0;

/// Point tracks; observations of `points` are of `views`.
pub fn point_tracks_from_model(
    views: &[PosedView<'_>],
    points: &[ModelPoint],
    params: &PointParams,
) -> Vec<PointTrack> {
    let mut seen: Vec<Vec<(Vector2<f64>, u32)>> = vec![Vec::new(); views.len()];
    for (id, point) in points.iter().enumerate() {
        for (view, pixel) in &point.observations {
            if let (Some(view), Some(list)) = (views.get(*view), seen.get_mut(*view)) {
                list.push((planar_from_pixel(&view.camera, *pixel), id as u32));
            }
        }
    }
    let assigned: Vec<Vec<(u32, u32)>> = views
        .par_iter()
        .zip(&seen)
        .map(|(view, seen)| nearest(view, seen, points, params.max_error_px))
        .collect();
    let mut tracks: Vec<PointTrack> = points
        .iter()
        .map(|p| PointTrack::new(p.point_in_world, Vec::new()))
        .collect();
    for (view, list) in assigned.iter().enumerate() {
        for (keypoint, id) in list {
            if let Some(track) = tracks.get_mut(*id as usize) {
                track
                    .observations
                    .push(Observation::new(view, *keypoint as usize));
            }
        }
    }
    tracks.retain(|t| t.observations.len() >= 2);
    describe_points(views, &mut tracks);
    tracks
}

/// Pairs of keypoint and point, each at most once, nearest first.
fn nearest(
    view: &PosedView<'_>,
    seen: &[(Vector2<f64>, u32)],
    points: &[ModelPoint],
    max_error_px: f64,
) -> Vec<(u32, u32)> {
    let limit = MAX_DISTANCE_PX / view.focal_px;
    let mut by_x: Vec<(f64, u32)> = view
        .planar
        .iter()
        .zip(0..)
        .filter(|(p, _)| p.x.is_finite() && p.y.is_finite())
        .map(|(p, k)| (p.x, k))
        .collect();
    by_x.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut candidates: Vec<(f64, u32, u32)> = Vec::new();
    for (place, id) in seen {
        let from = by_x.partition_point(|(x, _)| *x < place.x - limit);
        for (_, keypoint) in by_x[from..]
            .iter()
            .take_while(|(x, _)| *x <= place.x + limit)
        {
            let Some(own) = view.planar.get(*keypoint as usize) else {
                continue;
            };
            let distance = (own - place).norm();
            let fits = points.get(*id as usize).is_some_and(|p| {
                view.error_px(*keypoint as usize, &p.point_in_world) <= max_error_px
            });
            if distance <= limit && fits {
                candidates.push((distance, *keypoint, *id));
            }
        }
    }
    candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut is_taken = vec![false; view.planar.len()];
    let mut used: std::collections::HashSet<u32> = std::collections::HashSet::new();
    let mut pairs = Vec::new();
    for (_, keypoint, id) in candidates {
        let Some(taken) = is_taken.get_mut(keypoint as usize) else {
            continue;
        };
        if !*taken && used.insert(id) {
            *taken = true;
            pairs.push((keypoint, id));
        }
    }
    pairs
}

/// Line tracks; observations of `lines` are of `views` and of their segments. A segment keeps the first line that claims it.
pub fn line_tracks_from_map(views: &[PosedView<'_>], lines: &[ModelLine]) -> Vec<LineTrack> {
    let mut is_taken: Vec<Vec<bool>> = views
        .iter()
        .map(|v| vec![false; v.segment_ends.len()])
        .collect();
    let mut tracks: Vec<LineTrack> = lines
        .iter()
        .filter_map(|line| {
            let mut observations: Vec<Observation> = line
                .observations
                .iter()
                .filter_map(|(view, segment)| {
                    let taken = is_taken.get_mut(*view)?.get_mut(*segment)?;
                    let is_new = !std::mem::replace(taken, true);
                    is_new.then(|| Observation::new(*view, *segment))
                })
                .collect();
            observations.sort_unstable();
            (!observations.is_empty())
                .then(|| LineTrack::new([line.start_in_world, line.end_in_world], observations))
        })
        .collect();
    describe_lines(views, &mut tracks);
    tracks
}
