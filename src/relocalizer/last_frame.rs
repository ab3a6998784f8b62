//! What the last frame left behind: its correspondences and segments, and which of them agree with the pose.

use super::Relocalizer;
use crate::geometry::Segment2;
use crate::math::stats::median_in_place;
use crate::pose::{LineCorrespondence, PointCorrespondence};

impl Relocalizer {
    /// Point correspondences of the last frame, in pixels of the frame, and whether they agree with the pose.
    pub fn points(&self) -> impl Iterator<Item = (PointCorrespondence, bool)> + '_ {
        let sensor = self.working_from_sensor.inverse();
        self.points
            .iter()
            .zip(&self.is_point_inlier)
            .map(move |(c, is_inlier)| {
                let pixel = sensor.apply(c.pixel);
                (PointCorrespondence { pixel, ..*c }, *is_inlier)
            })
    }

    /// Line correspondences of the last frame, in pixels of the frame, and whether they agree with the pose.
    pub fn lines(&self) -> impl Iterator<Item = (LineCorrespondence, bool)> + '_ {
        let sensor = self.working_from_sensor.inverse();
        self.lines
            .iter()
            .zip(&self.is_line_inlier)
            .map(move |(c, is_inlier)| {
                let (start, end) = (sensor.apply(c.start), sensor.apply(c.end));
                (LineCorrespondence { start, end, ..*c }, *is_inlier)
            })
    }

    /// Segments of the last frame, in pixels of the frame.
    pub fn segments(&self) -> impl Iterator<Item = Segment2> + '_ {
        let sensor = self.working_from_sensor.inverse();
        self.front_end
            .features()
            .segments
            .iter()
            .map(move |s| s.mapped(&sensor))
    }

    /// Marks what agrees with the pose; the median error of what does, in pixels of the working image.
    pub(super) fn mark_inliers(&mut self) -> f64 {
        let inliers = self.pose.inliers();
        mark(
            &inliers.points,
            self.points.len(),
            &mut self.is_point_inlier,
        );
        mark(&inliers.lines, self.lines.len(), &mut self.is_line_inlier);
        let points = self
            .pose
            .point_errors_px()
            .iter()
            .zip(&self.is_point_inlier);
        let lines = self.pose.line_errors_px().iter().zip(&self.is_line_inlier);
        self.errors_px.clear();
        self.errors_px.extend(
            points
                .filter(|(_, is_inlier)| **is_inlier)
                .map(|(e, _)| f64::from(*e)),
        );
        // A line has an error at each end; their mean is comparable with a point's.
        self.errors_px.extend(
            lines
                .filter(|(_, is_inlier)| **is_inlier)
                .map(|([a, b], _)| f64::from(0.5 * (a + b))),
        );
        median_in_place(&mut self.errors_px).unwrap_or(0.0)
    }
}

/// Flags from indices.
pub(super) fn mark(indices: &[u32], num: usize, flags: &mut Vec<bool>) {
    flags.clear();
    flags.resize(num, false);
    for i in indices {
        if let Some(flag) = flags.get_mut(*i as usize) {
            *flag = true;
        }
    }
}

pub(super) fn count(flags: &[bool]) -> usize {
    flags.iter().filter(|f| **f).count()
}
