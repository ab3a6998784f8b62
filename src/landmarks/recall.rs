//! A first pose without the networks: where they were wrong, or had too little to say.
//!
//! Each keypoint votes, with the landmark of the nearest code, for the clusters of views that saw it; keypoints are then matched
//! with the landmarks of the winners alone, so that those of other places do not confuse (Irschara et al., *From
//! structure-from-motion point clouds to fast location recognition*, CVPR 2009). Signs are compared with signs for the votes,
//! numbers with signs for the matches.

use super::Landmarks;
use super::code::{CODE_BITS, similarity};
use super::guided::{LEAST_SIMILARITY, NO_MATCH, belief};
use super::table::NO_CLUSTER;
use crate::features::FeatureSet;
use crate::math::order::sort_by_in;
use crate::pose::PointCorrespondence;

/// Clusters that win.
const WINNERS: usize = 8;

/// Buffers of the votes.
#[derive(Debug, Default)]
pub(super) struct Votes {
    signs: Vec<u64>,
    votes: Vec<(u32, u8)>,
    chosen: Vec<u32>,
    best_of_keypoint: Vec<u32>,
    best_of_landmark: Vec<(f32, u32)>,
}

/// The code of a query: bit `i` is set where number `i` is not negative.
fn signs(query: &[f32; CODE_BITS]) -> u64 {
    let numbers = query.iter().enumerate();
    numbers.fold(0, |code, (i, v)| code | (u64::from(*v >= 0.0) << i))
}

impl Votes {
    /// Pairs keypoints with landmarks of the clusters that they vote for.
    pub(super) fn correspond(
        &mut self,
        landmarks: &Landmarks,
        features: &FeatureSet,
        queries: &[[f32; CODE_BITS]],
        out: &mut Vec<PointCorrespondence>,
    ) {
        out.clear();
        self.signs.clear();
        self.signs.extend(queries.iter().map(signs));
        self.votes.clear();
        self.votes.extend((0..NO_CLUSTER).map(|c| (0, c)));
        for code in &self.signs {
            let distances = landmarks
                .point_signs
                .iter()
                .map(|l| (l ^ code).count_ones());
            let nearest = distances.zip(&landmarks.point_clusters).min_by_key(|d| d.0);
            for cluster in nearest.map_or([NO_CLUSTER; 2], |(_, clusters)| *clusters) {
                if let Some((votes, _)) = self.votes.get_mut(usize::from(cluster)) {
                    *votes += 1;
                }
            }
        }
        let winners = &mut self.votes;
        sort_by_in(winners, &mut self.chosen, |a, b| {
            b.0.cmp(&a.0).then(a.1.cmp(&b.1))
        });
        winners.truncate(WINNERS);
        winners.retain(|(votes, _)| *votes > 0);
        let has_won = |clusters: &[u8; 2]| winners.iter().any(|(_, c)| clusters.contains(c));
        self.chosen.clear();
        self.chosen.extend(
            (0..)
                .zip(&landmarks.point_clusters)
                .filter(|(_, clusters)| has_won(clusters))
                .map(|(i, _): (u32, _)| i),
        );
        self.best_of_landmark.clear();
        self.best_of_landmark
            .resize(self.chosen.len(), (LEAST_SIMILARITY, NO_MATCH));
        self.best_of_keypoint.clear();
        for (k, query) in (0..).zip(queries) {
            let mut best = (LEAST_SIMILARITY, NO_MATCH);
            for (at, i) in (0..).zip(&self.chosen) {
                let alike = similarity(query, &landmarks.point_codes[*i as usize]);
                if alike > best.0 {
                    best = (alike, at);
                }
                let other = &mut self.best_of_landmark[at as usize];
                if alike > other.0 {
                    *other = (alike, k);
                }
            }
            self.best_of_keypoint.push(best.1);
        }
        for (at, (alike, k)) in (0..).zip(&self.best_of_landmark) {
            let is_mutual = self.best_of_keypoint.get(*k as usize) == Some(&at);
            let Some(keypoint) = features.keypoints.get(*k as usize).filter(|_| is_mutual) else {
                continue;
            };
            let landmark = &landmarks.points[self.chosen[at as usize] as usize];
            out.push(PointCorrespondence {
                pixel: keypoint.pixel,
                point_in_world: landmark.point_in_world,
                confidence: belief(*alike),
                sigma_m: landmark.sigma as f32,
                sigma_px: 0.0,
            });
        }
    }
}
