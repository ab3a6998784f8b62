//! Line tracks: segments matched under the known epipolar geometry, joined, triangulated robustly as infinite lines,
//! cut to what was seen, completed by projection.
//!
//! A segment's ends are where the detector stopped, not where the line stops, so only infinite lines are compared. What
//! two segments share is found with the poses: the epipolar lines of one segment's ends cut the other segment's line.

use super::View;
use super::matching::essential;
use landline::math::Rng;
use landline::math::stats::quantile_in_place;
use nalgebra::{DVectorView, Matrix3, Vector2, Vector3};
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

/// An infinite line in the world.
#[derive(Debug, Clone, Copy)]
struct WorldLine {
    point: Vector3<f64>,
    direction: Vector3<f64>,
}

impl WorldLine {
    /// Where two planes cut each other, with the sine of their angle.
    fn from_planes(a: &SegmentPlane, b: &SegmentPlane) -> Option<(Self, f64)> {
        let cross = a.normal.cross(&b.normal);
        let sin = cross.norm();
        if !(sin > 1e-9) {
            return None;
        }
        let direction = cross / sin;
        // The point of both planes that is nearest to the middle of the two cameras.
        let middle = 0.5 * (a.center + b.center);
        let rows = Matrix3::from_rows(&[
            a.normal.transpose(),
            b.normal.transpose(),
            direction.transpose(),
        ]);
        let right = Vector3::new(
            a.normal.dot(&a.center),
            b.normal.dot(&b.center),
            direction.dot(&middle),
        );
        let point = rows.lu().solve(&right)?;
        Some((Self { point, direction }, sin))
    }

    /// The place on this line nearest to a ray, as a distance along the direction.
    fn nearest_to_ray(&self, origin: &Vector3<f64>, ray: &Vector3<f64>) -> Option<f64> {
        let between = origin - self.point;
        let cos = self.direction.dot(ray);
        let det = 1.0 - cos * cos;
        if !(det > 1e-9) {
            return None;
        }
        Some((between.dot(&self.direction) - cos * between.dot(ray)) / det)
    }
}

/// The plane through a camera and a segment that it sees.
#[derive(Debug, Clone, Copy)]
struct SegmentPlane {
    center: Vector3<f64>,
    normal: Vector3<f64>,
}

fn segment_plane(view: &View, segment: usize) -> Option<SegmentPlane> {
    let ends = view.segment_ends.get(segment)?;
    let a = view.ray_through(&ends[0]);
    let b = view.ray_through(&ends[1]);
    let normal = a.direction.cross(&b.direction).try_normalize(1e-9)?;
    Some(SegmentPlane {
        center: view.center_in_world,
        normal,
    })
}

/// Two segments, each (view, segment), that may show the same line.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SegmentMatch {
    a: (u32, u32),
    b: (u32, u32),
    score: f32,
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
            let found = match_pair(views, i, j, depth, params);
            done();
            found
        })
        .collect();
    let components = join(views, &matches);
    let mut tracks: Vec<SegmentTrack> = components
        .par_iter()
        .enumerate()
        .flat_map_iter(|(seed, component)| robust(views, component, params, seed as u64))
        .collect();
    tracks = merge(views, tracks, params);
    by_projection(views, &mut tracks, params);
    tracks
        .into_par_iter()
        .filter_map(|t| settle(views, &t.observations, params))
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

/// Where a line of the plane, through `p` and `q`, is cut by another one (homogeneous), as the share from p to q.
fn cut(p: &Vector2<f64>, q: &Vector2<f64>, line: &Vector3<f64>) -> Option<f64> {
    let at_p = line.dot(&p.push(1.0));
    let at_q = line.dot(&q.push(1.0));
    let slope = at_p - at_q;
    (slope.abs() > 1e-12).then(|| at_p / slope)
}

