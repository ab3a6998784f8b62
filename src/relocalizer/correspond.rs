//! Pairs what was seen with what the networks say about it.

use super::options::LiveOptions;
use crate::features::FeatureSet;
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
    order: &mut Vec<(f32, usize)>,
    out_points: &mut Vec<PointCorrespondence>,
    out_lines: &mut Vec<LineCorrespondence>,
) {
    let confidences = predictions.points.iter().map(|p| p.confidence);
    most_confident(confidences, options.max_points, order);
    out_points.clear();
    out_points.extend(order.iter().filter_map(|&(_, k)| {
        let p = predictions.points.get(k)?;
        let keypoint = features.keypoints.get(*predictions.point_rows.get(k)?)?;
        Some(PointCorrespondence {
            pixel: keypoint.pixel,
            point_in_world: p.point_in_world,
            confidence: p.confidence,
            sigma_m: 0.0,
            sigma_px: 0.0,
        })
    }));
    let confidences = predictions.segments.iter().map(|s| s.confidence);
    most_confident(confidences, options.max_lines, order);
    out_lines.clear();
    out_lines.extend(order.iter().filter_map(|&(_, k)| {
        let s = predictions.segments.get(k)?;
        let seen = features.segments.get(*predictions.segment_rows.get(k)?)?;
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

/// Fills `order` with the `most` most confident and their indices, ascending by index; of equals the first are kept.
pub fn most_confident(
    confidences: impl Iterator<Item = f32>,
    most: usize,
    order: &mut Vec<(f32, usize)>,
) {
    order.clear();
    order.extend(confidences.zip(0..));
    if order.len() > most {
        order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.truncate(most);
        order.sort_unstable_by_key(|&(_, k)| k);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_most_confident_in_order() {
        let mut order = Vec::new();
        let chosen = |most, order: &mut Vec<(f32, usize)>| {
            most_confident([0.2, 0.9, 0.5, 0.5, 0.1].into_iter(), most, order);
            order.iter().map(|o| o.1).collect::<Vec<_>>()
        };
        assert_eq!(chosen(9, &mut order), [0, 1, 2, 3, 4]);
        assert_eq!(chosen(2, &mut order), [1, 2]);
        assert_eq!(chosen(4, &mut order), [0, 1, 2, 3]);
        assert!(chosen(0, &mut order).is_empty());
    }
}
