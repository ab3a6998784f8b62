//! The nearest-landmark baseline: mean descriptors of the best tracks, stored as a scene file of the same size could store
//! them (8-bit descriptors, 16-bit positions), matched by nearest neighbour with a ratio test, solved by the same solver.

use half::f16;
use landline::features::FeatureSet;
use landline::pose::PointCorrespondence;
use landline::reconstruction::Reconstruction;
use nalgebra::{DMatrix, Vector3};

/// Largest distance (1 - cosine) to the nearest landmark, relative to that of the second.
const MAX_RATIO: f32 = 0.95;
/// Least cosine to the nearest landmark.
const MIN_COSINE: f32 = 0.8;

/// Landmarks that fit a number of bytes: one byte a descriptor number, two a coordinate.
pub fn baseline_size(num_bytes: usize, descriptor_len: usize) -> usize {
    num_bytes / (descriptor_len + 6)
}

/// A map of landmarks.
#[derive(Debug, Clone)]
pub struct Landmarks {
    descriptors_dn: DMatrix<f32>,
    points_in_world: Vec<Vector3<f64>>,
}

impl Landmarks {
    /// The best tracks ([`Reconstruction::landmarks`]), rounded as they would be stored.
    pub fn from_map(map: &Reconstruction, most: usize) -> Self {
        let order = map.landmarks(most);
        let d = map.descriptor_channels();
        let mut middle = Vector3::zeros();
        for i in &order {
            middle += map.points[*i].point_in_world / order.len() as f64;
        }
        let mut descriptors_dn = DMatrix::zeros(d, order.len());
        let mut points_in_world = Vec::with_capacity(order.len());
        for (column, i) in order.iter().enumerate() {
            let track = &map.points[*i];
            let largest = track.descriptor.iter().fold(0f32, |m, v| m.max(v.abs()));
            let step = if largest > 0.0 { largest / 127.0 } else { 1.0 };
            for (row, v) in track.descriptor.iter().enumerate() {
                descriptors_dn[(row, column)] = (v / step).round() * step;
            }
            let mut stored = descriptors_dn.column_mut(column);
            let norm = stored.norm();
            if norm > 0.0 {
                stored /= norm;
            }
            let offset = track.point_in_world - middle;
            points_in_world.push(middle + offset.map(|v| f16::from_f64(v).to_f64()));
        }
        Self {
            descriptors_dn,
            points_in_world,
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.points_in_world.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points_in_world.is_empty()
    }

    /// Pairs keypoints with their nearest landmarks where the second nearest is clearly farther.
    pub fn correspond(&self, features: &FeatureSet) -> Vec<PointCorrespondence> {
        let d = features.descriptor_channels;
        let n = features.keypoints.len();
        if self.len() < 2
            || d != self.descriptors_dn.nrows()
            || features.descriptors_nd.len() != n * d
        {
            return Vec::new();
        }
        let queries_dn = DMatrix::from_column_slice(d, n, &features.descriptors_nd);
        let similarity = self.descriptors_dn.transpose() * queries_dn;
        similarity
            .column_iter()
            .zip(&features.keypoints)
            .filter_map(|(column, keypoint)| {
                let (mut best, mut second) = ((f32::MIN, 0), f32::MIN);
                for (i, v) in column.iter().enumerate() {
                    if *v > best.0 {
                        second = best.0;
                        best = (*v, i);
                    } else if *v > second {
                        second = *v;
                    }
                }
                let is_clear = best.0 > MIN_COSINE && 1.0 - best.0 < MAX_RATIO * (1.0 - second);
                let point_in_world = *self.points_in_world.get(best.1)?;
                is_clear.then_some(PointCorrespondence {
                    pixel: keypoint.pixel,
                    point_in_world,
                    // All alike, as in plain matching.
                    confidence: 0.5,
                    sigma_m: 0.0,
                    sigma_px: 0.0,
                })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::features::Keypoint;
    use landline::geometry::{CamFromWorld, Camera, Pixel};
    use landline::reconstruction::{Observation, PointTrack, View};

    #[test]
    fn keeps_the_best_tracks_and_refuses_unclear_matches() {
        let track = |x: f64, descriptor: Vec<f32>, n: usize| PointTrack {
            descriptor,
            mean_error_px: 1.0,
            ..PointTrack::new(
                Vector3::new(x, 0.0, 2.0),
                (0..n).map(|view| Observation::new(view, 0)).collect(),
            )
        };
        let view = View {
            name: String::new(),
            camera: Camera::centered(4, 4, 4.0),
            cam_from_world: Some(CamFromWorld::identity()),
            features: FeatureSet {
                descriptor_channels: 3,
                ..FeatureSet::default()
            },
        };
        let map = Reconstruction {
            points: vec![
                track(0.0, vec![1.0, 0.0, 0.0], 3),
                track(1.0, vec![0.0, 1.0, 0.0], 9),
                track(2.0, vec![0.0, 0.6, 0.8], 5),
            ],
            views: vec![view; 9],
            ..Reconstruction::default()
        };
        let landmarks = Landmarks::from_map(&map, 2);
        assert_eq!(landmarks.len(), 2);
        let features = FeatureSet {
            keypoints: [1.5, 2.5, 3.5]
                .map(|x| Keypoint {
                    pixel: Pixel::new(x, 0.5),
                    score: 1.0,
                })
                .to_vec(),
            // The second lies between both landmarks, the third near none.
            descriptors_nd: vec![0.0, 1.0, 0.0, 0.0, 0.894, 0.447, 1.0, 0.0, 0.0],
            descriptor_channels: 3,
            ..FeatureSet::default()
        };
        let found = landmarks.correspond(&features);
        assert_eq!(found.len(), 1);
        assert!((found[0].point_in_world.x - 1.0).abs() < 1e-3);
        assert_eq!(baseline_size(140_000, 64), 2000);
    }
}