fn match_pair(
    views: &[View],
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
    let samples_a = a.segment_descriptors_dn.ncols() / n_a;
    let samples_b = b.segment_descriptors_dn.ncols() / n_b;
    let sin_limit = params.min_epipolar_angle_deg.to_radians().sin();
    let mut best_a: Vec<(f32, usize)> = vec![(0.0, usize::MAX); n_a];
    let mut best_b: Vec<(f32, usize)> = vec![(0.0, usize::MAX); n_b];
    for (s, ends_a) in a.segment_ends.iter().enumerate() {
        let epipolar = ends_a.map(|p| e * p.push(1.0));
        let Some(plane_a) = segment_plane(a, s) else {
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
            let Some(plane_b) = segment_plane(b, t) else {
                continue;
            };
            let Some((line, sin)) = WorldLine::from_planes(&plane_a, &plane_b) else {
                continue;
            };
            if sin < params.min_plane_angle_deg.to_radians().sin() * 0.5
                || !lies_in_front(a, &line, ends_a, depth)
                || !lies_in_front(b, &line, ends_b, depth)
            {
                continue;
            }
            // Descriptors at five places of the shared part, each place found in `a` through the epipolar line of
            // its place in `b`.
            let mut sum = 0.0;
            let mut places = 0;
            for k in 0..5 {
                let share_b = low + shared * (0.1 + 0.2 * f64::from(k));
                let place_b = ends_b[0] + along * share_b;
                let Some(share_a) = cut(&ends_a[0], &ends_a[1], &(e_back * place_b.push(1.0)))
                else {
                    continue;
                };
                let column = |share: f64, samples: usize, segment: usize| {
                    let at = (share.clamp(0.0, 1.0) * (samples - 1) as f64).round() as usize;
                    segment * samples + at
                };
                let d_a = a
                    .segment_descriptors_dn
                    .column(column(share_a, samples_a, s));
                let d_b = b
                    .segment_descriptors_dn
                    .column(column(share_b, samples_b, t));
                sum += dot(d_a, d_b);
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
            a: (i as u32, s as u32),
            b: (j as u32, *t as u32),
            score: *score,
        })
        .collect()
}

fn dot(a: DVectorView<'_, f32>, b: DVectorView<'_, f32>) -> f32 {
    a.iter().zip(b.iter()).map(|(x, y)| x * y).sum()
}

/// Whether the line lies in front of a view, at a believable depth, where the segment is.
fn lies_in_front(view: &View, line: &WorldLine, ends: &[Vector2<f64>; 2], depth: f64) -> bool {
    ends.iter().all(|end| {
        let ray = view.ray_through(end);
        line.nearest_to_ray(&ray.origin, &ray.direction)
            .map(|s| line.point + s * line.direction)
            .is_some_and(|p| {
                let z = view.cam_from_world.transform_point(&p).z;
                z > 0.05 * depth && z < 10.0 * depth
            })
    })
}

/// Joins matched segments, best match first.
fn join(views: &[View], matches: &[SegmentMatch]) -> Vec<Vec<(u32, u32)>> {
    let mut first = vec![0u32];
    let mut next = 0u32;
    for view in views {
        next += view.segment_ends.len() as u32;
        first.push(next);
    }
    let node = |(view, segment): (u32, u32)| first[view as usize] + segment;
    let mut parent: Vec<u32> = (0..next).collect();
    let mut size = vec![1u32; next as usize];
    let mut sorted = matches.to_vec();
    sorted.sort_unstable_by(|x, y| {
        y.score
            .total_cmp(&x.score)
            .then((x.a, x.b).cmp(&(y.a, y.b)))
    });
    // A wrong match joins two lines; the robust fit takes them apart again, so sets may grow, but not without end.
    const MAX_SIZE: u32 = 400;
    for m in &sorted {
        let (a, b) = (
            super::points::root(&mut parent, node(m.a)),
            super::points::root(&mut parent, node(m.b)),
        );
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
    let mut members: Vec<Vec<(u32, u32)>> = vec![Vec::new(); next as usize];
    for (v, view) in views.iter().enumerate() {
        for s in 0..view.segment_ends.len() {
            let o = (v as u32, s as u32);
            members[super::points::root(&mut parent, node(o)) as usize].push(o);
        }
    }
    members.retain(|m| m.len() >= 2);
    members
}

/// Largest distance in pixels of a segment's ends from the projected line; infinite when the line is not in view.
fn line_error_px(view: &View, segment: usize, line: &WorldLine) -> f64 {
    let Some(ends) = view.segment_ends.get(segment) else {
        return f64::INFINITY;
    };
    let Some(image_line) = project(view, line) else {
        return f64::INFINITY;
    };
    ends.iter()
        .map(|p| image_line.dot(&p.push(1.0)).abs() * view.focal_px)
        .fold(0.0, f64::max)
}

/// The line on the plane z = 1, with a unit normal.
fn project(view: &View, line: &WorldLine) -> Option<Vector3<f64>> {
    let p = view.cam_from_world.transform_point(&line.point);
    let d = view.cam_from_world.rotation * line.direction;
    let normal = p.cross(&d);
    let norm = normal.xy().norm();
    (norm > 1e-12).then(|| normal / norm)
}

/// Range along the line that a segment covers.
fn covered(view: &View, segment: usize, line: &WorldLine) -> Option<(f64, f64)> {
    let ends = view.segment_ends.get(segment)?;
    let mut range = [0.0; 2];
    for (value, end) in range.iter_mut().zip(ends) {
        let ray = view.ray_through(end);
        *value = line.nearest_to_ray(&ray.origin, &ray.direction)?;
        let z = view
            .cam_from_world
            .transform_point(&(line.point + *value * line.direction))
            .z;
        if !(z > 0.0) {
            return None;
        }
    }
    Some((range[0].min(range[1]), range[0].max(range[1])))
}

fn robust(
    views: &[View],
    component: &[(u32, u32)],
    params: &LineParams,
    seed: u64,
) -> Vec<SegmentTrack> {
    let mut rest = component.to_vec();
    let mut tracks = Vec::new();
    let mut rng = Rng::from_seed(seed);
    while rest.len() >= params.min_views {
        let Some(inliers) = best_line(views, &rest, params, &mut rng) else {
            break;
        };
        let Some(track) = settle(views, &inliers, params) else {
            break;
        };
        rest.retain(|o| !track.observations.contains(o));
        tracks.push(track);
    }
    tracks
}

/// The line of two segments that most others agree with; returns who agrees.
fn best_line(
    views: &[View],
    observations: &[(u32, u32)],
    params: &LineParams,
    rng: &mut Rng,
) -> Option<Vec<(u32, u32)>> {
    let planes: Vec<Option<SegmentPlane>> = observations
        .iter()
        .map(|(v, s)| segment_plane(&views[*v as usize], *s as usize))
        .collect();
    let n = observations.len();
    let min_sin = params.min_plane_angle_deg.to_radians().sin();
    let mut best: Option<(f64, WorldLine)> = None;
    const MAX_PAIRS: usize = 60;
    let all = n * (n - 1) / 2;
    let mut pairs = Vec::with_capacity(MAX_PAIRS);
    if all <= MAX_PAIRS {
        pairs.extend((0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))));
    } else {
        pairs.extend((0..MAX_PAIRS).map(|_| {
            let i = rng.below(n as u32) as usize;
            let j = rng.below(n as u32 - 1) as usize;
            (i, j + usize::from(j >= i))
        }));
    }
    let limit_sq = params.max_error_px * params.max_error_px;
    for (i, j) in pairs {
        let (Some(a), Some(b)) = (&planes[i], &planes[j]) else {
            continue;
        };
        let Some((line, sin)) = WorldLine::from_planes(a, b) else {
            continue;
        };
        if sin < min_sin {
            continue;
        }
        let score: f64 = observations
            .iter()
            .map(|(v, s)| {
                line_error_px(&views[*v as usize], *s as usize, &line)
                    .powi(2)
                    .min(limit_sq)
            })
            .sum();
        if best.as_ref().is_none_or(|(least, _)| score < *least) {
            best = Some((score, line));
        }
    }
    let (_, line) = best?;
    let inliers: Vec<(u32, u32)> = observations
        .iter()
        .copied()
        .filter(|(v, s)| {
            line_error_px(&views[*v as usize], *s as usize, &line) <= params.max_error_px
        })
        .collect();
    (inliers.len() >= 2).then_some(inliers)
}

