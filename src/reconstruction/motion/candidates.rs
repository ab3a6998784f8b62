//! Which pictures without poses to compare.
//!
//! A video: the next ten, and gaps that double. Any set: the most similar by a descriptor of the whole picture, aggregated from
//! the descriptors that are there already (VLAD, Jégou et al. 2010, with words learned on the set). Small sets: all pairs.

use crate::features::FeatureSet;
use crate::math::order::sort_by;
use crate::math::{Rng, parallel};

/// How pairs without poses are chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateParams {
    /// The pictures are in the order in which they were taken, by one moving camera.
    pub is_video: bool,
    /// Following pictures of a video that each one is compared with.
    pub next: usize,
    /// Farther ones, as distances in pictures.
    pub gaps: Vec<usize>,
    /// Most similar pictures that each one is compared with.
    pub similar: usize,
    /// Up to so many pictures that are no video are all compared with each other.
    pub all_up_to: usize,
}

impl Default for CandidateParams {
    fn default() -> Self {
        Self {
            is_video: true,
            next: 8,
            gaps: vec![12, 16, 24, 32],
            similar: 15,
            all_up_to: 60,
        }
    }
}

/// Words of the aggregated descriptor.
const WORDS: usize = 32;
/// Rounds of k-means.
const ROUNDS: usize = 6;
/// Descriptors that the words are learned from.
const SAMPLES: usize = 12_000;
/// Every so-manieth keypoint counts.
const STRIDE: usize = 2;

