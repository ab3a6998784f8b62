//! Point tracks: matches are joined, triangulated robustly, completed along matches and by projection, merged, filtered.

use super::matching::Match;
use super::track::{describe_points, point_descriptor};
use super::triangulate::{Bundle, Ray};
use super::{Observation, PointTrack, PosedView, Stage, Watch};
use crate::math::order::sort_by;
use crate::math::{Rng, elementary, parallel};
use core::cmp::Ordering;
use nalgebra::Vector3;
use std::collections::HashSet;

/// What makes a track.
#[derive(Debug, Clone, PartialEq)]
pub struct PointParams {
    /// Largest reprojection error of an observation.
    pub max_error_px: f64,
    /// Least largest angle between two of a track's rays.
    pub min_angle_deg: f64,
    /// Least number of observations.
    pub min_observations: usize,
    /// Rounds of completing and merging.
    pub rounds: usize,
    /// Least cosine to the track's mean descriptor when a keypoint is found by projection.
    pub min_cosine: f32,
    /// Largest angle between the viewing direction of such a keypoint and that of an observation.
    pub max_view_angle_deg: f64,
}

impl Default for PointParams {
    fn default() -> Self {
        Self {
            max_error_px: 3.0,
            min_angle_deg: 1.5,
            min_observations: 3,
            rounds: 3,
            min_cosine: 0.8,
            max_view_angle_deg: 20.0,
        }
    }
}

/// Loss of the refinement turns linear here; about the noise of an integer keypoint in several views.
const HUBER_PX: f64 = 1.5;
const NO_TRACK: u32 = u32::MAX;
/// Sets of joined keypoints in one piece of work.
const ROBUST_PIECE: usize = 1024;

