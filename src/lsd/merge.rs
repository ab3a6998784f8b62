//! Joining the fragments of one line.
//!
//! LSD breaks an edge where noise or a shadow interrupts it. Two segments are joined when they run in the same
//! direction (so that the two sides of a thin bar never are), lie on one line, follow each other within a short gap,
//! and no third segment crosses the gap. The choice of the thresholds is ours.

use crate::geometry::{Pixel, Segment2};
use crate::math::order::{sort_by, sort_by_key};
use std::collections::HashMap;

/// When two segments are fragments of one line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MergeParams {
    /// Largest angle between the directions, in degrees; below 90.
    pub max_angle_deg: f64,
    /// Largest distance of any end point from the common line, in pixels.
    pub max_offset_px: f64,
    /// Largest gap along the line, in pixels, for short segments.
    pub max_gap_px: f64,
    /// Largest gap as a share of the shorter segment's length, for long ones; overlaps are limited to the same.
    pub max_gap_share: f64,
}

impl Default for MergeParams {
    fn default() -> Self {
        Self {
            max_angle_deg: 2.5,
            max_offset_px: 1.25,
            max_gap_px: 3.0,
            max_gap_share: 0.1,
        }
    }
}

/// A segment and the detected segments that it is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// Fitted to the end points of the pieces. Width and significance are the largest of theirs, the precision is that
    /// of the longest piece. With one piece, the piece itself.
    pub segment: Segment2,
    /// Indices into the list that was given, the longest piece first.
    pub pieces: Vec<usize>,
}

/// Joins fragments, longest segments first. The result is ordered by the index of the longest piece; every input
/// segment is a piece of exactly one result. Parameters that are NaN or negative join nothing.
pub fn merge_collinear(segments: &[Segment2], params: &MergeParams) -> Vec<Merged> {
    let lengths: Vec<f64> = segments.iter().map(Segment2::length_px).collect();
    let mut by_length: Vec<usize> = (0..segments.len()).collect();
    sort_by(&mut by_length, |&a, &b| lengths[b].total_cmp(&lengths[a]));
    let ends = EndGrid::new(segments);
    let min_cos = libm::cos(params.max_angle_deg.to_radians());

    let mut is_free = vec![true; segments.len()];
    let mut merged = Vec::new();
    for &first in &by_length {
        if !is_free[first] {
            continue;
        }
        is_free[first] = false;
        let mut joined = Merged {
            segment: segments[first],
            pieces: vec![first],
        };
        while let Some((piece, segment)) = next_piece(
            &joined, segments, &lengths, &is_free, &ends, params, min_cos,
        ) {
            is_free[piece] = false;
            joined.pieces.push(piece);
            joined.segment = segment;
        }
        merged.push(joined);
    }
    sort_by_key(&mut merged, |m| m.pieces[0]);
    merged
}

/// The nearest free segment that continues `joined` at either end, and the segment with it.
fn next_piece(
    joined: &Merged,
    segments: &[Segment2],
    lengths: &[f64],
    is_free: &[bool],
    ends: &EndGrid,
    params: &MergeParams,
    min_cos: f64,
) -> Option<(usize, Segment2)> {
    let base = &joined.segment;
    let length = base.length_px();
    let reach = params.max_gap_px.max(params.max_gap_share * length);
    if !(reach >= 0.0 && length > 0.0 && params.max_offset_px >= 0.0) {
        return None;
    }
    let direction = unit(base);
    let mut best: Option<(f64, usize, Segment2)> = None;
    for at_end in [true, false] {
        let own = if at_end { base.end } else { base.start };
        for other in ends.near(own, reach + params.max_offset_px, at_end) {
            let candidate = &segments[other];
            if !is_free[other] || dot(direction, unit(candidate)) < min_cos {
                continue;
            }
            let facing = if at_end {
                candidate.start
            } else {
                candidate.end
            };
            let step = [facing.x - own.x, facing.y - own.y];
            let along = dot(direction, step) * if at_end { 1.0 } else { -1.0 };
            let limit = params
                .max_gap_px
                .max(params.max_gap_share * lengths[other].min(length));
            if along.abs() > limit || best.is_some_and(|b| b.0 <= along.abs()) {
                continue;
            }
            let mut pieces = joined.pieces.clone();
            pieces.push(other);
            let fitted = fit(&pieces, segments, lengths);
            let is_on_line = pieces.iter().all(|&p| {
                offset(&fitted, segments[p].start).max(offset(&fitted, segments[p].end))
                    <= params.max_offset_px
            });
            let is_crossed = || {
                segments
                    .iter()
                    .enumerate()
                    .any(|(i, s)| !pieces.contains(&i) && crosses(s, own, facing))
            };
            if is_on_line && !is_crossed() {
                best = Some((along.abs(), other, fitted));
            }
        }
    }
    best.map(|(_, piece, segment)| (piece, segment))
}