/// Fits a line to observations, drops what does not fit, cuts the line to what was seen.
fn settle(
    views: &[View],
    observations: &[(u32, u32)],
    params: &LineParams,
) -> Option<SegmentTrack> {
    let mut inliers = observations.to_vec();
    inliers.sort_unstable();
    inliers.dedup();
    let mut line = initial_line(views, &inliers)?;
    for _ in 0..3 {
        line = refine(views, &inliers, line);
        let before = inliers.len();
        inliers.retain(|(v, s)| {
            let view = &views[*v as usize];
            line_error_px(view, *s as usize, &line) <= params.max_error_px
                && covered(view, *s as usize, &line).is_some()
        });
        if inliers.len() == before {
            break;
        }
    }
    let num_views = {
        let mut seen: Vec<u32> = inliers.iter().map(|(v, _)| *v).collect();
        seen.dedup();
        seen.len()
    };
    if num_views < params.min_views
        || widest_plane_angle(views, &inliers) < params.min_plane_angle_deg.to_radians()
    {
        return None;
    }
    // Ends: a fifth of the observations may claim more than the others, at either end, without moving them.
    let ranges: Vec<(f64, f64)> = inliers
        .iter()
        .filter_map(|(v, s)| covered(&views[*v as usize], *s as usize, &line))
        .collect();
    let mut lows: Vec<f64> = ranges.iter().map(|r| r.0).collect();
    let mut highs: Vec<f64> = ranges.iter().map(|r| r.1).collect();
    let low = quantile_in_place(&mut lows, 0.2)?;
    let high = quantile_in_place(&mut highs, 0.8)?;
    if !(high > low) {
        return None;
    }
    // What covers nothing of the cut line is another line on the same straight: it goes.
    let kept: Vec<(u32, u32)> = inliers
        .iter()
        .zip(&ranges)
        .filter(|(_, (from, to))| {
            let shared = to.min(high) - from.max(low);
            shared >= 0.5 * (to - from).min(high - low)
        })
        .map(|(o, _)| *o)
        .collect();
    if kept.len() < params.min_views {
        return None;
    }
    Some(SegmentTrack {
        start_in_world: line.point + low * line.direction,
        end_in_world: line.point + high * line.direction,
        observations: kept,
    })
}

