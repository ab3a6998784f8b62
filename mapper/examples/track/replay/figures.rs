//! What was shown, and figures over all frames.

use super::{Located, Video, marks};
use landline::geometry::{CamFromWorld, Pixel};
use landline_mapper::eval::PoseError;

/// What stands on the screen at a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shown {
    /// The frame.
    pub(crate) frame: usize,
    /// Of the pose; `None` without one or without a true one.
    pub(crate) error: Option<PoseError>,
    /// Median distance of the drawn points from where they belong, pixels.
    pub(crate) overlay_px: Option<f64>,
    /// The drawn points.
    drawn: Vec<Option<Pixel>>,
}

impl Shown {
    pub(super) fn at(
        frame: usize,
        pose: Option<CamFromWorld>,
        video: &Video,
        located: &[Option<Located>],
    ) -> Self {
        let picture = &video.pictures[frame];
        let Some(pose) = pose else {
            return Self {
                frame,
                ..Self::default()
            };
        };
        let project =
            |pose: &CamFromWorld, p| picture.camera.pixel_from_cam(&pose.transform_point(p));
        let marks = marks(frame, video, located);
        let drawn: Vec<Option<Pixel>> = marks.iter().map(|p| project(&pose, p)).collect();
        let truth = picture.cam_from_world;
        let mut distances: Vec<f64> = marks
            .iter()
            .zip(&drawn)
            .filter_map(|(p, drawn)| {
                let right = project(truth.as_ref()?, p)?;
                Some(drawn.map_or(f64::INFINITY, |d| d.distance(right)))
            })
            .collect();
        Self {
            frame,
            error: truth.map(|truth| PoseError::between(&pose, &truth)),
            overlay_px: quantile(&mut distances, 0.5),
            drawn,
        }
    }

    /// Median movement of the same marks from one frame to the next: for a still camera the trembling.
    pub(crate) fn movement_px(&self, before: &Self) -> Option<f64> {
        let pairs = self.drawn.iter().zip(&before.drawn);
        let mut moved: Vec<f64> = pairs
            .filter_map(|(a, b)| Some((*a)?.distance((*b)?)))
            .collect();
        quantile(&mut moved, 0.5)
    }
}

/// A quantile; reorders.
pub(crate) fn quantile(values: &mut [f64], fraction: f64) -> Option<f64> {
    landline::math::stats::quantile_in_place(values, fraction)
}

/// Figures over frames; one without a pose counts as infinitely far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figures {
    /// Frames, and those with a pose.
    pub(crate) frames: (usize, usize),
    /// Median and 90 % of the position, world units.
    pub(crate) position: [f64; 2],
    /// Median and 90 % of the rotation.
    pub(crate) rotation_deg: [f64; 2],
    /// Median and 90 % of the overlay.
    pub(crate) overlay_px: [f64; 2],
}

impl Figures {
    /// Sums up.
    pub(crate) fn of(shown: &[Shown]) -> Self {
        let of = |value: &dyn Fn(&Shown) -> Option<f64>| -> [f64; 2] {
            let mut values: Vec<f64> = shown
                .iter()
                .map(|s| value(s).unwrap_or(f64::INFINITY))
                .collect();
            [0.5, 0.9].map(|q| quantile(&mut values, q).unwrap_or(f64::NAN))
        };
        let with_pose = shown
            .iter()
            .filter(|s| !s.drawn.is_empty() || s.error.is_some());
        Self {
            frames: (shown.len(), with_pose.count()),
            position: of(&|s| s.error.map(|e| e.position)),
            rotation_deg: of(&|s| s.error.map(|e| e.rotation_deg)),
            overlay_px: of(&|s| s.overlay_px),
        }
    }

    /// One row of a table in Markdown.
    pub(crate) fn row(&self, name: &str) -> String {
        let [p50, p90] = self.position.map(|v| 100.0 * v);
        let [r50, r90] = self.rotation_deg;
        let [o50, o90] = self.overlay_px;
        let (all, with_pose) = self.frames;
        format!(
            "| {name} | {with_pose} of {all} | {p50:.2}, {p90:.2} | {r50:.3}, {r90:.3} | {o50:.2}, {o90:.2} |"
        )
    }

    /// Heading of the rows.
    pub(crate) const HEADING: &'static str = "| | frames with a pose | position, hundredths of a unit, median and 90 % | rotation, degrees | overlay, pixels |\n| --- | --- | --- | --- | --- |";
}
