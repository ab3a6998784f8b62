//! Network outputs to scene points and segments. Independent of what ran the network.

use super::regressor::RegressError;
use crate::geometry::{ScenePoint, SceneScale, SceneSegment};
use crate::models::{RegressorConfig, V1Config, ports};
use nalgebra::Vector3;

/// What a scene's network says about a picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Predictions {
    /// One for each keypoint that was kept.
    pub points: Vec<ScenePoint>,
    /// The keypoint that each point belongs to, ascending.
    pub point_rows: Vec<usize>,
    /// One for each segment that was kept.
    pub segments: Vec<SceneSegment>,
    /// The image segment that each scene segment belongs to, ascending.
    pub segment_rows: Vec<usize>,
}

impl Predictions {
    /// Empties it, keeping its memory.
    pub fn clear(&mut self) {
        self.points.clear();
        self.point_rows.clear();
        self.segments.clear();
        self.segment_rows.clear();
    }
}

fn sigmoid(x: f32) -> f32 {
    // The software exponential: the system's differs in the last digit from machine to machine.
    1.0 / (1.0 + libm::expf(-x))
}

fn world(scale: &SceneScale, xyz: &[f32]) -> Option<Vector3<f64>> {
    let &[x, y, z] = xyz else { return None };
    let p = Vector3::new(f64::from(x), f64::from(y), f64::from(z));
    let p = scale.world_from_network(p);
    p.iter().all(|v| v.is_finite()).then_some(p)
}

/// Pairs each kept row with its element: `rows` as the network wrote them, or all elements in order.
fn kept(rows: Option<&[f32]>, num: usize) -> impl Iterator<Item = (usize, usize)> {
    let len = rows.map_or(num, <[f32]>::len);
    (0..len)
        .map(move |k| (k, rows.map_or(k, |r| r[k] as usize)))
        .filter(move |(_, row)| *row < num)
}

/// Adds what a network says to the predictions, whatever ran it. `network` is its place in
/// [`network_parts`](super::network_parts); `output` finds its outputs by name.
///
/// # Errors
/// [`RegressError::Output`] when the network lacks an output of its configuration.
pub fn decode<'a>(
    config: &RegressorConfig,
    network: usize,
    scale: &SceneScale,
    output: impl Fn(&str) -> Option<&'a [f32]>,
    out: &mut Predictions,
) -> Result<(), RegressError> {
    let needed = |name: &'static str| output(name).ok_or(RegressError::Output { network, name });
    // Only networks that choose have rows.
    let rows = output(ports::ROWS);
    match (config, network) {
        (RegressorConfig::Branches { .. }, 0) => {
            let (logits, coordinates) = (needed(ports::LOGITS)?, needed(ports::COORDINATES)?);
            decode_points(scale, logits, coordinates, rows, out);
        }
        (RegressorConfig::Branches { .. }, _) => {
            let (logits, coordinates) = (needed(ports::LOGITS)?, needed(ports::COORDINATES)?);
            decode_lines(scale, logits, coordinates, rows, out);
        }
        (RegressorConfig::V1(v1), _) => {
            let (points, lines) = (needed(ports::POINTS_3D)?, needed(ports::LINES_3D)?);
            decode_v1(v1, scale, points, lines, out);
        }
    }
    Ok(())
}

/// Scene points from logits of all keypoints, coordinates of the kept ones, and their rows (`None`: all were kept). A point
/// that is not finite is dropped.
fn decode_points(
    scale: &SceneScale,
    logits: &[f32],
    coordinates: &[f32],
    rows: Option<&[f32]>,
    out: &mut Predictions,
) {
    out.points.clear();
    out.point_rows.clear();
    for (k, row) in kept(rows, logits.len()) {
        let Some(point_in_world) = coordinates
            .get(3 * k..3 * k + 3)
            .and_then(|c| world(scale, c))
        else {
            continue;
        };
        out.points.push(ScenePoint {
            point_in_world,
            confidence: sigmoid(logits[row]),
        });
        out.point_rows.push(row);
    }
}

