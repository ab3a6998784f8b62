//! Mutual nearest neighbours in descriptor space, checked against the known epipolar geometry.

use super::{Observation, PosedView};
use crate::features::FeatureSet;
use crate::geometry::CamFromWorld;
use crate::math::parallel;
use crate::nn::cpu::MutualNearest;
use nalgebra::{Matrix3, Vector3};

/// What counts as a match.
#[derive(Debug, Clone, PartialEq)]
pub struct MatchParams {
    /// Least cosine of the descriptors. 0.82 keeps nearly all true matches of XFeat (measured on RedKitchen).
    pub min_cosine: f32,
    /// Largest distance of either keypoint from the other's epipolar line.
    pub max_epipolar_px: f64,
}

impl Default for MatchParams {
    fn default() -> Self {
        Self {
            min_cosine: 0.82,
            max_epipolar_px: 3.0,
        }
    }
}

/// Two keypoints that may show the same thing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// In the view with the lower number.
    pub a: Observation,
    /// In the other view.
    pub b: Observation,
    /// Cosine of the descriptors.
    pub cosine: f32,
}

/// Matches keypoints of one picture with those of others, without any geometry. Keeps its memory.
#[derive(Debug, Clone, Default)]
pub struct MutualMatcher {
    search: MutualNearest,
    channels: usize,
}

impl MutualMatcher {
    /// Sets the picture that others are compared with.
    pub fn set_first(&mut self, a: &FeatureSet) {
        self.channels = a.descriptor_channels;
        self.search
            .set_keys(&a.descriptors_nd, a.descriptor_channels);
    }

    /// Pairs of keypoints, each the other's most similar, as (keypoint of the first, keypoint of `b`, cosine), in the order of
    /// the first's keypoints. None when the descriptors differ in length.
    pub fn matches<'s>(
        &'s mut self,
        b: &FeatureSet,
        min_cosine: f32,
    ) -> impl Iterator<Item = (u32, u32, f32)> + use<'s> {
        let rows: &[f32] = if b.descriptor_channels == self.channels {
            &b.descriptors_nd
        } else {
            &[]
        };
        self.search
            .find(rows, min_cosine)
            .map(|p| (p.key, p.row, p.product))
    }
}

/// [`MutualMatcher`] for one pair of pictures.
pub fn mutual_neighbours(a: &FeatureSet, b: &FeatureSet, min_cosine: f32) -> Vec<(u32, u32, f32)> {
    let mut matcher = MutualMatcher::default();
    matcher.set_first(a);
    matcher.matches(b, min_cosine).collect()
}

/// Matches pairs of views, in parallel; the result is in the order of the pairs.
pub fn match_pairs(
    views: &[PosedView<'_>],
    pairs: &[(usize, usize)],
    params: &MatchParams,
) -> Vec<Match> {
    // Neighbouring pairs with the same first view share its preparation.
    let groups: Vec<&[(usize, usize)]> = pairs.chunk_by(|x, y| x.0 == y.0).collect();
    let found = parallel::map_with(groups.len(), MutualMatcher::default, |matcher, g| {
        let mut matches = Vec::new();
        if let Some((i, _)) = groups[g].first() {
            matcher.set_first(views[*i].features);
        }
        for &(i, j) in groups[g] {
            match_pair(views, i, j, params, matcher, &mut matches);
        }
        matches
    });
    found.into_iter().flatten().collect()
}

/// Maps a place on the plane of `a` to its epipolar line on the plane of `b`.
pub fn essential(a_from_world: &CamFromWorld, b_from_world: &CamFromWorld) -> Matrix3<f64> {
    let b_from_a = *b_from_world * a_from_world.inverse();
    b_from_a.translation.cross_matrix() * b_from_a.rotation
}

/// The larger of the distances of two places from each other's epipolar lines, in the planes' units.
pub fn epipolar_distance(e: &Matrix3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let in_b = e * a;
    let in_a = e.transpose() * b;
    let product = b.dot(&in_b).abs();
    let least = in_b.xy().norm().min(in_a.xy().norm());
    if least > 0.0 {
        product / least
    } else {
        f64::INFINITY
    }
}

/// `matcher` has the first view's descriptors.
fn match_pair(
    views: &[PosedView<'_>],
    i: usize,
    j: usize,
    params: &MatchParams,
    matcher: &mut MutualMatcher,
    matches: &mut Vec<Match>,
) {
    let (a, b) = (&views[i], &views[j]);
    let e = essential(&a.cam_from_world, &b.cam_from_world);
    let limit = params.max_epipolar_px / (0.5 * (a.focal_px + b.focal_px));
    let place = |view: &PosedView<'_>, k: u32| view.planar.get(k as usize).map(|p| p.push(1.0));
    matches.extend(
        matcher
            .matches(b.features, params.min_cosine)
            .filter(|(k, l, _)| match (place(a, *k), place(b, *l)) {
                (Some(p), Some(q)) => epipolar_distance(&e, &p, &q) <= limit,
                _ => false,
            })
            .map(|(k, l, cosine)| Match {
                a: Observation::new(i, k as usize),
                b: Observation::new(j, l as usize),
                cosine,
            }),
    );
}
