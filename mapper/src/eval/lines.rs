//! How well predicted 3D segments lie on triangulated ones.
//!
//! The triangulated lines are those of the training pictures. Which of them a segment of a test picture shows is decided in
//! the picture, under its true pose: the line must project onto the segment, and look like it. The predicted segment is
//! then compared with that very line in space, not with the nearest one.

use crate::units::Ruler;
use landline::features::FeatureSet;
use landline::geometry::{CamFromWorld, Camera};
use landline::pose::LineCorrespondence;
use landline::reconstruction::{KnownLine, LineParams, PosedView, Reconstruction, assign_segments};
use nalgebra::Vector3;
use serde::Serialize;

/// A predicted segment is right when both ends lie this near the true infinite line, in world units ...
pub const MAX_LINE_DISTANCE: f64 = 0.05;
/// ... and its direction within this of the true one.
pub const MAX_LINE_ANGLE_DEG: f64 = 3.0;

/// The triangulated lines of a scene.
#[derive(Debug, Clone)]
pub struct LineTruth {
    lines: Vec<KnownLine>,
    params: LineParams,
}

/// Counts over the predicted segments that went to the solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct LineAccuracy {
    /// All of them.
    pub num_predicted: usize,
    /// Those whose segment shows a triangulated line.
    pub num_known: usize,
    /// Of these, those that are right.
    pub num_right: usize,
    /// Those of `num_known` that agree with the pose.
    pub num_agreeing_known: usize,
    /// Of these, those that are right.
    pub num_agreeing_right: usize,
}

impl LineAccuracy {
    /// Adds the counts of another picture.
    pub fn add(&mut self, other: &Self) {
        self.num_predicted += other.num_predicted;
        self.num_known += other.num_known;
        self.num_right += other.num_right;
        self.num_agreeing_known += other.num_agreeing_known;
        self.num_agreeing_right += other.num_agreeing_right;
    }
}

impl LineAccuracy {
    /// In one sentence.
    pub fn text(&self, ruler: &Ruler) -> String {
        let percent = |part: usize, of: usize| {
            if of == 0 {
                "-".to_owned()
            } else {
                format!("{:.1} %", 100.0 * part as f64 / of as f64)
            }
        };
        format!(
            "3D lines within {} {} / {MAX_LINE_ANGLE_DEG:.0} deg of the triangulated one: {} of {}; of those that agree \
             with the pose {} of {} ({} predicted)",
            ruler.threshold(MAX_LINE_DISTANCE),
            ruler.symbol,
            percent(self.num_right, self.num_known),
            self.num_known,
            percent(self.num_agreeing_right, self.num_agreeing_known),
            self.num_agreeing_known,
            self.num_predicted
        )
    }
}

impl LineTruth {
    /// The lines of a map, with what they look like and from where they were seen.
    pub fn from_map(map: &Reconstruction) -> Self {
        let center = |view: u32| {
            Some(
                map.views
                    .get(view as usize)?
                    .cam_from_world?
                    .center_in_world(),
            )
        };
        Self {
            lines: map
                .lines
                .iter()
                .map(|line| KnownLine {
                    start_in_world: line.start_in_world,
                    end_in_world: line.end_in_world,
                    descriptor: line.descriptor.clone(),
                    seen_from: line
                        .observations
                        .iter()
                        .filter_map(|o| center(o.view))
                        .collect(),
                })
                .collect(),
            params: LineParams::default(),
        }
    }

    /// Compares the predictions of a picture, with whether each agrees with the pose; `features` are the picture's.
    pub fn compare(
        &self,
        camera: Camera,
        truth: CamFromWorld,
        features: &FeatureSet,
        predicted: &[(LineCorrespondence, bool)],
    ) -> LineAccuracy {
        let mut accuracy = LineAccuracy {
            num_predicted: predicted.len(),
            ..LineAccuracy::default()
        };
        let view = PosedView::new(camera, truth, features);
        let shown = assign_segments(&view, &self.lines, &self.params, |_| true);
        for (line, agrees) in predicted {
            // The same segment, found by its ends.
            const SAME_PX: f64 = 0.05;
            let segment = features.segments.iter().position(|s| {
                s.start.distance(line.start) < SAME_PX && s.end.distance(line.end) < SAME_PX
            });
            let known = segment
                .and_then(|s| *shown.get(s)?)
                .and_then(|(_, l)| self.lines.get(l));
            let Some(known) = known else { continue };
            let is_right = is_on_line(
                [line.start_in_world, line.end_in_world],
                [known.start_in_world, known.end_in_world],
            );
            accuracy.num_known += 1;
            accuracy.num_right += usize::from(is_right);
            accuracy.num_agreeing_known += usize::from(*agrees);
            accuracy.num_agreeing_right += usize::from(*agrees && is_right);
        }
        accuracy
    }
}

