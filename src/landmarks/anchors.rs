//! Which tracks become the landmarks that a network chooses among, and what they look like.

use crate::geometry::SceneScale;
use crate::models::landmarks::Anchor;
use crate::reconstruction::{Observation, Reconstruction, cover};
use nalgebra::Vector3;
use std::ops::Range;

/// Observations in pictures that are not held out: landmarks must not know those.
fn kept(observations: &[Observation], held: &Range<usize>) -> Vec<Observation> {
    let seen = observations.iter().copied();
    seen.filter(|o| !held.contains(&(o.view as usize)))
        .collect()
}

/// Unit mean of the rows that `row` finds for the observations, each row possibly of several descriptors.
fn mean_key<'a>(
    observations: &[Observation],
    len: usize,
    row: impl Fn(&Observation) -> Option<&'a [f32]>,
) -> Vec<f32> {
    let mut key = vec![0.0f32; len];
    for descriptor in observations
        .iter()
        .filter_map(&row)
        .flat_map(|r| r.chunks_exact(len))
    {
        for (k, d) in key.iter_mut().zip(descriptor) {
            *k += d;
        }
    }
    let norm = key.iter().map(|k| k * k).sum::<f32>().sqrt().max(1e-12);
    key.iter_mut().for_each(|k| *k /= norm);
    key
}

/// The `count` tracks that cover the pictures best, each with the observations that landmarks may know. A track is told by its
/// observations and its error.
fn chosen<'a>(
    map: &Reconstruction,
    tracks: impl Iterator<Item = (&'a [Observation], f32)>,
    held: &Range<usize>,
    count: usize,
) -> Vec<(usize, Vec<Observation>)> {
    let (mut observations, errors): (Vec<_>, Vec<_>) = tracks
        .map(|(seen, error)| (kept(seen, held), error))
        .unzip();
    let slices: Vec<&[Observation]> = observations.iter().map(Vec::as_slice).collect();
    cover(&slices, |t| errors[t], map.views.len(), count)
        .into_iter()
        .map(|t| (t, std::mem::take(&mut observations[t])))
        .collect()
}

/// Point landmarks: mean descriptors and positions, of tracks outside the held-out pictures.
pub fn point_anchors(
    map: &Reconstruction,
    held: &Range<usize>,
    scale: &SceneScale,
    count: usize,
) -> Vec<Anchor> {
    let tracks = map
        .points
        .iter()
        .map(|p| (p.observations.as_slice(), p.mean_error_px));
    chosen(map, tracks, held, count)
        .into_iter()
        .map(|(t, observations)| Anchor {
            key: mean_key(&observations, map.descriptor_channels(), |o| {
                let view = map.views.get(o.view as usize)?;
                view.features.descriptor(o.feature as usize)
            }),
            value: normalised(map.points[t].point_in_world, scale).to_vec(),
        })
        .collect()
}

/// Segment landmarks, turned so that most observations agree with the order of the ends.
pub fn line_anchors(
    map: &Reconstruction,
    held: &Range<usize>,
    scale: &SceneScale,
    count: usize,
) -> Vec<Anchor> {
    let tracks = map
        .lines
        .iter()
        .map(|l| (l.observations.as_slice(), l.mean_error_px));
    chosen(map, tracks, held, count)
        .into_iter()
        .map(|(t, observations)| {
            let track = &map.lines[t];
            let is_reversed = |o: &&Observation| map.is_reversed(track, **o);
            let reversed = observations.iter().filter(is_reversed).count();
            let mut ends = [track.start_in_world, track.end_in_world];
            if 2 * reversed > observations.len() {
                ends.swap(0, 1);
            }
            Anchor {
                key: mean_key(&observations, map.descriptor_channels(), |o| {
                    let view = map.views.get(o.view as usize)?;
                    view.features.segment_descriptors(o.feature as usize)
                }),
                value: ends.iter().flat_map(|e| normalised(*e, scale)).collect(),
            }
        })
        .collect()
}

fn normalised(p: Vector3<f64>, scale: &SceneScale) -> [f32; 3] {
    let n = scale.network_from_world(p);
    [n.x as f32, n.y as f32, n.z as f32]
}
