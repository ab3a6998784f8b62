//! Which segments of two views may show the same line, and the sets that such matches join.

use super::super::matching::essential;
use super::super::points::{dot, root};
use super::super::{Observation, PosedView};
use super::LineParams;
use super::world_line::{SegmentPlane, WorldLine, lies_in_front, segment_plane};
use crate::math::elementary;
use crate::math::order::sort_by;
use nalgebra::{Vector2, Vector3};

/// Two segments that may show the same line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SegmentMatch {
    a: Observation,
    b: Observation,
    score: f32,
}

/// Where a line of the plane, through `p` and `q`, is cut by another one (homogeneous), as the share from p to q.
fn cut(p: &Vector2<f64>, q: &Vector2<f64>, line: &Vector3<f64>) -> Option<f64> {
    let at_p = line.dot(&p.push(1.0));
    let at_q = line.dot(&q.push(1.0));
    let slope = at_p - at_q;
    (slope.abs() > 1e-12).then(|| at_p / slope)
}

pub(super) fn match_pair(
    views: &[PosedView<'_>],
    i: usize,
    j: usize,
    depth: f64,
    params: &LineParams,
) -> Vec<SegmentMatch> {
    let (a, b) = (&views[i], &views[j]);
    let e = essential(&a.cam_from_world, &b.cam_from_world);
    let e_back = e.transpose();
    let (n_a, n_b) = (a.segment_ends.len(), b.segment_ends.len());
    if n_a == 0 || n_b == 0 {
        return Vec::new();
    }
    let channels = a.features.descriptor_channels;
    if channels == 0 || channels != b.features.descriptor_channels {
        return Vec::new();
    }
    let sin_limit = elementary::sin(params.min_epipolar_angle_deg.to_radians());
    let sin_of_planes = elementary::sin(params.min_plane_angle_deg.to_radians()) * 0.5;
    let planes_b: Vec<Option<SegmentPlane>> = (0..n_b).map(|t| segment_plane(b, t)).collect();
    let mut best_a: Vec<(f32, usize)> = vec![(0.0, usize::MAX); n_a];
    let mut best_b: Vec<(f32, usize)> = vec![(0.0, usize::MAX); n_b];
    for (s, ends_a) in a.segment_ends.iter().enumerate() {
        let epipolar = ends_a.map(|p| e * p.push(1.0));
        let (Some(plane_a), Some(rows_a)) =
            (segment_plane(a, s), a.features.segment_descriptors(s))
        else {
            continue;
        };
        for (t, ends_b) in b.segment_ends.iter().enumerate() {
            let along = ends_b[1] - ends_b[0];
            let length = along.norm();
            // Both epipolar lines must cross the other segment at an angle that gives depth.
            let crosses = epipolar.iter().all(|l| {
                let n = l.xy();
                (n.dot(&along)).abs() >= sin_limit * n.norm() * length
            });
            if !crosses {
                continue;
            }
            let (Some(u), Some(v)) = (
                cut(&ends_b[0], &ends_b[1], &epipolar[0]),
                cut(&ends_b[0], &ends_b[1], &epipolar[1]),
            ) else {
                continue;
            };
            // Shares of b's segment at which a's ends lie; what is shared is the part within 0..1.
            let (low, high) = (u.min(v).max(0.0), u.max(v).min(1.0));
            let shared = high - low;
            let shorter = (u - v).abs().min(1.0);
            if !(shorter > 0.0) || shared < params.min_overlap * shorter {
                continue;
            }
            let Some(plane_b) = &planes_b[t] else {
                continue;
            };
            let Some((line, sin)) = WorldLine::from_planes(&plane_a, plane_b) else {
                continue;
            };
            if sin < sin_of_planes
                || !lies_in_front(a, &line, ends_a, depth)
                || !lies_in_front(b, &line, ends_b, depth)
            {
                continue;
            }
            // Descriptors at five places of the shared part, each place found in `a` through the epipolar line of
            // its place in `b`.
            let Some(rows_b) = b.features.segment_descriptors(t) else {
                continue;
            };
            let mut sum = 0.0;
            let mut places = 0;
            for k in 0..5 {
                let share_b = low + shared * (0.1 + 0.2 * f64::from(k));
                let place_b = ends_b[0] + along * share_b;
                let Some(share_a) = cut(&ends_a[0], &ends_a[1], &(e_back * place_b.push(1.0)))
                else {
                    continue;
                };
                sum += dot(
                    sample_at(rows_a, channels, share_a),
                    sample_at(rows_b, channels, share_b),
                );
                places += 1;
            }
            if places < 3 {
                continue;
            }
            let score = sum / places as f32;
            if score < params.min_cosine {
                continue;
            }
            if score > best_a[s].0 {
                best_a[s] = (score, t);
            }
            if score > best_b[t].0 {
                best_b[t] = (score, s);
            }
        }
    }
    best_a
        .iter()
        .enumerate()
        .filter(|(s, (_, t))| best_b.get(*t).is_some_and(|(_, back)| back == s))
        .map(|(s, (score, t))| SegmentMatch {
            a: Observation::new(i, s),
            b: Observation::new(j, *t),
            score: *score,
        })
        .collect()
}

/// The sample of a segment that is nearest to a share of its length; empty when there are none.
fn sample_at(rows: &[f32], channels: usize, share: f64) -> &[f32] {
    let samples = rows.len() / channels;
    let at = (share.clamp(0.0, 1.0) * samples.saturating_sub(1) as f64).round() as usize;
    rows.get(at * channels..(at + 1) * channels).unwrap_or(&[])
}

/// Joins matched segments, best match first.
pub(super) fn join(views: &[PosedView<'_>], matches: &[SegmentMatch]) -> Vec<Vec<Observation>> {
    let mut first = vec![0u32];
    let mut next = 0u32;
    for view in views {
        next += view.segment_ends.len() as u32;
        first.push(next);
    }
    let node = |o: Observation| first[o.view as usize] + o.feature;
    let mut parent: Vec<u32> = (0..next).collect();
    let mut size = vec![1u32; next as usize];
    let mut sorted = matches.to_vec();
    sort_by(&mut sorted, |x, y| {
        y.score
            .total_cmp(&x.score)
            .then((x.a, x.b).cmp(&(y.a, y.b)))
    });
    // A wrong match joins two lines; the robust fit takes them apart again, so sets may grow, but not without end.
    const MAX_SIZE: u32 = 400;
    for m in &sorted {
        let (a, b) = (root(&mut parent, node(m.a)), root(&mut parent, node(m.b)));
        if a != b && size[a as usize] + size[b as usize] <= MAX_SIZE {
            let (small, large) = if size[a as usize] < size[b as usize] {
                (a, b)
            } else {
                (b, a)
            };
            parent[small as usize] = large;
            size[large as usize] += size[small as usize];
        }
    }
    let mut members: Vec<Vec<Observation>> = vec![Vec::new(); next as usize];
    for (v, view) in views.iter().enumerate() {
        for s in 0..view.segment_ends.len() {
            let o = Observation::new(v, s);
            members[root(&mut parent, node(o)) as usize].push(o);
        }
    }
    members.retain(|m| m.len() >= 2);
    members
}