/// Scene segments; as [`decode_points`], with six coordinates each.
fn decode_lines(
    scale: &SceneScale,
    logits: &[f32],
    coordinates: &[f32],
    rows: Option<&[f32]>,
    out: &mut Predictions,
) {
    out.segments.clear();
    out.segment_rows.clear();
    for (k, row) in kept(rows, logits.len()) {
        let Some(c) = coordinates.get(6 * k..6 * k + 6) else {
            continue;
        };
        let (Some(start_in_world), Some(end_in_world)) =
            (world(scale, &c[..3]), world(scale, &c[3..]))
        else {
            continue;
        };
        out.segments.push(SceneSegment {
            start_in_world,
            end_in_world,
            confidence: sigmoid(logits[row]),
        });
        out.segment_rows.push(row);
    }
}

/// Scene points and segments of `v1`: rows of three coordinates and a number `x`, and of six and a number. Kept where
/// `1 / (1 + 100 |x|)` reaches the threshold.
fn decode_v1(
    config: &V1Config,
    scale: &SceneScale,
    points_4: &[f32],
    lines_7: &[f32],
    out: &mut Predictions,
) {
    out.clear();
    let reliability = |x: f32| 1.0 / (1.0 + 100.0 * x.abs());
    for (row, c) in points_4.chunks_exact(4).enumerate() {
        let confidence = reliability(c[3]);
        if confidence >= config.min_point_confidence
            && let Some(point_in_world) = world(scale, &c[..3])
        {
            out.points.push(ScenePoint {
                point_in_world,
                confidence,
            });
            out.point_rows.push(row);
        }
    }
    for (row, c) in lines_7.chunks_exact(7).enumerate() {
        let confidence = reliability(c[6]);
        if confidence >= config.min_line_confidence
            && let (Some(start_in_world), Some(end_in_world)) =
                (world(scale, &c[..3]), world(scale, &c[3..6]))
        {
            out.segments.push(SceneSegment {
                start_in_world,
                end_in_world,
                confidence,
            });
            out.segment_rows.push(row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_scale_and_confidence() {
        let scale = SceneScale {
            centre: Vector3::new(10.0, 0.0, -1.0),
            scale: 2.0,
        };
        let mut out = Predictions::default();
        let logits = [0.0, -9.0, 1.386_294_4, 3.0];
        let coordinates = [1.0, 2.0, 3.0, f32::NAN, 0.0, 0.0];
        decode_points(&scale, &logits, &coordinates, Some(&[2.0, 3.0]), &mut out);
        assert_eq!(out.point_rows, [2], "a point that is not finite is dropped");
        assert_eq!(out.points[0].point_in_world, Vector3::new(12.0, 4.0, 5.0));
        assert!((out.points[0].confidence - 0.8).abs() < 1e-6);
        decode_lines(&scale, &logits[..1], &[0.0; 6], None, &mut out);
        assert_eq!(out.segment_rows, [0]);
        assert_eq!(out.segments[0].end_in_world, scale.centre);
        // Rows beyond the elements, as a damaged device buffer could hold, are left out.
        decode_points(&scale, &logits, &coordinates, Some(&[4.0, 1e9]), &mut out);
        assert!(out.points.is_empty());
    }

    #[test]
    fn v1_keeps_what_reaches_the_threshold() {
        let config = V1Config::paper();
        let mut out = Predictions::default();
        let points = [1.0, 2.0, 3.0, 0.01, 1.0, 2.0, 3.0, -0.0101];
        let lines = [
            0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.4, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.6,
        ];
        decode_v1(&config, &SceneScale::default(), &points, &lines, &mut out);
        assert_eq!(out.point_rows, [0]);
        assert_eq!(out.points[0].confidence, 0.5);
        assert_eq!(out.segment_rows, [0]);
    }
}