/// Whether a segment lies on the infinite line through another one, within the limits.
fn is_on_line([p, q]: [Vector3<f64>; 2], [a, b]: [Vector3<f64>; 2]) -> bool {
    let (Some(direction), Some(truth)) = ((q - p).try_normalize(1e-9), (b - a).try_normalize(1e-9))
    else {
        return false;
    };
    let off = |x: Vector3<f64>| ((x - a) - truth * (x - a).dot(&truth)).norm();
    direction.dot(&truth).abs() >= MAX_LINE_ANGLE_DEG.to_radians().cos()
        && off(p) <= MAX_LINE_DISTANCE
        && off(q) <= MAX_LINE_DISTANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::geometry::Segment2;
    use landline::reconstruction::{LineTrack, Observation, View};

    fn at(x: f64, y: f64, z: f64) -> Vector3<f64> {
        Vector3::new(x, y, z)
    }

    #[test]
    fn lines_are_compared_as_infinite_ones() {
        let truth = [at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0)];
        // Shifted along itself and reversed: the same line. 6 cm beside it, or turned by 5 degrees: not.
        assert!(is_on_line([at(3.0, 0.01, 0.0), at(2.0, 0.01, 0.0)], truth));
        assert!(!is_on_line([at(0.0, 0.06, 0.0), at(1.0, 0.06, 0.0)], truth));
        assert!(!is_on_line([at(0.0, 0.0, 0.0), at(0.4, 0.035, 0.0)], truth));
        assert!(!is_on_line([at(0.0, 0.0, 0.0), at(0.0, 0.0, 0.0)], truth));
    }

    #[test]
    fn a_prediction_is_held_to_the_line_that_its_segment_shows() {
        let camera = Camera::centered(640, 480, 500.0);
        // Two lines that cover each other in the picture of a camera at the origin, at depths 2 and 4; they look different.
        let line = |depth: f64, descriptor: [f32; 2]| LineTrack {
            descriptor: descriptor.to_vec(),
            mean_error_px: 0.5,
            ..LineTrack::new(
                [at(-0.1 * depth, 0.0, depth), at(0.1 * depth, 0.0, depth)],
                vec![Observation::new(0, 0)],
            )
        };
        let map = Reconstruction {
            lines: vec![line(2.0, [1.0, 0.0]), line(4.0, [0.0, 1.0])],
            views: vec![View {
                name: String::new(),
                camera,
                cam_from_world: Some(CamFromWorld::identity()),
                features: FeatureSet::default(),
            }],
            ..Reconstruction::default()
        };
        let segment = Segment2 {
            start: landline::geometry::Pixel::new(270.0, 240.0),
            end: landline::geometry::Pixel::new(370.0, 240.0),
            width_px: 1.0,
            precision: 0.125,
            neg_log10_nfa: 5.0,
        };
        let features = FeatureSet {
            descriptor_channels: 2,
            tokens: 2,
            segments: vec![segment],
            segment_descriptors_nsd: vec![0.0, 1.0, 0.0, 1.0],
            ..FeatureSet::default()
        };
        let predicted = |depth: f64| LineCorrespondence {
            start: segment.start,
            end: segment.end,
            start_in_world: at(-0.1 * depth, 0.01, depth),
            end_in_world: at(0.1 * depth, 0.01, depth),
            confidence: 0.5,
            sigma_m: 0.0,
            sigma_px: 0.0,
        };
        let truth = LineTruth::from_map(&map);
        let counts = |depth: f64| {
            let found = truth.compare(
                camera,
                CamFromWorld::identity(),
                &features,
                &[(predicted(depth), true)],
            );
            (found.num_known, found.num_right, found.num_agreeing_right)
        };
        assert_eq!(counts(4.0), (1, 1, 1));
        assert_eq!(counts(2.0), (1, 0, 0));
    }
}
