//! Labels of image-space variants: features are detected again and associated with the tracks that the picture sees.

use super::{LabelledVariant, Labels};
use landline::features::FeatureSet;
use landline::geometry::{Pixel, Segment2};
use landline::reconstruction::{Reconstruction, SegmentTarget, View, ViewTargets};

/// A keypoint belongs to a track whose projection is this near, in pixels of the picture.
const MAX_POINT_PX: f64 = 2.0;
/// A segment belongs to a labelled one when its ends are this near to the other's infinite line,
const MAX_LINE_PX: f64 = 2.0;
/// the directions differ by less than this,
const MAX_ANGLE_DEG: f64 = 3.0;
/// and this share of the shorter one lies beside the other.
const MIN_OVERLAP: f64 = 0.5;

/// Means over the variants.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VariantStats {
    /// Variants.
    pub num_variants: usize,
    /// Keypoints of one.
    pub keypoints: f64,
    /// Those with a target.
    pub labelled_keypoints: f64,
    /// Segments of one.
    pub segments: f64,
    /// Those with a target.
    pub labelled_segments: f64,
}

impl std::fmt::Display for VariantStats {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "  variants           {}, {:.0} of {:.0} keypoints and {:.0} of {:.0} segments labelled",
            self.num_variants,
            self.labelled_keypoints,
            self.keypoints,
            self.labelled_segments,
            self.segments
        )
    }
}

/// Adds variants to their pictures' labels. `variants` are features in pixels of the unchanged picture, each with the index
/// of its picture among the map's views.
pub fn add_variants(
    labels: &mut Labels,
    variants: impl IntoIterator<Item = (usize, FeatureSet)>,
) -> VariantStats {
    let of_views = labels.map.targets();
    let mut stats = VariantStats::default();
    for (of, features) in variants {
        if of >= labels.map.views.len() {
            continue;
        }
        let variant = LabelledVariant {
            of_view: of as u32,
            features,
        };
        let found = targets(&labels.map, &of_views, &variant);
        stats.num_variants += 1;
        stats.keypoints += found.points.len() as f64;
        stats.labelled_keypoints += found.points.iter().flatten().count() as f64;
        stats.segments += found.segments.len() as f64;
        stats.labelled_segments += found.segments.iter().flatten().count() as f64;
        labels.variants.push(variant);
    }
    let n = stats.num_variants.max(1) as f64;
    for sum in [
        &mut stats.keypoints,
        &mut stats.labelled_keypoints,
        &mut stats.segments,
        &mut stats.labelled_segments,
    ] {
        *sum /= n;
    }
    stats
}

/// Targets of a variant's features, given those of all views; none for a variant of a view that is not there.
pub(super) fn targets(
    map: &Reconstruction,
    of_views: &[ViewTargets],
    variant: &LabelledVariant,
) -> ViewTargets {
    let of = variant.of_view as usize;
    let (Some(view), Some(known)) = (map.views.get(of), of_views.get(of)) else {
        return ViewTargets {
            points: vec![None; variant.features.keypoints.len()],
            segments: vec![None; variant.features.segments.len()],
        };
    };
    ViewTargets {
        points: point_targets(map, view, known, &variant.features),
        segments: segment_targets(view, known, &variant.features),
    }
}

/// The nearest track of the picture, by where it projects.
fn point_targets(
    map: &Reconstruction,
    view: &View,
    known: &ViewTargets,
    features: &FeatureSet,
) -> Vec<Option<u32>> {
    let mut tracks: Vec<(Pixel, u32)> = known
        .points
        .iter()
        .flatten()
        .filter_map(|t| {
            let point = map.points.get(*t as usize)?.point_in_world;
            let in_cam = view.cam_from_world?.transform_point(&point);
            Some((view.camera.pixel_from_cam(&in_cam)?, *t))
        })
        .collect();
    tracks.sort_by(|a, b| a.0.x.total_cmp(&b.0.x).then(a.1.cmp(&b.1)));
    let nearest = |pixel: Pixel| {
        let first = tracks.partition_point(|(p, _)| p.x < pixel.x - MAX_POINT_PX);
        tracks[first..]
            .iter()
            .take_while(|(p, _)| p.x <= pixel.x + MAX_POINT_PX)
            .map(|(p, t)| (p.distance(pixel), *t))
            .filter(|(distance, _)| *distance <= MAX_POINT_PX)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, t)| t)
    };
    features
        .keypoints
        .iter()
        .map(|k| nearest(k.pixel))
        .collect()
}

/// The labelled segment of the picture that lies on the same line and beside it.
fn segment_targets(
    view: &View,
    known: &ViewTargets,
    features: &FeatureSet,
) -> Vec<Option<SegmentTarget>> {
    let labelled: Vec<(&Segment2, SegmentTarget)> = view
        .features
        .segments
        .iter()
        .zip(&known.segments)
        .filter_map(|(segment, target)| target.map(|t| (segment, t)))
        .collect();
    let best = |found: &Segment2| {
        labelled
            .iter()
            .filter_map(|(known, target)| {
                let (off, is_reversed) = same_line(found, known)?;
                let reversed = target.reversed != is_reversed;
                Some((
                    off,
                    SegmentTarget {
                        reversed,
                        ..*target
                    },
                ))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, target)| target)
    };
    features.segments.iter().map(best).collect()
}

