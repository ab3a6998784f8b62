//! The landmark table of a reconstruction: which of its tracks, within a number of bytes.

use super::build::{LineSource, PointSource, build};
use super::table::{LINE_BYTES, LandmarkError, LandmarkTable, POINT_BYTES};
use crate::math::stats::median_in_place;
use crate::reconstruction::{LineTrack, Observation, Reconstruction, View, cover};
use nalgebra::Vector3;

/// Landmarks that a picture should hold in the median; more bring little.
const WANTED_A_PICTURE: usize = 700;
/// Lines that a picture should hold in the median.
const WANTED_LINES: usize = 120;
/// Fewer points than this are no help, unless the place has no more.
const LEAST_POINTS: usize = 256;
/// Share of the bytes that lines may take.
const LINE_SHARE: usize = 4;
/// Bytes of a table besides its rows: means, names and shapes of the tensors.
const OVERHEAD: usize = 1_600;
/// Keypoints are whole pixels: the error of one observation is not below this.
const LEAST_ERROR_PX: f64 = 0.3;

/// How large the table may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Bytes of the whole scene file.
    pub max_bytes: usize,
    /// Bytes of the scene file without landmarks.
    pub networks: usize,
}

/// The table of a map: as many points and lines as its size needs and the budget allows, chosen by greedy cover.
///
/// # Errors
/// [`LandmarkError::Empty`] without points, [`LandmarkError::Budget`] when too few fit.
pub fn table(map: &Reconstruction, budget: Budget) -> Result<LandmarkTable, LandmarkError> {
    let room = budget.max_bytes.saturating_sub(budget.networks + OVERHEAD);
    let lines = chosen_lines(map, room / LINE_SHARE / LINE_BYTES);
    let points_fit = (room - lines.len() * LINE_BYTES) / POINT_BYTES;
    let least = LEAST_POINTS.min(map.points.len());
    if points_fit < least {
        return Err(LandmarkError::Budget {
            budget: budget.max_bytes,
            fitting: points_fit,
            least,
            networks: budget.networks,
            needed: budget.networks + OVERHEAD + 2 * least * POINT_BYTES,
        });
    }
    let mut chosen = map.landmarks(points_fit);
    let observations = |i: &usize| map.points[*i].observations.as_slice();
    chosen.truncate(enough(
        map.views.len(),
        chosen.iter().map(observations),
        WANTED_A_PICTURE,
    ));
    // A view without a pose sees nothing; its place is taken so that numbers stay.
    let cameras: Vec<Vector3<f64>> = map
        .views
        .iter()
        .map(|view| center(view).unwrap_or_else(|| Vector3::repeat(f64::NAN)))
        .collect();
    let views_of = |observations: &[Observation]| -> Vec<u32> {
        observations.iter().map(|o| o.view).collect()
    };
    let views: Vec<Vec<u32>> = chosen
        .iter()
        .map(|i| views_of(&map.points[*i].observations))
        .collect();
    let points: Vec<PointSource<'_>> = chosen
        .iter()
        .zip(&views)
        .map(|(i, views)| {
            let track = &map.points[*i];
            PointSource {
                point_in_world: track.point_in_world,
                descriptor: &track.descriptor,
                sigma: sigma(
                    map,
                    &track.point_in_world,
                    &track.observations,
                    track.mean_error_px,
                ),
                views,
            }
        })
        .collect();
    let line_views: Vec<Vec<u32>> = lines
        .iter()
        .map(|i| views_of(&map.lines[*i].observations))
        .collect();
    let lines: Vec<LineSource<'_>> = lines
        .iter()
        .zip(&line_views)
        .map(|(i, views)| {
            let track = &map.lines[*i];
            let [start_in_world, end_in_world] = usual_ends(map, track);
            let middle = 0.5 * (start_in_world + end_in_world);
            LineSource {
                start_in_world,
                end_in_world,
                descriptor: &track.descriptor,
                sigma: sigma(map, &middle, &track.observations, track.mean_error_px),
                views,
            }
        })
        .collect();
    build(map.descriptor_channels(), &cameras, &points, &lines)
}

/// The lines that a table takes, at most so many.
fn chosen_lines(map: &Reconstruction, most: usize) -> Vec<usize> {
    let observations: Vec<&[Observation]> = map
        .lines
        .iter()
        .map(|l| l.observations.as_slice())
        .collect();
    let error = |i: usize| map.lines[i].mean_error_px;
    let mut chosen = cover(&observations, error, map.views.len(), most);
    let seen = chosen.iter().map(|i| observations[*i]);
    chosen.truncate(enough(map.views.len(), seen, WANTED_LINES));
    chosen
}

/// How many of the tracks, in their order, give the median picture as many as wanted.
fn enough<'a>(
    num_views: usize,
    tracks: impl Iterator<Item = &'a [Observation]>,
    wanted: usize,
) -> usize {
    let mut covered = vec![0_usize; num_views];
    let mut num_full = 0;
    let mut num = 0;
    for observations in tracks {
        if 2 * num_full > num_views {
            break;
        }
        num += 1;
        for o in observations {
            if let Some(n) = covered.get_mut(o.view as usize) {
                *n += 1;
                num_full += usize::from(*n == wanted);
            }
        }
    }
    num
}

/// Standard deviation of a landmark across the line of sight: its reprojection error at its distance, over the root of its
/// observations.
fn sigma(
    map: &Reconstruction,
    at: &Vector3<f64>,
    observations: &[Observation],
    error_px: f32,
) -> f64 {
    let per_px = |view: &View| Some((center(view)? - at).norm() / view.camera.focal_px().0);
    let views = observations
        .iter()
        .filter_map(|o| map.views.get(o.view as usize));
    let typical = median_in_place(&mut views.filter_map(per_px).collect::<Vec<f64>>());
    let typical = typical.unwrap_or(0.0);
    let num = observations.len().max(1) as f64;
    typical * f64::from(error_px).max(LEAST_ERROR_PX) / num.sqrt()
}

/// The ends of a line in the order in which most of its image segments run.
fn usual_ends(map: &Reconstruction, track: &LineTrack) -> [Vector3<f64>; 2] {
    let is_reversed = |o: &&Observation| map.is_reversed(track, **o);
    let reversed = track.observations.iter().filter(is_reversed).count();
    let mut ends = [track.start_in_world, track.end_in_world];
    if 2 * reversed > track.observations.len() {
        ends.swap(0, 1);
    }
    ends
}

fn center(view: &View) -> Option<Vector3<f64>> {
    Some(view.cam_from_world?.center_in_world())
}