/// Builds the tracks of a scene; `None` when stopped.
pub async fn build_point_tracks(
    views: &[PosedView<'_>],
    matches: &[Match],
    params: &PointParams,
    watch: &mut Watch<'_>,
) -> Option<Vec<PointTrack>> {
    let bundle = Bundle { views };
    let nodes = Nodes::new(views);
    let mut edges: Vec<(u32, u32, f32)> = matches
        .iter()
        .map(|m| (nodes.of(m.a), nodes.of(m.b), m.cosine))
        .collect();
    edges.sort_unstable_by(nearest_first);
    let components = join(&nodes, &edges);
    // Half of the work, then a step for each round and one for the projection.
    let steps = params.rounds + 1;
    let total = 2 * components.len().max(1);
    let mut tracks: Vec<PointTrack> = Vec::new();
    for first in (0..components.len()).step_by(ROBUST_PIECE) {
        let piece = &components[first..components.len().min(first + ROBUST_PIECE)];
        let found = parallel::map(piece.len(), |i| {
            robust(&bundle, &piece[i], params, (first + i) as u64)
        });
        tracks.extend(found.into_iter().flatten());
        watch
            .tell(Stage::Points, first + piece.len(), total)
            .await?;
    }
    for round in 0..params.rounds {
        let mut owner = nodes.owners(&tracks);
        complete(&bundle, &nodes, &edges, &mut tracks, &mut owner, params);
        merge(&bundle, &edges, &mut tracks, &owner, params);
        tracks = settle(&bundle, tracks, params);
        let done = total / 2 + (round + 1) * (total / 2) / steps;
        watch.tell(Stage::Points, done, total).await?;
    }
    by_projection(views, &nodes, &mut tracks, params);
    tracks = settle(&bundle, tracks, params);
    watch.tell(Stage::Points, total, total).await?;
    tracks.retain(|t| {
        t.observations.len() >= params.min_observations
            && bundle
                .largest_angle(&t.observations, &t.point_in_world)
                .to_degrees()
                >= params.min_angle_deg
    });
    describe_points(views, &mut tracks);
    Some(tracks)
}

/// Keypoints of all views in one numbering.
pub(super) struct Nodes {
    first: Vec<u32>,
}

impl Nodes {
    fn new(views: &[PosedView<'_>]) -> Self {
        Self::of_lengths(views.iter().map(|v| v.planar.len()))
    }

    /// From the number of keypoints of each view.
    pub(super) fn of_lengths(lengths: impl Iterator<Item = usize>) -> Self {
        let mut first = vec![0];
        let mut next = 0;
        for len in lengths {
            next += len as u32;
            first.push(next);
        }
        Self { first }
    }

    fn len(&self) -> usize {
        self.first.last().copied().unwrap_or(0) as usize
    }

    pub(super) fn of(&self, seen: Observation) -> u32 {
        self.first[seen.view as usize] + seen.feature
    }

    fn observation(&self, node: u32) -> Observation {
        let view = self.first.partition_point(|first| *first <= node) - 1;
        Observation {
            view: view as u32,
            feature: node - self.first[view],
        }
    }

    fn owners(&self, tracks: &[PointTrack]) -> Vec<u32> {
        let mut owner = vec![NO_TRACK; self.len()];
        for (t, track) in tracks.iter().enumerate() {
            for o in &track.observations {
                owner[self.of(*o) as usize] = t as u32;
            }
        }
        owner
    }
}

pub(super) fn root(parent: &mut [u32], mut node: u32) -> u32 {
    while parent[node as usize] != node {
        let up = parent[parent[node as usize] as usize];
        parent[node as usize] = up;
        node = up;
    }
    node
}

/// Orders matches (first, second, cosine): the most alike first.
pub(super) fn nearest_first(x: &(u32, u32, f32), y: &(u32, u32, f32)) -> Ordering {
    y.2.total_cmp(&x.2).then((x.0, x.1).cmp(&(y.0, y.1)))
}

/// Joins matched keypoints, best match first, unless the two sets already hold keypoints of one view.
pub(super) fn join(nodes: &Nodes, edges: &[(u32, u32, f32)]) -> Vec<Vec<Observation>> {
    let mut parent: Vec<u32> = (0..nodes.len() as u32).collect();
    let mut members: Vec<Vec<Observation>> = parent
        .iter()
        .map(|node| vec![nodes.observation(*node)])
        .collect();
    for &(a, b, _) in edges {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        if a == b {
            continue;
        }
        let (small, large) = if members[a as usize].len() < members[b as usize].len() {
            (a, b)
        } else {
            (b, a)
        };
        let large_members = &members[large as usize];
        let clash = members[small as usize]
            .iter()
            .any(|o| position_of_view(large_members, o.view).is_ok());
        if clash {
            continue;
        }
        let moved = std::mem::take(&mut members[small as usize]);
        members[large as usize].extend(moved);
        members[large as usize].sort_unstable();
        parent[small as usize] = large;
    }
    members.retain(|m| m.len() >= 2);
    members
}

/// Tracks of one set of joined keypoints: the best supported point, then whatever the rest supports.
fn robust(
    bundle: &Bundle<'_>,
    component: &[Observation],
    params: &PointParams,
    seed: u64,
) -> Vec<PointTrack> {
    let mut rest = component.to_vec();
    let mut tracks = Vec::new();
    let mut rng = Rng::from_seed(seed);
    while rest.len() >= 2 {
        let Some(track) = best_point(bundle, &rest, params, &mut rng) else {
            break;
        };
        rest.retain(|o| !track.observations.contains(o));
        tracks.push(track);
    }
    tracks
}

pub(super) fn best_point(
    bundle: &Bundle<'_>,
    observations: &[Observation],
    params: &PointParams,
    rng: &mut Rng,
) -> Option<PointTrack> {
    let rays: Vec<Ray> = observations
        .iter()
        .map(|o| bundle.views[o.view as usize].ray(o.feature as usize))
        .collect();
    let n = observations.len();
    let all_pairs = n * (n - 1) / 2;
    let min_angle = params.min_angle_deg.to_radians() * 0.5;
    let limit_sq = params.max_error_px * params.max_error_px;
    let mut best: Option<(f64, Vector3<f64>)> = None;
    let mut try_pair = |i: usize, j: usize| {
        if rays[i].angle_to(&rays[j]) < min_angle {
            return;
        }
        let Some(point) = rays[i].midpoint(&rays[j]) else {
            return;
        };
        let score: f64 = observations
            .iter()
            .map(|o| bundle.error_px(*o, &point).powi(2).min(limit_sq))
            .sum();
        if best.is_none_or(|(least, _)| score < least) {
            best = Some((score, point));
        }
    };
    const MAX_PAIRS: usize = 40;
    if all_pairs <= MAX_PAIRS {
        for i in 0..n {
            for j in i + 1..n {
                try_pair(i, j);
            }
        }
    } else {
        for _ in 0..MAX_PAIRS {
            let i = rng.below(n as u32) as usize;
            let j = rng.below(n as u32 - 1) as usize;
            try_pair(i, j + usize::from(j >= i));
        }
    }
    let (_, mut point) = best?;
    let mut inliers = Vec::new();
    for _ in 0..3 {
        inliers = within(bundle, observations, &point, params.max_error_px);
        if inliers.len() < 2 {
            return None;
        }
        point = bundle.refine(&inliers, point, HUBER_PX);
    }
    inliers.retain(|o| bundle.error_px(*o, &point) <= params.max_error_px);
    (inliers.len() >= 2).then(|| PointTrack::new(point, inliers))
}

fn within(
    bundle: &Bundle<'_>,
    observations: &[Observation],
    point: &Vector3<f64>,
    max_error_px: f64,
) -> Vec<Observation> {
    observations
        .iter()
        .copied()
        .filter(|o| bundle.error_px(*o, point) <= max_error_px)
        .collect()
}

/// Gives keypoints without a track to the track of a keypoint that they match, where the point fits.
fn complete(
    bundle: &Bundle<'_>,
    nodes: &Nodes,
    edges: &[(u32, u32, f32)],
    tracks: &mut [PointTrack],
    owner: &mut [u32],
    params: &PointParams,
) {
    for &(a, b, _) in edges {
        let (free, track) = match (owner[a as usize], owner[b as usize]) {
            (NO_TRACK, t) if t != NO_TRACK => (a, t),
            (t, NO_TRACK) if t != NO_TRACK => (b, t),
            _ => continue,
        };
        let observation = nodes.observation(free);
        let target = &mut tracks[track as usize];
        if bundle.error_px(observation, &target.point_in_world) > params.max_error_px {
            continue;
        }
        if let Err(at) = position_of_view(&target.observations, observation.view) {
            target.observations.insert(at, observation);
            owner[free as usize] = track;
        }
    }
}

/// Joins tracks that are linked by a match, share no view, and fit one point.
fn merge(
    bundle: &Bundle<'_>,
    edges: &[(u32, u32, f32)],
    tracks: &mut Vec<PointTrack>,
    owner: &[u32],
    params: &PointParams,
) {
    let mut parent: Vec<u32> = (0..tracks.len() as u32).collect();
    let mut tried: HashSet<(u32, u32)> = HashSet::new();
    for &(a, b, _) in edges {
        let (t, u) = (owner[a as usize], owner[b as usize]);
        if t == NO_TRACK || u == NO_TRACK || t == u {
            continue;
        }
        let (t, u) = (root(&mut parent, t), root(&mut parent, u));
        if t == u || !tried.insert((t.min(u), t.max(u))) {
            continue;
        }
        let (first, second) = (&tracks[t as usize], &tracks[u as usize]);
        // A quick look before the refinement: points that are one see each other's observations almost as well.
        let loose = 2.0 * params.max_error_px;
        let sees = |from: &PointTrack, point: &Vector3<f64>| {
            from.observations
                .iter()
                .all(|o| bundle.error_px(*o, point) <= loose)
        };
        if !sees(second, &first.point_in_world) && !sees(first, &second.point_in_world) {
            continue;
        }
        let clash = first
            .observations
            .iter()
            .any(|o| position_of_view(&second.observations, o.view).is_ok());
        if clash {
            continue;
        }
        let mut observations = first.observations.clone();
        observations.extend(&second.observations);
        observations.sort_unstable();
        let weight = first.observations.len() as f64 / observations.len() as f64;
        let start = first.point_in_world * weight + second.point_in_world * (1.0 - weight);
        let point = bundle.refine(&observations, start, HUBER_PX);
        if observations
            .iter()
            .any(|o| bundle.error_px(*o, &point) > params.max_error_px)
        {
            continue;
        }
        let (into, gone) = (t.min(u), t.max(u));
        parent[gone as usize] = into;
        tracks[gone as usize].observations.clear();
        tracks[into as usize] = PointTrack::new(point, observations);
    }

    tracks.retain(|t| !t.observations.is_empty());
}

/// Refines every track on its observations and drops those that do not fit.
fn settle(bundle: &Bundle<'_>, tracks: Vec<PointTrack>, params: &PointParams) -> Vec<PointTrack> {
    let settled = parallel::map(tracks.len(), |t| {
        let track = &tracks[t];
        let mut point = bundle.refine(&track.observations, track.point_in_world, HUBER_PX);
        let inliers = within(bundle, &track.observations, &point, params.max_error_px);
        if inliers.len() < 2 {
            return None;
        }
        if inliers.len() < track.observations.len() {
            point = bundle.refine(&inliers, point, HUBER_PX);
        }
        let observations = within(bundle, &inliers, &point, params.max_error_px);
        (observations.len() >= 2).then(|| PointTrack::new(point, observations))
    });
    settled.into_iter().flatten().collect()
}

/// Where a view's observation is in a sorted list, or where it would be.
fn position_of_view(observations: &[Observation], view: u32) -> Result<usize, usize> {
    observations.binary_search_by_key(&view, |o| o.view)
}

/// Finds observations that no match found: keypoints without a track near a projected point, seen from a similar
/// direction, with a similar descriptor.
fn by_projection(
    views: &[PosedView<'_>],
    nodes: &Nodes,
    tracks: &mut [PointTrack],
    params: &PointParams,
) {
    let owner = nodes.owners(tracks);
    struct Known {
        descriptor: Vec<f32>,
        directions: Vec<Vector3<f64>>,
        depth: (f64, f64),
    }
    let known: Vec<Option<Known>> = parallel::map(tracks.len(), |t| {
        let track = &tracks[t];
        if track.observations.len() < params.min_observations {
            return None;
        }
        let offsets: Vec<Vector3<f64>> = track
            .observations
            .iter()
            .map(|o| views[o.view as usize].center_in_world - track.point_in_world)
            .collect();
        let depth = offsets
            .iter()
            .map(Vector3::norm)
            .fold((f64::MAX, 0f64), |(low, high), d| (low.min(d), high.max(d)));
        Some(Known {
            descriptor: point_descriptor(views, &track.observations),
            directions: offsets
                .iter()
                .filter_map(|o| o.try_normalize(0.0))
                .collect(),
            depth,
        })
    });
    let cos_limit = elementary::cos(params.max_view_angle_deg.to_radians());
    let found: Vec<Vec<(u32, u32, u32, f32)>> = parallel::map(views.len(), |v| {
        let view = &views[v];
        let free = Grid::new(
            view,
            params.max_error_px,
            (0..view.planar.len())
                .filter(|k| owner[nodes.of(Observation::new(v, *k)) as usize] == NO_TRACK),
        );
        let mut best: Vec<Option<(f32, u32)>> = vec![None; view.planar.len()];
        for (t, (track, known)) in tracks.iter().zip(&known).enumerate() {
            let Some(known) = known else { continue };
            let point = &track.point_in_world;
            let Some(place) = view.planar_from_world(point) else {
                continue;
            };
            let Some(candidates) = free.near(place * view.focal_px) else {
                continue;
            };
            let offset = view.center_in_world - point;
            let distance = offset.norm();
            if distance < 0.6 * known.depth.0 || distance > 1.6 * known.depth.1 {
                continue;
            }
            let direction = offset / distance;
            if !known
                .directions
                .iter()
                .any(|d| d.dot(&direction) >= cos_limit)
            {
                continue;
            }
            if position_of_view(&track.observations, v as u32).is_ok() {
                continue;
            }
            for k in candidates {
                if view.error_px(k as usize, point) > params.max_error_px {
                    continue;
                }
                let Some(descriptor) = view.features.descriptor(k as usize) else {
                    continue;
                };
                let cosine = dot(descriptor, &known.descriptor);
                let slot = &mut best[k as usize];
                if cosine >= params.min_cosine && slot.is_none_or(|(c, _)| cosine > c) {
                    *slot = Some((cosine, t as u32));
                }
            }
        }
        best.iter()
            .enumerate()
            .filter_map(|(k, b)| b.map(|(cosine, t)| (t, v as u32, k as u32, cosine)))
            .collect()
    });
    let mut found: Vec<(u32, u32, u32, f32)> = found.into_iter().flatten().collect();
    sort_by(&mut found, |x, y| {
        y.3.total_cmp(&x.3)
            .then((x.0, x.1, x.2).cmp(&(y.0, y.1, y.2)))
    });
    for (t, view, keypoint, _) in found {
        let observations = &mut tracks[t as usize].observations;
        if let Err(at) = position_of_view(observations, view) {
            observations.insert(
                at,
                Observation {
                    view,
                    feature: keypoint,
                },
            );
        }
    }
}

/// Dot product in eight sums, which the compiler makes vectors of.
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a8, a_rest), (b8, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0f32; 8];
    for (x, y) in a8.iter().zip(b8) {
        for (sum, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *sum += x * y;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f32>() + rest
}

/// Some keypoints of a view in square cells.
struct Grid {
    cell: f64,
    origin: (f64, f64),
    columns: usize,
    rows: usize,
    first: Vec<u32>,
    items: Vec<u32>,
}

impl Grid {
    fn new(view: &PosedView<'_>, reach_px: f64, keypoints: impl Iterator<Item = usize>) -> Self {
        let cell = 2.0 * reach_px;
        let places: Vec<(usize, f64, f64)> = keypoints
            .filter_map(|k| {
                let p = view.planar[k] * view.focal_px;
                (!p.x.is_nan()).then_some((k, p.x, p.y))
            })
            .collect();
        let bounds = places.iter().fold(
            (f64::MAX, f64::MAX, f64::MIN, f64::MIN),
            |(l, t, r, b), (_, x, y)| (l.min(*x), t.min(*y), r.max(*x), b.max(*y)),
        );
        let (columns, rows) = if places.is_empty() {
            (0, 0)
        } else {
            (
                ((bounds.2 - bounds.0) / cell) as usize + 1,
                ((bounds.3 - bounds.1) / cell) as usize + 1,
            )
        };
        let cell_of = |x: f64, y: f64| {
            ((y - bounds.1) / cell) as usize * columns + ((x - bounds.0) / cell) as usize
        };
        let mut first = vec![0u32; columns * rows + 1];
        for (_, x, y) in &places {
            first[cell_of(*x, *y) + 1] += 1;
        }
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut items = vec![0u32; places.len()];
        for (k, x, y) in &places {
            let slot = &mut next[cell_of(*x, *y)];
            items[*slot as usize] = *k as u32;
            *slot += 1;
        }
        Self {
            cell,
            origin: (bounds.0, bounds.1),
            columns,
            rows,
            first,
            items,
        }
    }

    /// Keypoints of the cells around a place; `None` when it lies outside.
    fn near(&self, place: nalgebra::Vector2<f64>) -> Option<impl Iterator<Item = u32> + '_> {
        let column = ((place.x - self.origin.0) / self.cell).floor();
        let row = ((place.y - self.origin.1) / self.cell).floor();
        if !(column >= -1.0
            && row >= -1.0
            && column <= self.columns as f64
            && row <= self.rows as f64)
        {
            return None;
        }
        let (column, row) = (column as isize, row as isize);
        Some(
            (-1..=1)
                .flat_map(move |dy| (-1..=1).map(move |dx| (column + dx, row + dy)))
                .flat_map(|(c, r)| {
                    let inside =
                        c >= 0 && r >= 0 && c < self.columns as isize && r < self.rows as isize;
                    let range = if inside {
                        let cell = r as usize * self.columns + c as usize;
                        self.first[cell] as usize..self.first[cell + 1] as usize
                    } else {
                        0..0
                    };
                    self.items[range].iter().copied()
                }),
        )
    }
}