/// Larger distance of the found ends from the known line, and whether the directions are opposite; `None` when they are not
/// the same line or do not lie beside one another.
fn same_line(found: &Segment2, known: &Segment2) -> Option<(f64, bool)> {
    let (dx, dy) = (known.end.x - known.start.x, known.end.y - known.start.y);
    let length = dx.hypot(dy);
    let found_length = found.length_px();
    if length < 1e-9 || found_length < 1e-9 {
        return None;
    }
    let (ux, uy) = (dx / length, dy / length);
    let along = |p: Pixel| (p.x - known.start.x) * ux + (p.y - known.start.y) * uy;
    let across = |p: Pixel| ((p.y - known.start.y) * ux - (p.x - known.start.x) * uy).abs();
    let off = across(found.start).max(across(found.end));
    let (a, b) = (along(found.start), along(found.end));
    let cosine = (b - a) / found_length;
    let overlap = a.max(b).min(length) - a.min(b).max(0.0);
    let is_same = off <= MAX_LINE_PX
        && cosine.abs() >= MAX_ANGLE_DEG.to_radians().cos()
        && overlap >= MIN_OVERLAP * length.min(found_length);
    is_same.then_some((off, cosine < 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::features::Keypoint;
    use landline::geometry::{CamFromWorld, Camera};
    use landline::reconstruction::{LineTrack, Observation, PointTrack};
    use nalgebra::Vector3;

    fn segment(x0: f64, y0: f64, x1: f64, y1: f64) -> Segment2 {
        Segment2 {
            start: Pixel::new(x0, y0),
            end: Pixel::new(x1, y1),
            width_px: 2.0,
            precision: 0.125,
            neg_log10_nfa: 9.0,
        }
    }

    fn features(keypoints: &[(f64, f64)], segments: Vec<Segment2>) -> FeatureSet {
        FeatureSet {
            keypoints: keypoints
                .iter()
                .map(|(x, y)| Keypoint {
                    pixel: Pixel::new(*x, *y),
                    score: 1.0,
                })
                .collect(),
            descriptors_nd: vec![1.0; keypoints.len()],
            segment_descriptors_nsd: vec![1.0; 2 * segments.len()],
            segments,
            descriptor_channels: 1,
            tokens: 2,
        }
    }

    #[test]
    fn detected_again_means_the_same_track_or_none() {
        // Camera of focal length 50 and centre (50, 50) at the origin: (0, 0, 1) projects to (50, 50).
        let point =
            |x: f64, seen: Vec<Observation>| PointTrack::new(Vector3::new(x, 0.0, 1.0), seen);
        let seen = |feature: usize| vec![Observation::new(0, feature)];
        // The line that projects to y = 20, against the segment's direction.
        let ends = [1.0, -0.8].map(|x| Vector3::new(x, -0.6, 1.0));
        let mut labels = Labels {
            map: Reconstruction {
                // The track at (55, 50) exists but this picture does not see it.
                points: vec![
                    point(0.0, seen(0)),
                    point(0.05, seen(1)),
                    point(0.1, Vec::new()),
                ],
                lines: vec![LineTrack::new(ends, seen(0))],
                views: vec![View {
                    name: "a".to_owned(),
                    camera: Camera::centered(100, 100, 50.0),
                    cam_from_world: Some(CamFromWorld::identity()),
                    features: features(
                        &[(50.0, 50.0), (52.0, 50.0)],
                        vec![segment(10.0, 20.0, 60.0, 20.0)],
                    ),
                }],
                ..Reconstruction::default()
            },
            ..Labels::default()
        };
        let found = features(
            &[(49.0, 50.5), (51.6, 50.0), (55.0, 50.0), (50.0, 53.0)],
            vec![
                segment(12.0, 21.0, 50.0, 20.5),
                segment(50.0, 19.0, 12.0, 20.0),
                segment(12.0, 20.0, 50.0, 25.0),
                segment(58.0, 20.0, 95.0, 20.0),
                segment(12.0, 24.0, 50.0, 24.0),
            ],
        );
        let stats = add_variants(&mut labels, [(0, found.clone()), (7, found)]);
        assert_eq!(labels.variants.len(), 1);
        assert_eq!(labels.variants[0].of_view, 0);
        let targets = labels.targets();
        // (52.5, 50) is where track 1 projects to; the third is 2.5 px from it.
        assert_eq!(targets.variants[0].points, [Some(0), Some(1), None, None]);
        let same = |reversed| Some(SegmentTarget { track: 0, reversed });
        assert_eq!(targets.views[0].segments, [same(true)]);
        assert_eq!(
            targets.variants[0].segments,
            [same(true), same(false), None, None, None]
        );
        assert_eq!(
            (stats.labelled_keypoints, stats.labelled_segments),
            (2.0, 2.0)
        );
    }
}