fn widest_plane_angle(views: &[View], observations: &[(u32, u32)]) -> f64 {
    let normals: Vec<Vector3<f64>> = observations
        .iter()
        .filter_map(|(v, s)| Some(segment_plane(&views[*v as usize], *s as usize)?.normal))
        .collect();
    let Some(first) = normals.first() else {
        return 0.0;
    };
    let sin_to = |from: &Vector3<f64>| {
        normals
            .iter()
            .map(|n| (from.cross(n).norm(), *n))
            .fold(
                (0.0, *from),
                |best, next| if next.0 > best.0 { next } else { best },
            )
    };
    let (_, edge) = sin_to(first);
    sin_to(&edge).0.min(1.0).asin()
}

/// The line that lies nearest to all observation planes: direction from the smallest spread of normals, point by least
/// squares. Close enough for [`refine`].
fn initial_line(views: &[View], observations: &[(u32, u32)]) -> Option<WorldLine> {
    let planes: Vec<SegmentPlane> = observations
        .iter()
        .filter_map(|(v, s)| segment_plane(&views[*v as usize], *s as usize))
        .collect();
    if planes.len() < 2 {
        return None;
    }
    let scatter: Matrix3<f64> = planes.iter().map(|p| p.normal * p.normal.transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let direction: Vector3<f64> = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    let middle = planes.iter().map(|p| p.center).sum::<Vector3<f64>>() / planes.len() as f64;
    let mut left = direction * direction.transpose();
    let mut right = direction * direction.dot(&middle);
    for p in &planes {
        left += p.normal * p.normal.transpose();
        right += p.normal * p.normal.dot(&p.center);
    }
    let point = left.lu().solve(&right)?;
    Some(WorldLine { point, direction })
}

/// Gauss-Newton on the distances of observed ends to the projected line, over the four degrees of freedom of a line:
/// two support points, each moving across the line.
fn refine(views: &[View], observations: &[(u32, u32)], start: WorldLine) -> WorldLine {
    // Support points where the observations are, so that both degrees of freedom per point are well determined.
    let mut places: Vec<f64> = observations
        .iter()
        .filter_map(|(v, s)| covered(&views[*v as usize], *s as usize, &start))
        .flat_map(|(a, b)| [a, b])
        .collect();
    let (Some(low), Some(high)) = (
        quantile_in_place(&mut places, 0.1),
        quantile_in_place(&mut places, 0.9),
    ) else {
        return start;
    };
    if !(high > low) {
        return start;
    }
    let mut line = WorldLine {
        point: start.point + low * start.direction,
        direction: start.direction,
    };
    let mut length = high - low;
    for _ in 0..8 {
        let helper = if line.direction.x.abs() < 0.7 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let across = line.direction.cross(&helper).normalize();
        let up = line.direction.cross(&across);
        let ends = [line.point, line.point + length * line.direction];
        let mut hessian = nalgebra::Matrix4::<f64>::zeros();
        let mut gradient = nalgebra::Vector4::<f64>::zeros();
        for &(v, s) in observations {
            let view = &views[v as usize];
            let Some(seen) = view.segment_ends.get(s as usize) else {
                continue;
            };
            let r = &view.cam_from_world.rotation;
            let (p, q) = (
                view.cam_from_world.transform_point(&ends[0]),
                view.cam_from_world.transform_point(&ends[1]),
            );
            let normal = p.cross(&q);
            let norm = normal.xy().norm();
            if !(norm > 1e-12) {
                continue;
            }
            for end in seen {
                let x = end.push(1.0);
                let f = view.focal_px;
                let distance = f * normal.dot(&x) / norm;
                // d(normal) = dp x q + p x dq; the norm changes too.
                let unit = normal.xy() / norm;
                let by_normal =
                    f * (x / norm) - (distance / norm) * Vector3::new(unit.x, unit.y, 0.0);
                let by_p = q.cross(&by_normal);
                let by_q = by_normal.cross(&p);
                let j = nalgebra::Vector4::new(
                    by_p.dot(&(r * across)),
                    by_p.dot(&(r * up)),
                    by_q.dot(&(r * across)),
                    by_q.dot(&(r * up)),
                );
                let weight = 1.0 / (1.0 + distance * distance);
                hessian += weight * j * j.transpose();
                gradient += weight * distance * j;
            }
        }
        for i in 0..4 {
            hessian[(i, i)] *= 1.0 + 1e-6;
        }
        let Some(step) = hessian.cholesky().map(|c| c.solve(&gradient)) else {
            break;
        };
        let moved = [
            ends[0] - across * step[0] - up * step[1],
            ends[1] - across * step[2] - up * step[3],
        ];
        let along = moved[1] - moved[0];
        length = along.norm();
        if !(length > 1e-9) {
            return start;
        }
        line = WorldLine {
            point: moved[0],
            direction: along / length,
        };
        if step.norm() < 1e-7 * length {
            break;
        }
    }
    line
}

fn line_of(track: &SegmentTrack) -> Option<WorldLine> {
    let direction = (track.end_in_world - track.start_in_world).try_normalize(1e-9)?;
    Some(WorldLine {
        point: track.start_in_world,
        direction,
    })
}

/// Joins tracks that are the same line: nearly all observations of the shorter one fit the longer one, and they overlap
/// or nearly touch.
fn merge(views: &[View], mut tracks: Vec<SegmentTrack>, params: &LineParams) -> Vec<SegmentTrack> {
    tracks.sort_by_key(|t| std::cmp::Reverse(t.observations.len()));
    let mut merged: Vec<SegmentTrack> = Vec::new();
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
                .filter(|(v, s)| {
                    line_error_px(&views[*v as usize], *s as usize, &line) <= params.max_error_px
                })
                .count();
            if fits * 10 < track.observations.len() * 7 {
                continue;
            }
            let mut all = target.observations.clone();
            all.extend(&track.observations);
            if let Some(joined) = settle(views, &all, params) {
                if joined.observations.len() * 10 >= all.len() * 8 {
                    *target = joined;
                    taken = true;
                    break;
                }
            }
        }
        if !taken {
            merged.push(track);
        }
    }
    merged
}

