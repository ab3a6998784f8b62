//! Points and lines in space with what sees them, and the reconstruction that they make up with their views.

use super::lines::runs_against;
use super::{PosedView, View};
use crate::features::FeatureSet;
use crate::geometry::Units;
use nalgebra::Vector3;

/// A feature of a view that sees a track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Observation {
    /// Index of the view.
    pub view: u32,
    /// Index of the keypoint or segment in that view's features.
    pub feature: u32,
}

impl Observation {
    /// A feature of a view.
    pub fn new(view: usize, feature: usize) -> Self {
        Self {
            view: view as u32,
            feature: feature as u32,
        }
    }
}

/// One 3D point and the keypoints that see it.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTrack {
    /// Triangulated position.
    pub point_in_world: Vector3<f64>,
    /// Sorted, at most one a view.
    pub observations: Vec<Observation>,
    /// Mean of the observations' descriptors, of unit length; empty until [`describe_points`].
    pub descriptor: Vec<f32>,
    /// Mean reprojection error over the observations; NaN until [`describe_points`].
    pub mean_error_px: f32,
}

impl PointTrack {
    /// A track whose descriptor and error are not worked out yet.
    pub fn new(point_in_world: Vector3<f64>, observations: Vec<Observation>) -> Self {
        Self {
            point_in_world,
            observations,
            descriptor: Vec::new(),
            mean_error_px: f32::NAN,
        }
    }
}

/// One 3D segment and the image segments that see it.
#[derive(Debug, Clone, PartialEq)]
pub struct LineTrack {
    /// One end; which one is arbitrary.
    pub start_in_world: Vector3<f64>,
    /// The other end.
    pub end_in_world: Vector3<f64>,
    /// Sorted; a view may see it in pieces.
    pub observations: Vec<Observation>,
    /// Mean over observations and samples of the segment descriptors, of unit length; empty until [`describe_lines`].
    pub descriptor: Vec<f32>,
    /// Mean distance of the observed ends to the projected infinite line; NaN until [`describe_lines`].
    pub mean_error_px: f32,
}

impl LineTrack {
    /// A track whose descriptor and error are not worked out yet.
    pub fn new(ends_in_world: [Vector3<f64>; 2], observations: Vec<Observation>) -> Self {
        let [start_in_world, end_in_world] = ends_in_world;
        Self {
            start_in_world,
            end_in_world,
            observations,
            descriptor: Vec::new(),
            mean_error_px: f32::NAN,
        }
    }
}

/// A segment's 3D target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SegmentTarget {
    /// Index into [`Reconstruction::lines`].
    pub track: u32,
    /// The track's end belongs to the segment's start.
    pub reversed: bool,
}

/// For each feature of a view the track that it sees: the observations the other way round.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ViewTargets {
    /// Index into [`Reconstruction::points`] for each keypoint that has one.
    pub points: Vec<Option<u32>>,
    /// For each segment that has one.
    pub segments: Vec<Option<SegmentTarget>>,
}

/// Views and the tracks that they see.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reconstruction {
    /// Pictures, posed or not, in the data set's order.
    pub views: Vec<View>,
    /// 3D points.
    pub points: Vec<PointTrack>,
    /// 3D segments.
    pub lines: Vec<LineTrack>,
    /// Unit of the world's lengths.
    pub units: Units,
    /// Direction of gravity in the world, a unit vector, if known.
    pub gravity: Option<Vector3<f64>>,
}

impl Reconstruction {
    /// Numbers in a descriptor; 0 without views.
    pub fn descriptor_channels(&self) -> usize {
        self.largest(|f| f.descriptor_channels)
    }

    /// Samples along a segment; 0 without views.
    pub fn tokens(&self) -> usize {
        self.largest(|f| f.tokens)
    }

    fn largest(&self, of: impl Fn(&FeatureSet) -> usize) -> usize {
        self.views
            .iter()
            .map(|v| of(&v.features))
            .max()
            .unwrap_or(0)
    }

