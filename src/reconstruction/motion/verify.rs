//! Matches of candidate pairs, and what their geometry says.

use super::Picture;
use crate::geometry::Camera;
use crate::math::parallel;
use crate::reconstruction::points::nearest_first;
use crate::reconstruction::{
    MutualMatcher, PIECE, Stage, TwoView, TwoViewParams, Uncalibrated, Watch, planar_from_pixel,
    two_view, uncalibrated,
};
use nalgebra::Vector2;

/// Mutual nearest neighbours of two pictures, most similar first.
#[derive(Debug, Clone, PartialEq)]
pub struct PairMatches {
    /// Index of the first picture, below [`Self::b`].
    pub a: u32,
    /// Index of the second picture.
    pub b: u32,
    /// Keypoint of the first, of the second, cosine.
    pub matches: Vec<(u32, u32, f32)>,
}

/// Two pictures that show the same thing.
#[derive(Debug, Clone, PartialEq)]
pub struct VerifiedPair {
    /// Index of the first picture, below [`Self::b`].
    pub a: u32,
    /// Index of the second picture.
    pub b: u32,
    /// Label, movement, and which matches agree.
    pub geometry: TwoView,
    /// The agreeing matches: keypoint of the first, of the second, cosine.
    pub matches: Vec<(u32, u32, f32)>,
}

/// Matches all candidate pairs; those with fewer than `least` matches are left out.
pub(super) async fn match_candidates(
    pictures: &[Picture<'_>],
    pairs: &[(usize, usize)],
    min_cosine: f32,
    least: usize,
    watch: &mut Watch<'_>,
) -> Option<Vec<PairMatches>> {
    let mut found = Vec::new();
    for (piece, done) in pairs.chunks(PIECE).zip((PIECE..).step_by(PIECE)) {
        // Neighbouring pairs with the same first picture share its preparation.
        let groups: Vec<&[(usize, usize)]> = piece.chunk_by(|x, y| x.0 == y.0).collect();
        let of_groups = parallel::map_with(groups.len(), MutualMatcher::default, |matcher, g| {
            matcher.set_first(pictures[groups[g][0].0].features);
            groups[g]
                .iter()
                .filter_map(|&(a, b)| {
                    let mut matches: Vec<_> =
                        matcher.matches(pictures[b].features, min_cosine).collect();
                    matches.sort_unstable_by(nearest_first);
                    (matches.len() >= least).then_some(PairMatches {
                        a: a as u32,
                        b: b as u32,
                        matches,
                    })
                })
                .collect::<Vec<_>>()
        });
        found.extend(of_groups.into_iter().flatten());
        watch
            .tell(Stage::Match, done.min(pairs.len()), pairs.len())
            .await?;
    }
    Some(found)
}

/// Keypoints of a picture on the plane z = 1.
pub(super) fn places(picture: &Picture<'_>, camera: &Camera) -> Vec<Vector2<f64>> {
    let keypoints = picture.features.keypoints.iter();
    keypoints
        .map(|k| planar_from_pixel(camera, k.pixel))
        .collect()
}

/// Compares matched pairs under the cameras; in the order of the pairs.
pub(super) async fn verify(
    pictures: &[Picture<'_>],
    cameras: &[Camera],
    pairs: &[PairMatches],
    params: &TwoViewParams,
    watch: &mut Watch<'_>,
) -> Option<Vec<VerifiedPair>> {
    let planes = parallel::map(pictures.len(), |i| {
        places(&pictures[i], &cameras[pictures[i].camera])
    });
    let mut found = Vec::new();
    for (piece, done) in pairs.chunks(PIECE).zip((PIECE..).step_by(PIECE)) {
        let verified = parallel::map(piece.len(), |i| {
            let pair = &piece[i];
            let (a, b) = (pair.a as usize, pair.b as usize);
            verify_pair(
                pair,
                &planes[a],
                &planes[b],
                mean_focal(pictures, cameras, a, b),
                params,
            )
        });
        found.extend(verified.into_iter().flatten());
        watch
            .tell(Stage::Verify, done.min(pairs.len()), pairs.len())
            .await?;
    }
    Some(found)
}

pub(super) fn mean_focal(pictures: &[Picture<'_>], cameras: &[Camera], a: usize, b: usize) -> f64 {
    let focal = |i: usize| {
        let (fx, fy) = cameras[pictures[i].camera].focal_px();
        0.5 * (fx + fy)
    };
    0.5 * (focal(a) + focal(b))
}

pub(super) fn verify_pair(
    pair: &PairMatches,
    a: &[Vector2<f64>],
    b: &[Vector2<f64>],
    focal_px: f64,
    params: &TwoViewParams,
) -> Option<VerifiedPair> {
    let matches: Vec<(u32, u32)> = pair.matches.iter().map(|m| (m.0, m.1)).collect();
    let seed = u64::from(pair.a) << 32 | u64::from(pair.b);
    let geometry = two_view(a, b, &matches, focal_px, params, seed)?;
    let matches = geometry.inliers.iter().map(|i| pair.matches[*i]).collect();
    Some(VerifiedPair {
        a: pair.a,
        b: pair.b,
        geometry,
        matches,
    })
}

/// Fundamental matrices of pairs of one camera group, in units of the longer side; a sample of the best matched pairs spread
/// over the set.
pub(super) fn fundamentals(
    pictures: &[Picture<'_>],
    camera: &Camera,
    group: usize,
    pairs: &[PairMatches],
    most: usize,
    params: &TwoViewParams,
) -> Vec<Uncalibrated> {
    let mut chosen: Vec<&PairMatches> = pairs
        .iter()
        .filter(|p| {
            let of = |i: u32| pictures[i as usize].camera == group;
            of(p.a) && of(p.b) && p.matches.len() >= 2 * params.min_inliers
        })
        .collect();
    // The best of each stretch of the list, so that no corner of the place decides alone.
    let stretch = chosen.len().div_ceil(most).max(1);
    chosen = chosen
        .chunks(stretch)
        .filter_map(|c| c.iter().max_by_key(|p| p.matches.len()).copied())
        .collect();
    let unit = f64::from(camera.width.max(camera.height));
    let center = camera.principal_point();
    let of_picture = |i: u32| -> Vec<Vector2<f64>> {
        let keypoints = pictures[i as usize].features.keypoints.iter();
        keypoints
            .map(|k| Vector2::new(k.pixel.x - center.x, k.pixel.y - center.y) / unit)
            .collect()
    };
    let found = parallel::map(chosen.len(), |i| {
        let pair = chosen[i];
        let matches: Vec<(u32, u32)> = pair.matches.iter().map(|m| (m.0, m.1)).collect();
        let seed = u64::from(pair.a) << 32 | u64::from(pair.b);
        uncalibrated(
            &of_picture(pair.a),
            &of_picture(pair.b),
            &matches,
            unit,
            params,
            seed,
        )
    });
    found.into_iter().flatten().collect()
}
