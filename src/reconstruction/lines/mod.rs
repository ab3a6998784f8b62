//! Line tracks: segments matched under the known epipolar geometry, joined, triangulated robustly as infinite lines,
//! cut to what was seen, completed by projection.
//!
//! A segment's ends are where the detector stopped, not where the line stops, so only infinite lines are compared. What
//! two segments share is found with the poses: the epipolar lines of one segment's ends cut the other segment's line.

mod complete;
mod fit;
mod matching;
mod world_line;

use super::track::describe_lines;
use super::{LineTrack, PIECE, PosedView, Stage, Watch, planar_from_pixel};
use crate::geometry::{CamFromWorld, Camera, Segment2};
use crate::math::order::sort_by;
use crate::math::parallel;
pub use complete::{KnownLine, assign_segments};
use matching::SegmentMatch;
use nalgebra::Vector2;

/// What makes a line track.
#[derive(Debug, Clone, PartialEq)]
pub struct LineParams {
    /// Least share of the shorter segment that both segments of a match cover.
    pub min_overlap: f64,
    /// Least mean cosine of the descriptors along the shared part.
    pub min_cosine: f32,
    /// A segment whose angle to the epipolar line is less has no depth from this pair.
    pub min_epipolar_angle_deg: f64,
    /// Largest distance of an observed end from the projected infinite line.
    pub max_error_px: f64,
    /// Least angle between two planes through cameras and segments.
    pub min_plane_angle_deg: f64,
    /// Least number of pictures of a track.
    pub min_views: usize,
    /// Partners of each picture that are tried.
    pub partners: usize,
}

impl Default for LineParams {
    fn default() -> Self {
        Self {
            min_overlap: 0.4,
            min_cosine: 0.78,
            min_epipolar_angle_deg: 8.0,
            max_error_px: 2.0,
            min_plane_angle_deg: 1.5,
            min_views: 4,
            partners: 12,
        }
    }
}

/// Builds the line tracks of a scene; `pairs` as for points. `None` when stopped.
pub async fn build_line_tracks(
    views: &[PosedView<'_>],
    pairs: &[(usize, usize)],
    depth: f64,
    params: &LineParams,
    watch: &mut Watch<'_>,
) -> Option<Vec<LineTrack>> {
    let mut matches: Vec<SegmentMatch> = Vec::new();
    for (piece, done) in pairs.chunks(PIECE).zip((PIECE..).step_by(PIECE)) {
        let found = parallel::map(piece.len(), |pair| {
            let (i, j) = piece[pair];
            matching::match_pair(views, i, j, depth, params)
        });
        matches.extend(found.into_iter().flatten());
        let done = done.min(pairs.len());
        watch.tell(Stage::Lines, done, pairs.len()).await?;
    }
    let components = matching::join(views, &matches);
    let tracks = parallel::map(components.len(), |seed| {
        fit::robust(views, &components[seed], params, seed as u64)
    })
    .into_iter()
    .flatten()
    .collect();
    let mut tracks = complete::merge(views, tracks, params);
    complete::by_projection(views, &mut tracks, params);
    let settled = parallel::map(tracks.len(), |t| {
        fit::settle(views, &tracks[t].observations, params)
    });
    let mut tracks: Vec<LineTrack> = settled.into_iter().flatten().collect();
    describe_lines(views, &mut tracks);
    Some(tracks)
}

/// Pairs for lines: of each picture's pairs those with the widest baselines, which is what fixes a line's depth.
pub fn line_pairs(
    views: &[PosedView<'_>],
    pairs: &[(usize, usize)],
    partners: usize,
) -> Vec<(usize, usize)> {
    let mut of: Vec<Vec<(f64, usize, usize)>> = vec![Vec::new(); views.len()];
    for &(i, j) in pairs {
        let distance = (views[i].center_in_world - views[j].center_in_world).norm();
        of[i].push((distance, i, j));
        of[j].push((distance, i, j));
    }
    let mut chosen = Vec::new();
    for list in &mut of {
        sort_by(list, |x, y| x.0.total_cmp(&y.0));
        let n = list.len();
        let wanted = partners.min(n);
        chosen.extend((0..wanted).map(|k| {
            let (_, i, j) = list[(k * n + n / 2) / wanted.max(1)];
            (i, j)
        }));
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Mean over the observations of the distance of observed ends to the projected line.
pub(super) fn mean_error_px(views: &[PosedView<'_>], track: &LineTrack) -> f64 {
    let Some(line) = world_line::line_of(track) else {
        return f64::INFINITY;
    };
    let sum: f64 = track
        .observations
        .iter()
        .filter_map(|o| Some((views.get(o.view as usize)?, o.feature as usize)))
        .map(|(view, segment)| world_line::line_error_px(view, segment, &line))
        .sum();
    sum / track.observations.len().max(1) as f64
}

/// Whether a track runs against a segment that observes it; false where that cannot be told.
pub(super) fn runs_against(
    camera: &Camera,
    cam_from_world: &CamFromWorld,
    segment: &Segment2,
    track: &LineTrack,
) -> bool {
    let origin = cam_from_world.center_in_world();
    let place = |line: &world_line::WorldLine, pixel| {
        let planar: Vector2<f64> = planar_from_pixel(camera, pixel);
        let direction = cam_from_world.rotation.transpose() * planar.push(1.0).normalize();
        line.nearest_to_ray(&origin, &direction)
    };
    let places = world_line::line_of(track)
        .and_then(|line| Some((place(&line, segment.start)?, place(&line, segment.end)?)));
    places.is_some_and(|(start, end)| end < start)
}