/// Adds segments that no match found: unowned, within the error of a projected line that was seen from a similar
/// direction, and covering it.
fn by_projection(views: &[View], tracks: &mut [SegmentTrack], params: &LineParams) {
    let mut owned: Vec<Vec<bool>> = views
        .iter()
        .map(|v| vec![false; v.segment_ends.len()])
        .collect();
    for track in tracks.iter() {
        for (v, s) in &track.observations {
            owned[*v as usize][*s as usize] = true;
        }
    }
    let lines: Vec<Option<WorldLine>> = tracks.iter().map(line_of).collect();
    let descriptors: Vec<nalgebra::DVector<f32>> = tracks
        .par_iter()
        .map(|t| mean_segment_descriptor(views, &t.observations))
        .collect();
    let found: Vec<Vec<(usize, (u32, u32))>> = views
        .par_iter()
        .enumerate()
        .map(|(v, view)| {
            let mut best: Vec<Option<(f64, usize)>> = vec![None; view.segment_ends.len()];
            for (t, (track, line)) in tracks.iter().zip(&lines).enumerate() {
                let Some(line) = line else { continue };
                let middle = 0.5 * (track.start_in_world + track.end_in_world);
                let offset = view.center_in_world - middle;
                let is_near = track.observations.iter().any(|(other, _)| {
                    let known = views[*other as usize].center_in_world - middle;
                    let (a, b) = (offset.norm(), known.norm());
                    offset.dot(&known) >= 0.94 * a * b && a < 1.5 * b && b < 1.5 * a
                });
                if !is_near {
                    continue;
                }
                let Some(image_line) = project(view, line) else {
                    continue;
                };
                let length = (track.end_in_world - track.start_in_world).norm();
                for (s, ends) in view.segment_ends.iter().enumerate() {
                    if owned[v][s] {
                        continue;
                    }
                    let error = ends
                        .iter()
                        .map(|p| image_line.dot(&p.push(1.0)).abs() * view.focal_px)
                        .fold(0.0, f64::max);
                    if error > params.max_error_px {
                        continue;
                    }
                    let Some((from, to)) = covered(view, s, line) else {
                        continue;
                    };
                    if to.min(length) - from.max(0.0) < 0.7 * (to - from).min(length) {
                        continue;
                    }
                    let own = mean_segment_descriptor(views, &[(v as u32, s as u32)]);
                    if own.dot(&descriptors[t]) < params.min_cosine {
                        continue;
                    }
                    if best[s].is_none_or(|(least, _)| error < least) {
                        best[s] = Some((error, t));
                    }
                }
            }
            best.iter()
                .enumerate()
                .filter_map(|(s, b)| b.map(|(_, t)| (t, (v as u32, s as u32))))
                .collect()
        })
        .collect();
    for (t, observation) in found.into_iter().flatten() {
        let observations = &mut tracks[t].observations;
        if let Err(at) = observations.binary_search(&observation) {
            observations.insert(at, observation);
        }
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
        let view = &views[*v as usize];
        let samples = view.segment_descriptors_dn.ncols() / view.segment_ends.len().max(1);
        for k in 0..samples {
            mean += view
                .segment_descriptors_dn
                .column(*s as usize * samples + k);
        }
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
    let Some(line) = line_of(track) else {
        return (f64::INFINITY, vec![false; track.observations.len()]);
    };
    let mut sum = 0.0;
    let reversed = track
        .observations
        .iter()
        .map(|(v, s)| {
            let view = &views[*v as usize];
            sum += line_error_px(view, *s as usize, &line);
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
