//! Tracks of one line become one track, and segments that no match found join the track they lie on.

use super::super::points::dot;
use super::super::track::{line_descriptor, unit_mean};
use super::super::{LineTrack, Observation, PosedView};
use super::LineParams;
use super::fit::settle;
use super::world_line::{WorldLine, covered, line_error_px, line_of, line_through, project};
use crate::math::order::sort_by_key;
use crate::math::parallel;
use nalgebra::Vector3;

/// Joins tracks that are the same line: nearly all observations of the shorter one fit the longer one, and they overlap
/// or nearly touch.
pub(super) fn merge(
    views: &[PosedView<'_>],
    mut tracks: Vec<LineTrack>,
    params: &LineParams,
) -> Vec<LineTrack> {
    sort_by_key(&mut tracks, |t| std::cmp::Reverse(t.observations.len()));
    let mut merged: Vec<LineTrack> = Vec::new();
    for track in tracks {
        let mut taken = false;
        for target in &mut merged {
            let Some(line) = line_of(target) else {
                continue;
            };
            let length = (target.end_in_world - target.start_in_world).norm();
            let at = |p: &Vector3<f64>| (p - line.point).dot(&line.direction);
            let (s, e) = (at(&track.start_in_world), at(&track.end_in_world));
            let own = (e - s).abs();
            let gap = s.min(e).max(0.0) - s.max(e).min(length);
            let across = |p: &Vector3<f64>| ((p - line.point) - line.direction * at(p)).norm();
            // A cheap look in space before all observations are tested.
            let near = 0.1 * (own + length);
            if gap > 0.1 * own.min(length)
                || across(&track.start_in_world) > near
                || across(&track.end_in_world) > near
            {
                continue;
            }
            let fits = track
                .observations
                .iter()
                .filter(|o| {
                    let view = &views[o.view as usize];
                    line_error_px(view, o.feature as usize, &line) <= params.max_error_px
                })
                .count();
            if fits * 10 < track.observations.len() * 7 {
                continue;
            }
            let mut all = target.observations.clone();
            all.extend(&track.observations);
            if let Some(joined) = settle(views, &all, params)
                && joined.observations.len() * 10 >= all.len() * 8
            {
                *target = joined;
                taken = true;
                break;
            }
        }
        if !taken {
            merged.push(track);
        }
    }
    merged
}

/// A 3D segment that a view may show: where it is, what it looks like, and from where it was seen.
#[derive(Debug, Clone)]
pub struct KnownLine {
    /// One end.
    pub start_in_world: Vector3<f64>,
    /// The other end.
    pub end_in_world: Vector3<f64>,
    /// Mean descriptor, of unit length.
    pub descriptor: Vec<f32>,
    /// Positions of the cameras that saw it.
    pub seen_from: Vec<Vector3<f64>>,
}

impl KnownLine {
    fn line(&self) -> Option<WorldLine> {
        line_through(&self.start_in_world, &self.end_in_world)
    }

    /// Whether a camera sees it from about where others saw it; elsewhere it may be hidden or look different.
    fn is_seen_near(&self, center: &Vector3<f64>) -> bool {
        let middle = 0.5 * (self.start_in_world + self.end_in_world);
        let offset = center - middle;
        let a = offset.norm();
        self.seen_from.iter().any(|from| {
            let known = from - middle;
            let b = known.norm();
            offset.dot(&known) >= 0.94 * a * b && a < 1.5 * b && b < 1.5 * a
        })
    }
}

/// For each segment of a posed view the known line that it shows, if any: within the error of the projected line, covering
/// it, seen from a similar direction, looking alike; of several the nearest in the picture, as (error in pixels, line).
/// Segments for which `is_free` is false are left out.
pub fn assign_segments(
    view: &PosedView<'_>,
    lines: &[KnownLine],
    params: &LineParams,
    is_free: impl Fn(usize) -> bool,
) -> Vec<Option<(f64, usize)>> {
    let mut best: Vec<Option<(f64, usize)>> = vec![None; view.segment_ends.len()];
    let mean = |s: usize| {
        let rows = view.features.segment_descriptors(s);
        unit_mean(rows.into_iter(), view.features.descriptor_channels)
    };
    let means: Vec<Vec<f32>> = (0..best.len()).map(mean).collect();
    for (l, known) in lines.iter().enumerate() {
        let Some(line) = known.line() else { continue };
        if !known.is_seen_near(&view.center_in_world) {
            continue;
        }
        let Some(image_line) = project(view, &line) else {
            continue;
        };
        let length = (known.end_in_world - known.start_in_world).norm();
        for (s, ends) in view.segment_ends.iter().enumerate() {
            if !is_free(s) {
                continue;
            }
            let error = ends
                .iter()
                .map(|p| image_line.dot(&p.push(1.0)).abs() * view.focal_px)
                .fold(0.0, f64::max);
            if error > params.max_error_px || error.is_nan() {
                continue;
            }
            let Some((from, to)) = covered(view, s, &line) else {
                continue;
            };
            if to.min(length) - from.max(0.0) < 0.7 * (to - from).min(length) {
                continue;
            }
            if !(dot(&means[s], &known.descriptor) >= params.min_cosine) {
                continue;
            }
            if best[s].is_none_or(|(least, _)| error < least) {
                best[s] = Some((error, l));
            }
        }
    }
    best
}

/// Adds segments that no match found to the tracks that they show.
pub(super) fn by_projection(
    views: &[PosedView<'_>],
    tracks: &mut [LineTrack],
    params: &LineParams,
) {
    let mut owned: Vec<Vec<bool>> = views
        .iter()
        .map(|v| vec![false; v.segment_ends.len()])
        .collect();
    for track in tracks.iter() {
        for o in &track.observations {
            owned[o.view as usize][o.feature as usize] = true;
        }
    }
    let known: Vec<KnownLine> = parallel::map(tracks.len(), |t| {
        let track = &tracks[t];
        KnownLine {
            start_in_world: track.start_in_world,
            end_in_world: track.end_in_world,
            descriptor: line_descriptor(views, &track.observations),
            seen_from: track
                .observations
                .iter()
                .map(|o| views[o.view as usize].center_in_world)
                .collect(),
        }
    });
    let found: Vec<Vec<Option<(f64, usize)>>> = parallel::map(views.len(), |v| {
        assign_segments(&views[v], &known, params, |s| !owned[v][s])
    });
    for (v, segments) in found.iter().enumerate() {
        for (s, line) in segments.iter().enumerate() {
            let Some((_, t)) = line else { continue };
            let observation = Observation::new(v, s);
            let observations = &mut tracks[*t].observations;
            if let Err(at) = observations.binary_search(&observation) {
                observations.insert(at, observation);
            }
        }
    }
}
