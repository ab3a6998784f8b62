//! The line of a set of segments: robustly found, refined, cut to what was seen.

use super::super::{LineTrack, Observation, PosedView};
use super::LineParams;
use super::world_line::{SegmentPlane, WorldLine, covered, line_error_px, segment_plane};
use crate::math::least_squares::{Damping, LeastSquares, Normal, minimize};
use crate::math::stats::quantile_in_place;
use crate::math::{Rng, elementary};
use nalgebra::{Matrix3, Vector3, Vector4};

/// All lines of a set of segments, best first; what fits none is left out.
pub(super) fn robust(
    views: &[PosedView<'_>],
    component: &[Observation],
    params: &LineParams,
    seed: u64,
) -> Vec<LineTrack> {
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
    views: &[PosedView<'_>],
    observations: &[Observation],
    params: &LineParams,
    rng: &mut Rng,
) -> Option<Vec<Observation>> {
    let planes: Vec<Option<SegmentPlane>> = observations
        .iter()
        .map(|o| segment_plane(&views[o.view as usize], o.feature as usize))
        .collect();
    let n = observations.len();
    let min_sin = elementary::sin(params.min_plane_angle_deg.to_radians());
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
            .map(|o| {
                line_error_px(&views[o.view as usize], o.feature as usize, &line)
                    .powi(2)
                    .min(limit_sq)
            })
            .sum();
        if best.as_ref().is_none_or(|(least, _)| score < *least) {
            best = Some((score, line));
        }
    }
    let (_, line) = best?;
    let inliers: Vec<Observation> = observations
        .iter()
        .copied()
        .filter(|o| {
            line_error_px(&views[o.view as usize], o.feature as usize, &line) <= params.max_error_px
        })
        .collect();
    (inliers.len() >= 2).then_some(inliers)
}

/// Fits a line to observations, drops what does not fit, cuts the line to what was seen.
pub(super) fn settle(
    views: &[PosedView<'_>],
    observations: &[Observation],
    params: &LineParams,
) -> Option<LineTrack> {
    let mut inliers = observations.to_vec();
    inliers.sort_unstable();
    inliers.dedup();
    let mut line = initial_line(views, &inliers)?;
    for _ in 0..3 {
        line = refine(views, &inliers, line);
        let before = inliers.len();
        inliers.retain(|o| {
            let (view, segment) = (&views[o.view as usize], o.feature as usize);
            line_error_px(view, segment, &line) <= params.max_error_px
                && covered(view, segment, &line).is_some()
        });
        if inliers.len() == before {
            break;
        }
    }
    let num_views = {
        let mut seen: Vec<u32> = inliers.iter().map(|o| o.view).collect();
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
        .filter_map(|o| covered(&views[o.view as usize], o.feature as usize, &line))
        .collect();
    let mut lows: Vec<f64> = ranges.iter().map(|r| r.0).collect();
    let mut highs: Vec<f64> = ranges.iter().map(|r| r.1).collect();
    let low = quantile_in_place(&mut lows, 0.2)?;
    let high = quantile_in_place(&mut highs, 0.8)?;
    if !(high > low) {
        return None;
    }
    // What covers nothing of the cut line is another line on the same straight: it goes.
    let kept: Vec<Observation> = inliers
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
    let ends = [low, high].map(|at| line.point + at * line.direction);
    Some(LineTrack::new(ends, kept))
}

fn widest_plane_angle(views: &[PosedView<'_>], observations: &[Observation]) -> f64 {
    let normals: Vec<Vector3<f64>> = observations
        .iter()
        .filter_map(|o| Some(segment_plane(&views[o.view as usize], o.feature as usize)?.normal))
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
    let sin = sin_to(&edge).0.min(1.0);
    elementary::atan2(sin, (1.0 - sin * sin).sqrt())
}

/// The line that lies nearest to all observation planes: direction from the smallest spread of normals, point by least
/// squares. Close enough for [`refine`].
fn initial_line(views: &[PosedView<'_>], observations: &[Observation]) -> Option<WorldLine> {
    let planes: Vec<SegmentPlane> = observations
        .iter()
        .filter_map(|o| segment_plane(&views[o.view as usize], o.feature as usize))
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

/// Least squares, under Cauchy's loss of one pixel, on the distances of observed ends to the projected line.
fn refine(views: &[PosedView<'_>], observations: &[Observation], start: WorldLine) -> WorldLine {
    // Support points where the observations are, so that both degrees of freedom per point are well determined.
    let mut places: Vec<f64> = observations
        .iter()
        .filter_map(|o| covered(&views[o.view as usize], o.feature as usize, &start))
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
    let support = Support {
        point: start.point + low * start.direction,
        direction: start.direction,
        length: high - low,
    };
    let mut problem = LineProblem {
        views,
        observations,
    };
    let (found, _) = minimize(&mut problem, support, &Damping::default(), || false);
    WorldLine {
        point: found.point,
        direction: found.direction,
    }
}

/// A line by two points of it.
#[derive(Debug, Clone, Copy)]
struct Support {
    point: Vector3<f64>,
    direction: Vector3<f64>,
    length: f64,
}

impl Support {
    fn ends(&self) -> [Vector3<f64>; 2] {
        [self.point, self.point + self.length * self.direction]
    }

    /// Two directions across the line, in which its points may move.
    fn across(&self) -> [Vector3<f64>; 2] {
        let helper = if self.direction.x.abs() < 0.7 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let across = self.direction.cross(&helper).normalize();
        [across, self.direction.cross(&across)]
    }
}

/// The four degrees of freedom of a line: two points of it, each moving across it.
struct LineProblem<'a> {
    views: &'a [PosedView<'a>],
    observations: &'a [Observation],
}

impl LeastSquares for LineProblem<'_> {
    type Parameters = Support;
    type Normal = Normal<4>;
    type Step = Vector4<f64>;

    fn normal(&mut self, at: &Support) -> Normal<4> {
        let mut normal = Normal::default();
        let [across, up] = at.across();
        let ends = at.ends();
        for o in self.observations {
            let view = &self.views[o.view as usize];
            let Some(seen) = view.segment_ends.get(o.feature as usize) else {
                continue;
            };
            let r = &view.cam_from_world.rotation;
            let [p, q] = ends.map(|end| view.cam_from_world.transform_point(&end));
            let plane = p.cross(&q);
            let norm = plane.xy().norm();
            if !(norm > 1e-12) {
                continue;
            }
            let unit = plane.xy() / norm;
            for end in seen {
                let x = end.push(1.0);
                let f = view.focal_px;
                let distance = f * plane.dot(&x) / norm;
                // d(plane) = dp x q + p x dq; the norm changes too.
                let by_plane =
                    f * (x / norm) - (distance / norm) * Vector3::new(unit.x, unit.y, 0.0);
                let by_p = q.cross(&by_plane);
                let by_q = by_plane.cross(&p);
                let row = Vector4::new(
                    by_p.dot(&(r * across)),
                    by_p.dot(&(r * up)),
                    by_q.dot(&(r * across)),
                    by_q.dot(&(r * up)),
                );
                normal.add(&row, distance, 1.0 / (1.0 + distance * distance));
                normal.cost += 0.5 * elementary::ln_1p(distance * distance);
            }
        }
        normal
    }

    fn cost(&self, normal: &Normal<4>) -> f64 {
        normal.cost
    }

    fn step(&self, normal: &Normal<4>, lambda: f64) -> Option<Vector4<f64>> {
        normal.step(lambda)
    }

    fn step_sq(&self, step: &Vector4<f64>) -> f64 {
        step.norm_squared()
    }

    fn moved(&self, at: &Support, step: &Vector4<f64>) -> Support {
        let [across, up] = at.across();
        let [p, q] = at.ends();
        let point = p + across * step[0] + up * step[1];
        let along = q + across * step[2] + up * step[3] - point;
        let length = along.norm();
        Support {
            point,
            direction: along / length,
            length,
        }
    }

    fn is_usable(&self, at: &Support) -> bool {
        at.length > 1e-9
    }
}
