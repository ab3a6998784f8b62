//! Line tracks: segments matched under the known epipolar geometry, joined, triangulated robustly as infinite lines,
//! cut to what was seen, completed by projection.
//!
//! A segment's ends are where the detector stopped, not where the line stops, so only infinite lines are compared. What
//! two segments share is found with the poses: the epipolar lines of one segment's ends cut the other segment's line.

mod complete;
mod fit;
mod matching;
mod world_line;

use super::View;
pub use complete::{KnownLine, assign_segments};
use matching::SegmentMatch;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

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

/// A 3D segment and what sees it: (view, segment), sorted; a view may see it in pieces.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentTrack {
    /// One end.
    pub start_in_world: Vector3<f64>,
    /// The other end.
    pub end_in_world: Vector3<f64>,
    /// What sees it.
    pub observations: Vec<(u32, u32)>,
}

/// Builds the line tracks of a scene; `pairs` as for points.
pub fn build_line_tracks(
    views: &[View],
    pairs: &[(usize, usize)],
    depth: f64,
    params: &LineParams,
    done: &(impl Fn() + Sync),
) -> Vec<SegmentTrack> {
    let matches: Vec<SegmentMatch> = pairs
        .par_iter()
        .flat_map_iter(|&(i, j)| {
            let found = matching::match_pair(views, i, j, depth, params);
            done();
            found
        })
        .collect();
    let components = matching::join(views, &matches);
    let mut tracks: Vec<SegmentTrack> = components
        .par_iter()
        .enumerate()
        .flat_map_iter(|(seed, component)| fit::robust(views, component, params, seed as u64))
        .collect();
    tracks = complete::merge(views, tracks, params);
    complete::by_projection(views, &mut tracks, params);
    tracks
        .into_par_iter()
        .filter_map(|t| fit::settle(views, &t.observations, params))
        .collect()
}

/// Pairs for lines: of each picture's pairs those with the widest baselines, which is what fixes a line's depth.
pub fn line_pairs(
    views: &[View],
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
        list.sort_by(|x, y| x.0.total_cmp(&y.0));
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

impl View {
    /// Sum over the samples of a segment's descriptors, scaled to unit length.
    pub(super) fn mean_of_segment(&self, segment: usize) -> nalgebra::DVector<f32> {
        let mut mean = self.sum_of_segment(segment);
        mean.normalize_mut();
        mean
    }

    fn sum_of_segment(&self, segment: usize) -> nalgebra::DVector<f32> {
        let samples = self.segment_descriptors_dn.ncols() / self.segment_ends.len().max(1);
        self.segment_descriptors_dn
            .columns(segment * samples, samples)
            .column_sum()
    }
}

/// Mean over observations and samples, of unit length.
pub(crate) fn mean_segment_descriptor(
    views: &[View],
    observations: &[(u32, u32)],
) -> nalgebra::DVector<f32> {
    let d = views
        .first()
        .map_or(0, |v| v.segment_descriptors_dn.nrows());
    let mut mean = nalgebra::DVector::zeros(d);
    for (v, s) in observations {
        mean += views[*v as usize].sum_of_segment(*s as usize);
    }
    let norm = mean.norm();
    if norm > 0.0 {
        mean /= norm;
    }
    mean
}

/// Mean over the observations of the distance of observed ends to the projected line, and for each observation whether
/// the track runs against it.
pub(crate) fn line_residuals(views: &[View], track: &SegmentTrack) -> (f64, Vec<bool>) {
    let Some(line) = world_line::line_of(track) else {
        return (f64::INFINITY, vec![false; track.observations.len()]);
    };
    let mut sum = 0.0;
    let reversed = track
        .observations
        .iter()
        .map(|(v, s)| {
            let view = &views[*v as usize];
            sum += world_line::line_error_px(view, *s as usize, &line);
            let places = view.segment_ends.get(*s as usize).and_then(|ends| {
                let at = |end: &Vector2<f64>| {
                    let ray = view.ray_through(end);
                    line.nearest_to_ray(&ray.origin, &ray.direction)
                };
                Some((at(&ends[0])?, at(&ends[1])?))
            });
            places.is_some_and(|(start, end)| end < start)
        })
        .collect();
    (sum / track.observations.len().max(1) as f64, reversed)
}