/// Pairs (first < second), sorted. Pictures without features have none.
pub fn candidate_pairs(pictures: &[&FeatureSet], params: &CandidateParams) -> Vec<(usize, usize)> {
    let n = pictures.len();
    let mut pairs = Vec::new();
    if !params.is_video && n <= params.all_up_to {
        for i in 0..n {
            pairs.extend((i + 1..n).map(|j| (i, j)));
        }
        return pairs;
    }
    if params.is_video {
        for gap in (1..=params.next).chain(params.gaps.iter().copied()) {
            pairs.extend((gap..n).map(|j| (j - gap, j)));
        }
    }
    pairs.extend(most_similar(pictures, params.similar, |_, _| true));
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The most similar pictures of those that may be compared, for each; (first < second), not sorted, some twice.
fn most_similar(
    pictures: &[&FeatureSet],
    count: usize,
    may: impl Fn(usize, usize) -> bool,
) -> Vec<(usize, usize)> {
    let n = pictures.len();
    let similarity = similarities(pictures, 0x5EED);
    let mut pairs = Vec::new();
    for i in 0..n {
        let mut others: Vec<usize> = (0..n).filter(|j| *j != i && may(i, *j)).collect();
        let of = |j: usize| similarity[i * n + j];
        sort_by(&mut others, |a, b| of(*b).total_cmp(&of(*a)));
        let nearest = others.into_iter().take(count);
        pairs.extend(nearest.map(|j| (i.min(j), i.max(j))));
    }
    pairs
}

/// Pairs across the gaps between pieces, sorted: the most similar pictures of other pieces. Among the usual candidates of a video
/// the neighbours in time, which are similar above all, take their places. `piece_of` has the piece of each picture.
pub(super) fn bridging_pairs(
    pictures: &[&FeatureSet],
    piece_of: &[Option<usize>],
    params: &CandidateParams,
) -> Vec<(usize, usize)> {
    let is_across = |i: usize, j: usize| match (piece_of[i], piece_of[j]) {
        (Some(a), Some(b)) => a != b,
        _ => false,
    };
    let mut pairs = most_similar(pictures, params.similar, is_across);
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Cosines of the aggregated descriptors, `[pictures, pictures]`.
pub(super) fn similarities(pictures: &[&FeatureSet], seed: u64) -> Vec<f32> {
    let channels = pictures
        .iter()
        .map(|p| p.descriptor_channels)
        .max()
        .unwrap_or(0);
    let n = pictures.len();
    if channels == 0 {
        return vec![0.0; n * n];
    }
    let words = learn_words(pictures, channels, seed);
    let aggregated = parallel::map(n, |i| aggregate(pictures[i], &words, channels));
    let rows = parallel::map(n, |i| {
        aggregated
            .iter()
            .map(|other| {
                aggregated[i]
                    .iter()
                    .zip(other)
                    .map(|(a, b)| a * b)
                    .sum::<f32>()
            })
            .collect::<Vec<f32>>()
    });
    rows.into_iter().flatten().collect()
}

fn nearest(words: &[f32], channels: usize, row: &[f32]) -> usize {
    let mut best = (f32::MIN, 0);
    for (w, word) in words.chunks_exact(channels).enumerate() {
        let dot: f32 = word.iter().zip(row).map(|(a, b)| a * b).sum();
        if dot > best.0 {
            best = (dot, w);
        }
    }
    best.1
}

fn unit(row: &mut [f32]) {
    let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
    if norm > 0.0 {
        row.iter_mut().for_each(|v| *v /= norm);
    }
}

/// Spherical k-means on descriptors drawn from all pictures.
fn learn_words(pictures: &[&FeatureSet], channels: usize, seed: u64) -> Vec<f32> {
    let mut rng = Rng::from_seed(seed);
    let per_picture = SAMPLES.div_ceil(pictures.len().max(1)).max(4);
    let mut samples: Vec<&[f32]> = Vec::new();
    for picture in pictures
        .iter()
        .filter(|p| p.descriptor_channels == channels)
    {
        let count = picture.keypoints.len();
        for _ in 0..per_picture.min(count) {
            samples.extend(picture.descriptor(rng.below(count as u32) as usize));
        }
    }
    let mut words = Vec::with_capacity(WORDS * channels);
    for _ in 0..WORDS {
        match samples.get(rng.below(samples.len() as u32) as usize) {
            Some(row) => words.extend_from_slice(row),
            None => words.extend(core::iter::repeat_n(0.0, channels)),
        }
    }
    for _ in 0..ROUNDS {
        let nearest_word = parallel::map(samples.len(), |s| nearest(&words, channels, samples[s]));
        let mut sums = vec![0.0; WORDS * channels];
        for (row, w) in samples.iter().zip(nearest_word) {
            for (sum, v) in sums[w * channels..].iter_mut().zip(*row) {
                *sum += v;
            }
        }
        for (word, sum) in words
            .chunks_exact_mut(channels)
            .zip(sums.chunks_exact_mut(channels))
        {
            unit(sum);
            // A word that nobody is nearest to stays where it is.
            if sum.iter().any(|v| *v != 0.0) {
                word.copy_from_slice(sum);
            }
        }
    }
    words
}

/// Sum of the differences to the nearest word, word by word of unit length, as a whole of unit length.
fn aggregate(picture: &FeatureSet, words: &[f32], channels: usize) -> Vec<f32> {
    let mut sums = vec![0.0; words.len()];
    if picture.descriptor_channels == channels {
        for row in picture
            .descriptors_nd
            .chunks_exact(channels)
            .step_by(STRIDE)
        {
            let w = nearest(words, channels, row);
            let word = &words[w * channels..(w + 1) * channels];
            for ((sum, v), c) in sums[w * channels..].iter_mut().zip(row).zip(word) {
                *sum += v - c;
            }
        }
    }
    sums.chunks_exact_mut(channels).for_each(unit);
    unit(&mut sums);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::Keypoint;
    use crate::geometry::Pixel;

    /// Pictures of places: each place has descriptors of its own.
    fn pictures(places: &[u64]) -> Vec<FeatureSet> {
        places
            .iter()
            .enumerate()
            .map(|(i, place)| {
                let mut of_place = Rng::from_seed(*place);
                let mut own = Rng::from_seed(1000 + i as u64);
                let mut set = FeatureSet {
                    descriptor_channels: 16,
                    ..FeatureSet::default()
                };
                for k in 0..80 {
                    set.keypoints.push(Keypoint {
                        pixel: Pixel::new(f64::from(k), 1.0),
                        score: 1.0,
                    });
                    let mut row: Vec<f32> = (0..16)
                        .map(|_| (of_place.normal() + 0.2 * own.normal()) as f32)
                        .collect();
                    unit(&mut row);
                    set.descriptors_nd.extend(row);
                }
                set
            })
            .collect()
    }

    #[test]
    fn the_same_place_is_most_similar() {
        let places: Vec<u64> = (0..20).map(|i| i % 10).collect();
        let sets = pictures(&places);
        let views: Vec<&FeatureSet> = sets.iter().collect();
        let params = CandidateParams {
            is_video: false,
            similar: 1,
            all_up_to: 5,
            ..CandidateParams::default()
        };
        let pairs = candidate_pairs(&views, &params);
        for i in 0..10 {
            assert!(pairs.contains(&(i, i + 10)), "{pairs:?}");
        }
    }

    #[test]
    fn pieces_are_compared_with_each_other_only() {
        let places: Vec<u64> = (0..20).map(|i| i % 10).collect();
        let sets = pictures(&places);
        let views: Vec<&FeatureSet> = sets.iter().collect();
        let params = CandidateParams {
            similar: 1,
            ..CandidateParams::default()
        };
        let mut piece_of: Vec<Option<usize>> = (0..20).map(|i| Some(i / 10)).collect();
        piece_of[3] = None;
        let pairs = bridging_pairs(&views, &piece_of, &params);
        assert!(pairs.contains(&(4, 14)), "{pairs:?}");
        let is_across = |(a, b): &(usize, usize)| *a != 3 && *a < 10 && *b >= 10;
        assert!(pairs.iter().all(is_across), "{pairs:?}");
    }

    #[test]
    fn videos_have_gaps_and_small_sets_all_pairs() {
        let sets = pictures(&[1; 40]);
        let views: Vec<&FeatureSet> = sets.iter().collect();
        let video = candidate_pairs(&views, &CandidateParams::default());
        for pair in [(0, 1), (0, 8), (5, 37), (7, 39)] {
            assert!(video.contains(&pair));
        }
        let params = CandidateParams {
            is_video: false,
            ..CandidateParams::default()
        };
        assert_eq!(candidate_pairs(&views[..5], &params).len(), 10);
        assert!(candidate_pairs(&[], &params).is_empty());
        let empty = FeatureSet::default();
        assert!(candidate_pairs(&[&empty; 3], &CandidateParams::default()).len() <= 3);
    }
}
