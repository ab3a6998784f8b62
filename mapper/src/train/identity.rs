//! What a run folder's state belongs to: the options of the run, and everything that it learns from.

use super::run::RunOptions;
use crate::labels::Labels;
use landline::features::FeatureSet;
use landline::geometry::CamFromWorld;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// Of a run. Two runs of one identity take the same steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Identity {
    /// As given.
    pub(super) options: RunOptions,
    /// SHA-256 of the labels' pictures, features and tracks, and of the extractor that they are of.
    pub(super) labels_sha256: String,
}

impl Identity {
    /// Of a run with these options on these labels.
    pub(super) fn new(options: &RunOptions, labels: &Labels) -> Self {
        let mut hash = Numbers(Sha256::new());
        hash.text(&labels.origin.extractor_sha256);
        hash.count(labels.origin.working_max_side as usize);
        hash.count(labels.map.views.len());
        for view in &labels.map.views {
            hash.text(&view.name);
            // Every digit of every parameter, whatever the model.
            hash.text(&format!("{:?}", view.camera));
            hash.pose(view.cam_from_world.as_ref());
            hash.features(&view.features);
        }
        hash.count(labels.variants.len());
        for variant in &labels.variants {
            hash.count(variant.of_view as usize);
            hash.features(&variant.features);
        }
        hash.count(labels.map.points.len());
        for track in &labels.map.points {
            track.point_in_world.iter().for_each(|v| hash.real(v));
            hash.observations(&track.observations);
        }
        hash.count(labels.map.lines.len());
        for track in &labels.map.lines {
            let ends = track.start_in_world.iter().chain(&track.end_in_world);
            ends.for_each(|v| hash.real(v));
            hash.observations(&track.observations);
        }
        Self {
            options: options.clone(),
            labels_sha256: format!("{:x}", hash.0.finalize()),
        }
    }

    /// Says in what another one differs, if it does.
    pub(super) fn difference(&self, other: &Self) -> Option<&'static str> {
        match (
            self.options == other.options,
            self.labels_sha256 == other.labels_sha256,
        ) {
            (true, true) => None,
            (false, true) => Some("other options"),
            (true, false) => Some("other pictures, features or tracks"),
            (false, false) => Some("other options and other pictures, features or tracks"),
        }
    }
}

/// Numbers by their bits, lists by their length first.
struct Numbers(Sha256);

impl Numbers {
    fn count(&mut self, n: usize) {
        self.0.update((n as u64).to_le_bytes());
    }
    fn real(&mut self, v: &f64) {
        self.0.update(v.to_bits().to_le_bytes());
    }
    fn reals32(&mut self, values: &[f32]) {
        self.count(values.len());
        for v in values {
            self.0.update(v.to_bits().to_le_bytes());
        }
    }
    fn text(&mut self, text: &str) {
        self.count(text.len());
        self.0.update(text.as_bytes());
    }
    fn pose(&mut self, pose: Option<&CamFromWorld>) {
        self.count(usize::from(pose.is_some()));
        if let Some(pose) = pose {
            let numbers = pose.rotation.iter().chain(pose.translation.iter());
            numbers.for_each(|v| self.real(v));
        }
    }
    fn features(&mut self, features: &FeatureSet) {
        self.count(features.keypoints.len());
        for k in &features.keypoints {
            self.real(&k.pixel.x);
            self.real(&k.pixel.y);
        }
        self.reals32(&features.descriptors_nd);
        self.count(features.segments.len());
        for s in &features.segments {
            for v in [s.start.x, s.start.y, s.end.x, s.end.y] {
                self.real(&v);
            }
        }
        self.reals32(&features.segment_descriptors_nsd);
    }
    fn observations(&mut self, seen: &[landline::reconstruction::Observation]) {
        self.count(seen.len());
        for o in seen {
            self.count(o.view as usize);
            self.count(o.feature as usize);
        }
    }
}
