//! The lines of the map against the segments of a frame.
//!
//! Compared are distance, direction with its sign (the detector keeps the darker side on one side, so that the two edges of a
//! thin thing are told apart), overlap and descriptor. Everything happens in the ideal image plane, scaled to pixels and counted
//! from the principal point, so that distortion does not bend lines.

use super::Landmarks;
use super::code::{CODE_BITS, similarity};
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera, Pixel};
use crate::math::elementary::logistic;
use crate::pose::LineCorrespondence;
use nalgebra::{Vector2, Vector3};

/// Cosine of the largest angle between a segment and its line (15 degrees).
const MIN_COS: f64 = 0.966;
/// The shorter of the two must lie beside the other with this share of its length.
const MIN_OVERLAP: f64 = 0.5;
/// Similarities below this are no match.
const LEAST_SIMILARITY: f32 = 0.15;
/// What a distance of the whole window costs in similarity.
const DISTANCE_COST: f64 = 0.2;
/// From similarity to the probability of being right: slope and middle of the logistic.
const BELIEF: (f64, f64) = (8.0, 0.25);
/// Lines are cut where they come nearer to the plane of the camera than this share of their middle's distance.
const MIN_DEPTH: f64 = 0.1;
/// Lines that look shorter than this, in pixels of a picture 640 wide, need not be found.
const MIN_VISIBLE_PX: f64 = 25.0;
/// Cosine of the largest angle of a segment's end from the optical axis (80 degrees).
const MIN_BEARING_Z: f64 = 0.174;

/// How far from its place a line is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineWindow {
    /// Largest distance of a segment's end from the line, pixels.
    pub(super) distance: f64,
    /// Whether lines are wanted at all.
    pub(super) wanted: bool,
}

/// A segment in the ideal image plane.
#[derive(Debug, Clone, Copy)]
struct Seen {
    start: Vector2<f64>,
    end: Vector2<f64>,
    direction: Vector2<f64>,
    length: f64,
    segment: u32,
}

/// A line of the map where the pose puts it.
#[derive(Debug, Clone, Copy)]
struct Projected {
    start: Vector2<f64>,
    direction: Vector2<f64>,
    length: f64,
    landmark: u32,
}

/// Buffers of the matcher of lines.
#[derive(Debug, Default)]
pub(super) struct LineMatcher {
    queries: Vec<[f32; CODE_BITS]>,
    mean: Vec<f32>,
    seen: Vec<Seen>,
    projected: Vec<Projected>,
    num_visible: u32,
    has_descriptors: bool,
}

impl LineMatcher {
    /// Takes over the segments' descriptors. Where they are missing, geometry decides alone.
    pub(super) fn load(&mut self, landmarks: &Landmarks, features: &FeatureSet) {
        let channels = landmarks.line_code.mean.len();
        let row = channels * features.tokens;
        let num = features.segments.len();
        self.has_descriptors = row > 0 && features.segment_descriptors_nsd.len() == num * row;
        self.queries.clear();
        self.queries.resize(num, [0.0; CODE_BITS]);
        if !self.has_descriptors {
            return;
        }
        self.mean.clear();
        self.mean.resize(channels, 0.0);
        for (query, tokens) in self
            .queries
            .iter_mut()
            .zip(features.segment_descriptors_nsd.chunks_exact(row))
        {
            self.mean.fill(0.0);
            for token in tokens.chunks_exact(channels) {
                for (m, t) in self.mean.iter_mut().zip(token) {
                    *m += t;
                }
            }
            let norm = self.mean.iter().map(|m| m * m).sum::<f32>().sqrt();
            for m in &mut self.mean {
                *m /= norm.max(f32::MIN_POSITIVE);
            }
            landmarks.line_code.query(&self.mean, query);
        }
    }

    /// Lines of the last search that are long enough to be found.
    pub(super) fn num_visible(&self) -> u32 {
        self.num_visible
    }

    /// Pairs each segment with the line that fits best.
    pub(super) fn find(
        &mut self,
        landmarks: &Landmarks,
        features: &FeatureSet,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        window: LineWindow,
        out: &mut Vec<LineCorrespondence>,
    ) {
        out.clear();
        self.num_visible = 0;
        if !window.wanted {
            return;
        }
        self.see(features, camera);
        self.project(landmarks, camera, cam_from_world);
        for seen in &self.seen {
            let mut best: Option<(f64, &Projected, f32)> = None;
            for line in &self.projected {
                let Some(distance) = distance(seen, line, window.distance) else {
                    continue;
                };
                let alike = if self.has_descriptors {
                    let code = &landmarks.line_codes[line.landmark as usize];
                    similarity(&self.queries[seen.segment as usize], code)
                } else {
                    2.0 * LEAST_SIMILARITY
                };
                if alike < LEAST_SIMILARITY {
                    continue;
                }
                let score = f64::from(alike) - DISTANCE_COST * distance / window.distance;
                if best.is_none_or(|b| score > b.0) {
                    best = Some((score, line, alike));
                }
            }
            let Some((_, line, alike)) = best else {
                continue;
            };
            let landmark = &landmarks.lines[line.landmark as usize];
            let segment = &features.segments[seen.segment as usize];
            let (slope, middle) = BELIEF;
            out.push(LineCorrespondence {
                start: segment.start,
                end: segment.end,
                start_in_world: landmark.start_in_world,
                end_in_world: landmark.end_in_world,
                confidence: logistic(slope * (f64::from(alike) - middle)) as f32,
                sigma_m: landmark.sigma as f32,
                sigma_px: 0.0,
            });
        }
    }

