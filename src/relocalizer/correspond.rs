//! Pairs what was seen with what the networks say about it.

use super::options::LiveOptions;
use crate::features::FeatureSet;
use crate::math::order::Best;
use crate::pose::{LineCorrespondence, PointCorrespondence};
use crate::regress::Predictions;

/// Fills the solver's lists; pixels are those of the features.
///
/// Only the most confident predictions are passed on, up to a number: a fixed threshold leaves too few on viewpoints that
/// were not taught, and all of them would make the solver slow. The order of the features is kept.
pub fn correspondences(
    features: &FeatureSet,
    predictions: &Predictions,
    options: &LiveOptions,
    best: &mut Best,
    out_points: &mut Vec<PointCorrespondence>,
    out_lines: &mut Vec<LineCorrespondence>,
) {
    let points = predictions.points.iter();
    let confidences = (0..).zip(points.clone().map(|p| p.confidence));
    best.choose(options.max_points, confidences);
    out_points.clear();
    let of_rows = (0..).zip(points.zip(&predictions.point_rows));
    out_points.extend(of_rows.filter_map(|(k, (p, row))| {
        let keypoint = features
            .keypoints
            .get(*row)
            .filter(|_| best.keeps(k, p.confidence))?;
        Some(PointCorrespondence {
            pixel: keypoint.pixel,
            point_in_world: p.point_in_world,
            confidence: p.confidence,
            sigma_m: 0.0,
            sigma_px: 0.0,
        })
    }));
    let segments = predictions.segments.iter();
    let confidences = (0..).zip(segments.clone().map(|s| s.confidence));
    best.choose(options.max_lines, confidences);
    out_lines.clear();
    let of_rows = (0..).zip(segments.zip(&predictions.segment_rows));
    out_lines.extend(of_rows.filter_map(|(k, (s, row))| {
        let seen = features
            .segments
            .get(*row)
            .filter(|_| best.keeps(k, s.confidence))?;
        Some(LineCorrespondence {
            start: seen.start,
            end: seen.end,
            start_in_world: s.start_in_world,
            end_in_world: s.end_in_world,
            confidence: s.confidence,
            sigma_m: 0.0,
            sigma_px: 0.0,
        })
    }));
}
