//! What localization does with detected segments, each step optional and on its own.
//!
//! Input and output: lists of [`Segment2`] in one image's pixels. All steps keep the order of detection.

use super::merge::{MergeParams, merge_collinear};
use crate::geometry::Segment2;
use crate::math::order::{sort_by, sort_by_key};

/// More segments than a picture of VGA size ever has; bounds the work that follows.
pub const DEFAULT_MAX_COUNT: usize = 3000;

/// What [`keep_top`] ranks by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Rank {
    /// Longer is better.
    #[default]
    Length,
    /// Larger -log10 NFA is better: favours segments that are long, wide and dense.
    Significance,
}

/// Which end of a segment comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Direction {
    /// As detected: walking from start to end, the darker side lies at the right hand. Descriptors along the segment
    /// can use the contrast; the same edge keeps its direction in another view.
    #[default]
    DarkAtRight,
    /// The other way round, as the program pytlsd returns segments.
    DarkAtLeft,
    /// The end with the smaller x first (smaller y when equal). Loses the sign of the contrast.
    LeftToRight,
}

/// Steps applied by [`apply`]: merge, minimum length, the best ones, direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PostParams {
    /// Joins fragments of one line; off by default.
    pub merge: Option<MergeParams>,
    /// Segments shorter than this are dropped; 0 keeps all. 15 removes the least repeatable quarter of the segments of a
    /// 640x480 picture but only a tenth of their total length: of shorter ones fewer than 60 % are found again under pixel
    /// noise of 3 grey levels.
    pub min_length_px: f64,
    /// At most so many are kept.
    pub max_count: usize,
    /// Which are kept when there are more.
    pub rank: Rank,
    /// Which end comes first.
    pub direction: Direction,
}

impl Default for PostParams {
    fn default() -> Self {
        Self {
            merge: None,
            min_length_px: 0.0,
            max_count: DEFAULT_MAX_COUNT,
            rank: Rank::Length,
            direction: Direction::DarkAtRight,
        }
    }
}

/// Applies the steps in the order of the fields of [`PostParams`].
pub fn apply(segments: &mut Vec<Segment2>, params: &PostParams) {
    if let Some(merge) = &params.merge {
        let merged = merge_collinear(segments, merge);
        segments.clear();
        segments.extend(merged.iter().map(|m| m.segment));
    }
    keep_longer(segments, params.min_length_px);
    keep_top(segments, params.max_count, params.rank);
    orient(segments, params.direction);
}

/// Drops segments shorter than `min_length_px`. With NaN nothing is dropped.
pub fn keep_longer(segments: &mut Vec<Segment2>, min_length_px: f64) {
    segments.retain(|s| !(s.length_px() < min_length_px));
}

/// Keeps the best `max_count` segments, in their order; of equal ones those that come first.
pub fn keep_top(segments: &mut Vec<Segment2>, max_count: usize, rank: Rank) {
    if segments.len() <= max_count {
        return;
    }
    let value = |s: &Segment2| match rank {
        Rank::Length => s.length_px(),
        Rank::Significance => s.neg_log10_nfa,
    };
    let mut ranked: Vec<(f64, usize)> = segments.iter().map(value).zip(0..).collect();
    sort_by(&mut ranked, |a, b| b.0.total_cmp(&a.0));
    ranked.truncate(max_count);
    sort_by_key(&mut ranked, |r| r.1);
    for (place, (_, index)) in ranked.into_iter().enumerate() {
        segments.swap(place, index);
    }
    segments.truncate(max_count);
}

/// Swaps ends as the convention asks. The input must be as detected for the two contrast conventions.
pub fn orient(segments: &mut [Segment2], direction: Direction) {
    for s in segments {
        let swap = match direction {
            Direction::DarkAtRight => false,
            Direction::DarkAtLeft => true,
            Direction::LeftToRight => (s.end.x, s.end.y) < (s.start.x, s.start.y),
        };
        if swap {
            core::mem::swap(&mut s.start, &mut s.end);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;

    fn segment(x1: f64, y1: f64, x2: f64, y2: f64, neg_log10_nfa: f64) -> Segment2 {
        Segment2 {
            start: Pixel::new(x1, y1),
            end: Pixel::new(x2, y2),
            width_px: 2.0,
            precision: 0.125,
            neg_log10_nfa,
        }
    }

    fn four() -> Vec<Segment2> {
        vec![
            segment(0.0, 0.0, 10.0, 0.0, 9.0),
            segment(5.0, 1.0, 5.0, 31.0, 3.0),
            segment(9.0, 2.0, 1.0, 2.0, 20.0),
            segment(0.0, 0.0, 0.0, 10.0, 7.0),
        ]
    }

    #[test]
    fn shorter_ones_are_dropped() {
        let mut s = four();
        keep_longer(&mut s, 10.0);
        assert_eq!(s.len(), 3);
        keep_longer(&mut s, 10.5);
        assert_eq!(s, [four()[1]]);
        keep_longer(&mut s, f64::NAN);
        assert_eq!(s.len(), 1);
    }

    #[test]
    fn the_best_stay_in_order() {
        let mut s = four();
        keep_top(&mut s, 2, Rank::Length);
        assert_eq!(s, [four()[0], four()[1]], "of two equal lengths the first");
        let mut s = four();
        keep_top(&mut s, 3, Rank::Significance);
        assert_eq!(s, [four()[0], four()[2], four()[3]]);
        keep_top(&mut s, 0, Rank::Significance);
        assert!(s.is_empty());
    }

    #[test]
    fn directions() {
        let mut s = four();
        orient(&mut s, Direction::LeftToRight);
        assert_eq!(s[2].start, Pixel::new(1.0, 2.0));
        assert_eq!((s[0], s[1], s[3]), (four()[0], four()[1], four()[3]));
        orient(&mut s, Direction::DarkAtLeft);
        assert_eq!(s[0].start, Pixel::new(10.0, 0.0));
    }

    #[test]
    fn apply_runs_all_steps() {
        let mut s = four();
        let params = PostParams {
            min_length_px: 9.0,
            max_count: 1,
            rank: Rank::Significance,
            direction: Direction::DarkAtLeft,
            ..PostParams::default()
        };
        apply(&mut s, &params);
        assert_eq!(s, [segment(10.0, 0.0, 0.0, 0.0, 9.0)]);
    }
}