    /// The frame's segments in the ideal plane.
    fn see(&mut self, features: &FeatureSet, camera: &Camera) {
        let (fx, fy) = camera.focal_px();
        let ideal = |p: Pixel| -> Option<Vector2<f64>> {
            let b = camera.bearing_from_pixel(p)?;
            (b.z > MIN_BEARING_Z).then(|| Vector2::new(fx * b.x / b.z, fy * b.y / b.z))
        };
        self.seen.clear();
        for (i, s) in features.segments.iter().enumerate() {
            let (Some(start), Some(end)) = (ideal(s.start), ideal(s.end)) else {
                continue;
            };
            let length = (end - start).norm();
            if length > 1.0 {
                self.seen.push(Seen {
                    start,
                    end,
                    direction: (end - start) / length,
                    length,
                    segment: i as u32,
                });
            }
        }
    }

    /// The map's lines that the pose shows.
    fn project(&mut self, landmarks: &Landmarks, camera: &Camera, cam_from_world: &CamFromWorld) {
        let (fx, fy) = camera.focal_px();
        let center = cam_from_world.center_in_world();
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let min_visible = MIN_VISIBLE_PX * width.max(height) / 640.0;
        let flat = |z: &Vector3<f64>| Vector2::new(fx * z.x / z.z, fy * z.y / z.z);
        let is_inside = |z: &Vector3<f64>| {
            camera
                .pixel_from_cam(z)
                .is_some_and(|p| p.x >= 0.0 && p.y >= 0.0 && p.x < width && p.y < height)
        };
        self.projected.clear();
        for (i, line) in landmarks.lines.iter().enumerate() {
            let middle = 0.5 * (line.start_in_world + line.end_in_world);
            let away = center - middle;
            if !line.visibility.holds(&away) {
                continue;
            }
            let near = MIN_DEPTH * away.norm();
            let mut ends = [
                cam_from_world.transform_point(&line.start_in_world),
                cam_from_world.transform_point(&line.end_in_world),
            ];
            if !(ends[0].z.max(ends[1].z) > near) {
                continue;
            }
            for k in 0..2 {
                let (here, other) = (ends[k], ends[1 - k]);
                if here.z < near {
                    ends[k] = here + (other - here) * ((near - here.z) / (other.z - here.z));
                }
            }
            let (start, end) = (flat(&ends[0]), flat(&ends[1]));
            let length = (end - start).norm();
            if !(length > 1.0) {
                continue;
            }
            let quarter = |t: f64| is_inside(&(ends[0] + (ends[1] - ends[0]) * t));
            let is_clear = quarter(0.2) && quarter(0.5) && quarter(0.8);
            self.num_visible += u32::from(is_clear && length > min_visible);
            self.projected.push(Projected {
                start,
                direction: (end - start) / length,
                length,
                landmark: i as u32,
            });
        }
    }
}

/// Mean distance of a segment's ends from a line; `None` when it is too far, runs another way or lies beside its end.
#[inline]
fn distance(seen: &Seen, line: &Projected, limit: f64) -> Option<f64> {
    if seen.direction.dot(&line.direction) < MIN_COS {
        return None;
    }
    let (a, b) = (seen.start - line.start, seen.end - line.start);
    let (da, db) = (line.direction.perp(&a).abs(), line.direction.perp(&b).abs());
    if da.max(db) > limit {
        return None;
    }
    let (from, to) = (line.direction.dot(&a), line.direction.dot(&b));
    let overlap = to.min(line.length) - from.max(0.0);
    (overlap >= MIN_OVERLAP * seen.length.min(line.length)).then_some(0.5 * (da + db))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(start: (f64, f64), end: (f64, f64)) -> Seen {
        let (start, end) = (Vector2::new(start.0, start.1), Vector2::new(end.0, end.1));
        let length = (end - start).norm();
        Seen {
            start,
            end,
            direction: (end - start) / length,
            length,
            segment: 0,
        }
    }

    #[test]
    fn distance_direction_and_overlap_decide() {
        let line = Projected {
            start: Vector2::new(10.0, 0.0),
            direction: Vector2::x(),
            length: 100.0,
            landmark: 0,
        };
        let found = |start, end| distance(&seen(start, end), &line, 5.0);
        assert_eq!(found((20.0, 2.0), (80.0, 4.0)), Some(3.0));
        assert_eq!(found((80.0, 2.0), (20.0, 2.0)), None, "other polarity");
        assert_eq!(found((20.0, 6.0), (80.0, 4.0)), None, "too far");
        assert_eq!(found((20.0, 0.0), (30.0, 4.0)), None, "another direction");
        assert_eq!(found((105.0, 1.0), (140.0, 1.0)), None, "beside the end");
        assert_eq!(
            found((-300.0, 1.0), (300.0, 1.0)),
            Some(1.0),
            "longer than the line"
        );
    }
}