/// The line of least squared distances to the end points, weighted by length, cut at the outermost projections.
fn fit(pieces: &[usize], segments: &[Segment2], lengths: &[f64]) -> Segment2 {
    let longest = &segments[pieces[0]];
    let points = || {
        pieces
            .iter()
            .flat_map(|&p| [segments[p].start, segments[p].end].map(|pixel| (pixel, lengths[p])))
    };
    let total: f64 = points().map(|(_, w)| w).sum();
    let cx = points().map(|(p, w)| w * p.x).sum::<f64>() / total;
    let cy = points().map(|(p, w)| w * p.y).sum::<f64>() / total;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for (p, w) in points() {
        let (dx, dy) = (p.x - cx, p.y - cy);
        xx += w * dx * dx;
        xy += w * dx * dy;
        yy += w * dy * dy;
    }
    let (sin, cos) = libm::sincos(0.5 * libm::atan2(2.0 * xy, xx - yy));
    let sign = if dot([cos, sin], unit(longest)) < 0.0 {
        -1.0
    } else {
        1.0
    };
    let axis = [sign * cos, sign * sin];
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (p, _) in points() {
        let along = dot(axis, [p.x - cx, p.y - cy]);
        low = low.min(along);
        high = high.max(along);
    }
    let at = |t: f64| Pixel::new(cx + t * axis[0], cy + t * axis[1]);
    let largest = |value: fn(&Segment2) -> f64| {
        pieces
            .iter()
            .map(|&p| value(&segments[p]))
            .fold(f64::NEG_INFINITY, f64::max)
    };
    Segment2 {
        start: at(low),
        end: at(high),
        width_px: largest(|s| s.width_px),
        precision: longest.precision,
        neg_log10_nfa: largest(|s| s.neg_log10_nfa),
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Direction of a segment; NaN, which compares as not aligned, when it has no length.
fn unit(s: &Segment2) -> [f64; 2] {
    let length = s.length_px();
    [
        (s.end.x - s.start.x) / length,
        (s.end.y - s.start.y) / length,
    ]
}

/// Distance of a point from the segment's line.
fn offset(line: &Segment2, p: Pixel) -> f64 {
    let [dx, dy] = unit(line);
    (dx * (p.y - line.start.y) - dy * (p.x - line.start.x)).abs()
}

/// Whether the segment properly crosses the piece of line from `a` to `b`.
fn crosses(s: &Segment2, a: Pixel, b: Pixel) -> bool {
    let side = |from: Pixel, to: Pixel, p: Pixel| {
        (to.x - from.x) * (p.y - from.y) - (to.y - from.y) * (p.x - from.x)
    };
    side(a, b, s.start) * side(a, b, s.end) < 0.0
        && side(s.start, s.end, a) * side(s.start, s.end, b) < 0.0
}

/// End points by cells of a grid.
struct EndGrid {
    starts: HashMap<(i32, i32), Vec<usize>>,
    ends: HashMap<(i32, i32), Vec<usize>>,
}

impl EndGrid {
    const CELL_PX: f64 = 16.0;

    fn cell(p: Pixel) -> (i32, i32) {
        (
            libm::floor(p.x / Self::CELL_PX) as i32,
            libm::floor(p.y / Self::CELL_PX) as i32,
        )
    }

    fn new(segments: &[Segment2]) -> Self {
        let mut grid = Self {
            starts: HashMap::new(),
            ends: HashMap::new(),
        };
        for (i, s) in segments.iter().enumerate() {
            grid.starts.entry(Self::cell(s.start)).or_default().push(i);
            grid.ends.entry(Self::cell(s.end)).or_default().push(i);
        }
        grid
    }

    /// Segments whose start (or end) lies in the cells within `radius` of `p`.
    fn near(&self, p: Pixel, radius: f64, starts: bool) -> impl Iterator<Item = usize> {
        let (low, high) = (
            Self::cell(Pixel::new(p.x - radius, p.y - radius)),
            Self::cell(Pixel::new(p.x + radius, p.y + radius)),
        );
        let cells = if starts { &self.starts } else { &self.ends };
        (low.0..=high.0)
            .flat_map(move |cx| (low.1..=high.1).map(move |cy| (cx, cy)))
            .filter_map(move |cell| cells.get(&cell))
            .flatten()
            .copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(x1: f64, y1: f64, x2: f64, y2: f64) -> Segment2 {
        Segment2 {
            start: Pixel::new(x1, y1),
            end: Pixel::new(x2, y2),
            width_px: 2.0,
            precision: 0.125,
            neg_log10_nfa: x1,
        }
    }

    fn pieces(segments: &[Segment2]) -> Vec<Vec<usize>> {
        merge_collinear(segments, &MergeParams::default())
            .into_iter()
            .map(|m| m.pieces)
            .collect()
    }

    #[test]
    fn three_fragments_become_one() {
        let s = [
            segment(0.0, 10.0, 20.0, 10.0),
            segment(52.0, 10.4, 90.0, 10.5),
            segment(22.0, 10.2, 50.0, 10.3),
        ];
        let merged = merge_collinear(&s, &MergeParams::default());
        assert_eq!(merged.len(), 1);
        assert_eq!(merged[0].pieces, [1, 2, 0]);
        let whole = merged[0].segment;
        assert!(
            whole.start.distance(Pixel::new(0.0, 10.05)) < 0.1,
            "{whole:?}"
        );
        assert!(
            whole.end.distance(Pixel::new(90.0, 10.5)) < 0.1,
            "{whole:?}"
        );
        assert_eq!(whole.neg_log10_nfa, 52.0);
    }

    #[test]
    fn what_must_stay_apart_stays_apart() {
        let cases = [
            (
                "two sides of a bar",
                [segment(0.0, 0.0, 40.0, 0.0), segment(80.0, 1.0, 42.0, 1.0)],
            ),
            (
                "a wide gap",
                [segment(0.0, 0.0, 40.0, 0.0), segment(45.0, 0.0, 90.0, 0.0)],
            ),
            (
                "a bend",
                [segment(0.0, 0.0, 40.0, 0.0), segment(42.0, 0.0, 80.0, 4.0)],
            ),
            (
                "a step",
                [segment(0.0, 0.0, 40.0, 0.0), segment(42.0, 3.0, 80.0, 3.0)],
            ),
        ];
        for (name, s) in cases {
            assert_eq!(pieces(&s), [[0], [1]], "{name}");
        }
        let crossed = [
            segment(0.0, 0.0, 40.0, 0.0),
            segment(43.0, 0.0, 80.0, 0.0),
            segment(41.5, -9.0, 41.0, 9.0),
        ];
        assert_eq!(pieces(&crossed), [[0], [1], [2]]);
        assert_eq!(pieces(&crossed[..2]), [[0, 1]]);
    }

    #[test]
    fn degenerate_input_joins_nothing() {
        let s = [
            segment(1.0, 1.0, 1.0, 1.0),
            segment(1.0, 1.0, 1.0, 1.0),
            segment(f64::NAN, 0.0, 5.0, 5.0),
        ];
        assert_eq!(pieces(&s), [[0], [1], [2]]);
        assert_eq!(pieces(&[]), [[0usize; 0]; 0]);
        let s = [
            segment(0.0, 10.0, 20.0, 10.0),
            segment(22.0, 10.0, 40.0, 10.0),
        ];
        for bad in [f64::NAN, -1.0] {
            let params = MergeParams {
                max_offset_px: bad,
                ..MergeParams::default()
            };
            assert_eq!(merge_collinear(&s, &params).len(), 2);
        }
    }
}
