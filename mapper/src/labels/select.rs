//! Which tracks to keep when there is room for few: those that together cover all pictures evenly.

use super::{Labels, Observation};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A track and what it would add.
struct Candidate {
    gain: f64,
    track: usize,
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Candidate {}
impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.gain
            .total_cmp(&other.gain)
            .then(other.track.cmp(&self.track))
    }
}

/// Errors below this say no more about a track: keypoints are whole pixels.
const LEAST_ERROR_PX: f64 = 0.25;

/// Greedy cover of the pictures by tracks, best first.
///
/// The next track is the one with the largest sum, over the pictures that see it, of one by the number of tracks that these
/// pictures already have, divided by its reprojection error. Taking the longest tracks instead crowds them where the camera
/// stayed longest (RedKitchen, 2,000 landmarks, every second frame of 800-899: median 1.44 cm by length, 0.98 cm by cover).
/// Tracks without observations are never chosen.
pub fn cover(
    observations: &[&[Observation]],
    errors_px: impl Fn(usize) -> f32,
    num_images: usize,
    most: usize,
) -> Vec<usize> {
    let mut covered = vec![0u32; num_images];
    let gain = |track: usize, covered: &[u32]| -> f64 {
        let sum: f64 = observations[track]
            .iter()
            .filter_map(|o| covered.get(o.image as usize))
            .map(|n| 1.0 / f64::from(1 + n))
            .sum();
        sum / f64::from(errors_px(track)).max(LEAST_ERROR_PX)
    };
    let mut heap: BinaryHeap<Candidate> = (0..observations.len())
        .filter(|track| !observations[*track].is_empty())
        .map(|track| Candidate {
            gain: gain(track, &covered),
            track,
        })
        .collect();
    let mut chosen = Vec::with_capacity(most.min(heap.len()));
    while chosen.len() < most {
        let Some(mut best) = heap.pop() else { break };
        // Gains only shrink: one that is still on top after a fresh look is the largest.
        best.gain = gain(best.track, &covered);
        if heap.peek().is_some_and(|next| next.gain > best.gain) {
            heap.push(best);
            continue;
        }
        for o in observations[best.track] {
            if let Some(n) = covered.get_mut(o.image as usize) {
                *n += 1;
            }
        }
        chosen.push(best.track);
    }
    chosen
}

impl Labels {
    /// The best `most` point tracks, best first ([`cover`]).
    pub fn landmarks(&self, most: usize) -> Vec<usize> {
        let observations: Vec<&[Observation]> = self
            .points
            .iter()
            .map(|p| p.observations.as_slice())
            .collect();
        let error = |track: usize| self.points[track].mean_error_px;
        cover(&observations, error, self.images.len(), most)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{LabelledImage, PointTrack};
    use super::*;
    use landline::geometry::{CamFromWorld, Camera};
    use nalgebra::Vector3;

    #[test]
    fn covers_every_picture_before_it_piles_up_on_one() {
        let image = LabelledImage {
            name: String::new(),
            camera: Camera::centered(4, 4, 4.0),
            cam_from_world: CamFromWorld::identity(),
            pixels: Vec::new(),
            scores: Vec::new(),
            descriptors_nd: Vec::new(),
            point_targets: Vec::new(),
            segments: Vec::new(),
            segment_descriptors_nsd: Vec::new(),
            segment_targets: Vec::new(),
        };
        let track = |images: &[u32], mean_error_px| PointTrack {
            point_in_world: Vector3::zeros(),
            observations: images
                .iter()
                .map(|&image| Observation { image, feature: 0 })
                .collect(),
            descriptor: Vec::new(),
            mean_error_px,
        };
        let labels = Labels {
            images: vec![image; 6],
            points: vec![
                track(&[0, 1, 2, 3], 1.0),
                track(&[0, 1, 2, 3], 1.0),
                track(&[4, 5], 1.5),
                track(&[4, 5], 1.0),
            ],
            ..Labels::default()
        };
        // The second long track adds 4 * 1/2, the precise short one 2 * 1, and of equals the first goes first.
        assert_eq!(labels.landmarks(3), [0, 1, 3]);
        assert_eq!(labels.landmarks(9).len(), 4);
        let mut precise = labels;
        precise.points[3].mean_error_px = 0.9;
        assert_eq!(precise.landmarks(2), [0, 3]);
    }
}