    /// Targets of every view's features. Observations of features that do not exist have none.
    pub fn targets(&self) -> Vec<ViewTargets> {
        let mut targets: Vec<ViewTargets> = self
            .views
            .iter()
            .map(|v| ViewTargets {
                points: vec![None; v.features.keypoints.len()],
                segments: vec![None; v.features.segments.len()],
            })
            .collect();
        for (track, point) in (0..).zip(&self.points) {
            for o in &point.observations {
                let of_view = targets.get_mut(o.view as usize);
                if let Some(slot) = of_view.and_then(|t| t.points.get_mut(o.feature as usize)) {
                    *slot = Some(track);
                }
            }
        }
        for (track, line) in (0..).zip(&self.lines) {
            for o in &line.observations {
                let reversed = self.is_reversed(line, *o);
                let of_view = targets.get_mut(o.view as usize);
                if let Some(slot) = of_view.and_then(|t| t.segments.get_mut(o.feature as usize)) {
                    *slot = Some(SegmentTarget { track, reversed });
                }
            }
        }
        targets
    }

    /// Whether a line runs against the segment that observes it; false where that cannot be told.
    pub fn is_reversed(&self, line: &LineTrack, observation: Observation) -> bool {
        let of_view = || {
            let view = self.views.get(observation.view as usize)?;
            let segment = view.features.segments.get(observation.feature as usize)?;
            Some((view, view.cam_from_world?, segment))
        };
        of_view().is_some_and(|(view, cam_from_world, segment)| {
            runs_against(&view.camera, &cam_from_world, segment, line)
        })
    }

    /// The 3D ends of a segment's target in the order of the segment's own ends.
    pub fn segment_target_ends(&self, target: SegmentTarget) -> Option<[Vector3<f64>; 2]> {
        let line = self.lines.get(target.track as usize)?;
        Some(if target.reversed {
            [line.end_in_world, line.start_in_world]
        } else {
            [line.start_in_world, line.end_in_world]
        })
    }

    /// The best `most` point tracks, best first ([`super::cover`]).
    pub fn landmarks(&self, most: usize) -> Vec<usize> {
        let observations: Vec<&[Observation]> = self
            .points
            .iter()
            .map(|p| p.observations.as_slice())
            .collect();
        let error = |track: usize| self.points[track].mean_error_px;
        super::cover(&observations, error, self.views.len(), most)
    }
}

/// Mean of rows of descriptors, of unit length; each item is one or several rows of `channels` numbers.
pub(super) fn unit_mean<'a>(rows: impl Iterator<Item = &'a [f32]>, channels: usize) -> Vec<f32> {
    let mut mean = vec![0.0f32; channels];
    for row in rows.flat_map(|r| r.chunks_exact(channels.max(1))) {
        for (sum, x) in mean.iter_mut().zip(row) {
            *sum += x;
        }
    }
    let norm = mean.iter().map(|x| x * x).sum::<f32>().sqrt();
    if norm > 0.0 {
        mean.iter_mut().for_each(|x| *x /= norm);
    }
    mean
}

/// Works out descriptor and mean error of tracks that observe these views.
pub fn describe_points(views: &[PosedView<'_>], tracks: &mut [PointTrack]) {
    for track in tracks {
        track.descriptor = point_descriptor(views, &track.observations);
        let sum: f64 = track
            .observations
            .iter()
            .filter_map(|o| Some((views.get(o.view as usize)?, o.feature as usize)))
            .map(|(view, keypoint)| view.error_px(keypoint, &track.point_in_world))
            .sum();
        track.mean_error_px = (sum / track.observations.len().max(1) as f64) as f32;
    }
}

/// Works out descriptor and mean error of tracks that observe these views.
pub fn describe_lines(views: &[PosedView<'_>], tracks: &mut [LineTrack]) {
    for track in tracks {
        track.descriptor = line_descriptor(views, &track.observations);
        track.mean_error_px = super::lines::mean_error_px(views, track) as f32;
    }
}

/// Mean descriptor of keypoints, of unit length.
pub(super) fn point_descriptor(views: &[PosedView<'_>], observations: &[Observation]) -> Vec<f32> {
    let channels = views.first().map_or(0, |v| v.features.descriptor_channels);
    let rows = observations.iter().filter_map(|o| {
        views
            .get(o.view as usize)?
            .features
            .descriptor(o.feature as usize)
    });
    unit_mean(rows, channels)
}

/// Mean descriptor of segments over all their samples, of unit length.
pub(super) fn line_descriptor(views: &[PosedView<'_>], observations: &[Observation]) -> Vec<f32> {
    let channels = views.first().map_or(0, |v| v.features.descriptor_channels);
    let rows = observations.iter().filter_map(|o| {
        let features = views.get(o.view as usize)?.features;
        features.segment_descriptors(o.feature as usize)
    });
    unit_mean(rows, channels)
}
