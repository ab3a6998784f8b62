//! Full matching: what a program reaches that keeps every descriptor of every taught picture (the way of hloc: Sarlin et al., *From
//! coarse to fine*, CVPR 2019). The most similar pictures by VLAD (Jégou et al., CVPR 2010), mutual nearest neighbours with each,
//! their 3D points, the same solver. A bound to measure against: it takes megabytes a place and a second a picture.

use landline::features::FeatureSet;
use landline::math::Rng;
use landline::pose::PointCorrespondence;
use landline::reconstruction::{MutualMatcher, Reconstruction, ViewTargets};

/// Pictures that are matched with.
pub const NUM_PICTURES: usize = 15;
/// Words of the vocabulary, and rounds of its making.
const WORDS: usize = 64;
const ROUNDS: usize = 8;
/// Descriptors that it is made of.
const SAMPLE: usize = 20_000;
/// Least cosine of a match.
const MIN_COSINE: f32 = 0.8;

/// A place with all that it was taught with.
pub struct FullMatching<'a> {
    map: &'a Reconstruction,
    targets: Vec<ViewTargets>,
    channels: usize,
    words: Vec<f32>,
    table: Vec<Vec<f32>>,
}

fn normalise(v: &mut [f32]) {
    let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    if norm > 0.0 {
        v.iter_mut().for_each(|x| *x /= norm);
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

impl<'a> FullMatching<'a> {
    /// Describes the taught pictures.
    pub fn new(map: &'a Reconstruction) -> Self {
        let channels = map.descriptor_channels().max(1);
        let mut out = Self {
            map,
            targets: map.targets(),
            channels,
            words: Vec::new(),
            table: Vec::new(),
        };
        out.learn_words();
        out.table = map.views.iter().map(|v| out.vlad(&v.features)).collect();
        out
    }

    /// k-means over a sample of the descriptors, with words of unit length.
    fn learn_words(&mut self) {
        let all: Vec<&[f32]> = self
            .map
            .views
            .iter()
            .flat_map(|v| v.features.descriptors_nd.chunks_exact(self.channels))
            .collect();
        if all.is_empty() {
            return;
        }
        let mut rng = Rng::from_seed(1);
        let sample: Vec<&[f32]> = (0..SAMPLE.min(all.len()))
            .map(|_| all[rng.below(all.len() as u32) as usize])
            .collect();
        self.words = sample
            .iter()
            .take(WORDS)
            .flat_map(|d| d.iter().copied())
            .collect();
        for _ in 0..ROUNDS {
            let mut sums = vec![0.0; self.words.len()];
            for descriptor in &sample {
                let at = self.nearest_word(descriptor) * self.channels;
                for (s, d) in sums[at..].iter_mut().zip(*descriptor) {
                    *s += d;
                }
            }
            for (word, sum) in self
                .words
                .chunks_exact_mut(self.channels)
                .zip(sums.chunks_exact_mut(self.channels))
            {
                if sum.iter().any(|s| *s != 0.0) {
                    normalise(sum);
                    word.copy_from_slice(sum);
                }
            }
        }
    }

    fn nearest_word(&self, descriptor: &[f32]) -> usize {
        let alike = self
            .words
            .chunks_exact(self.channels)
            .map(|w| dot(w, descriptor));
        let best = alike.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or(0, |(word, _)| word)
    }

    /// Residuals to the nearest words, normalised word by word and altogether.
    fn vlad(&self, features: &FeatureSet) -> Vec<f32> {
        let mut out = vec![0.0; self.words.len()];
        for descriptor in features.descriptors_nd.chunks_exact(self.channels) {
            let at = self.nearest_word(descriptor) * self.channels;
            let word = &self.words[at..at + self.channels];
            for ((o, d), w) in out[at..].iter_mut().zip(descriptor).zip(word) {
                *o += d - w;
            }
        }
        out.chunks_exact_mut(self.channels).for_each(normalise);
        normalise(&mut out);
        out
    }

    /// Keypoints with the points of those that they match in the most similar pictures; several of one keypoint are alternatives.
    pub fn correspond(&self, features: &FeatureSet) -> Vec<PointCorrespondence> {
        let own = self.vlad(features);
        let mut order: Vec<(f32, usize)> =
            self.table.iter().map(|v| dot(v, &own)).zip(0..).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut matcher = MutualMatcher::default();
        matcher.set_first(features);
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (_, view) in order.into_iter().take(NUM_PICTURES) {
            let matches = matcher.matches(&self.map.views[view].features, MIN_COSINE);
            let targets = &self.targets[view].points;
            pairs.extend(matches.filter_map(|(keypoint, other, _)| {
                Some((keypoint, targets.get(other as usize).copied().flatten()?))
            }));
        }
        pairs.sort_unstable();
        pairs.dedup();
        pairs
            .into_iter()
            .filter_map(|(keypoint, point)| {
                Some(PointCorrespondence {
                    pixel: features.keypoints.get(keypoint as usize)?.pixel,
                    point_in_world: self.map.points.get(point as usize)?.point_in_world,
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
    use nalgebra::Vector3;

    #[test]
    fn a_taught_picture_is_matched_with_its_own_points() {
        let mut rng = Rng::from_seed(4);
        let mut features = || {
            let mut descriptors_nd: Vec<f32> = (0..40 * 16).map(|_| rng.normal() as f32).collect();
            descriptors_nd.chunks_exact_mut(16).for_each(normalise);
            FeatureSet {
                keypoints: (0..40)
                    .map(|i| Keypoint {
                        pixel: Pixel::new(f64::from(i), 1.0),
                        score: 1.0,
                    })
                    .collect(),
                descriptors_nd,
                descriptor_channels: 16,
                ..FeatureSet::default()
            }
        };
        let views: Vec<View> = (0..20)
            .map(|i| View {
                name: i.to_string(),
                camera: Camera::centered(64, 48, 50.0),
                cam_from_world: Some(CamFromWorld::identity()),
                features: features(),
            })
            .collect();
        // Keypoint 3 of each picture sees a point of its own.
        let points = (0..20)
            .map(|i| {
                PointTrack::new(
                    Vector3::new(i as f64, 0.0, 2.0),
                    vec![Observation::new(i, 3)],
                )
            })
            .collect();
        let map = Reconstruction {
            views,
            points,
            ..Reconstruction::default()
        };
        let peer = FullMatching::new(&map);
        for i in [0, 7, 19] {
            let found = peer.correspond(&map.views[i].features);
            let of_keypoint: Vec<f64> = found
                .iter()
                .filter(|c| c.pixel.x == 3.0)
                .map(|c| c.point_in_world.x)
                .collect();
            assert!(of_keypoint.contains(&(i as f64)), "{of_keypoint:?}");
        }
    }
}
