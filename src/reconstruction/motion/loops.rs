//! Pairs far apart in a video are believed when their neighbours agree.
//!
//! Twin rooms and repeated furniture match well in single pairs. A true loop is seen by several pictures in a row: what a pair
//! says that a keypoint of one picture is in the other, a third picture that both were matched with says too. Matches are
//! compared, not movements: before a wall or with little parallax the movement between two pictures is ambiguous although
//! their matches are right. What no other picture confirms, or others contradict, is rejected and reported.

use super::VerifiedPair;
use crate::math::parallel;
use std::collections::HashMap;

/// What makes a loop trustworthy.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopParams {
    /// Pairs at most this far apart in a video are no loops.
    pub near: usize,
    /// Third pictures that have to confirm a loop.
    pub min_witnesses: usize,
    /// Matches that a third picture has to say something about to be a witness.
    pub min_matches: usize,
}

impl Default for LoopParams {
    fn default() -> Self {
        Self {
            near: 12,
            min_witnesses: 2,
            min_matches: 6,
        }
    }
}

/// What a pair says, from keypoints of the one to keypoints of the other, both ways.
type Says = HashMap<u32, u32>;

/// Keeps the pairs that third pictures confirm; returns the rejected ones, (first, second). Without order every pair needs
/// witnesses, unless it has none to have: a picture with one or two partners keeps them.
pub(super) fn reject_lonely(
    pairs: &mut Vec<VerifiedPair>,
    is_video: bool,
    params: &LoopParams,
) -> Vec<(u32, u32)> {
    let mut says: HashMap<(u32, u32), Says> = HashMap::new();
    let mut partners: HashMap<u32, Vec<u32>> = HashMap::new();
    for pair in pairs.iter() {
        let matches = pair.matches.iter();
        says.insert((pair.a, pair.b), matches.map(|m| (m.0, m.1)).collect());
        let matches = pair.matches.iter();
        says.insert((pair.b, pair.a), matches.map(|m| (m.1, m.0)).collect());
        partners.entry(pair.a).or_default().push(pair.b);
        partners.entry(pair.b).or_default().push(pair.a);
    }
    // Third pictures for and against a pair.
    let witnesses = |pair: &VerifiedPair| -> (usize, usize) {
        let (mut confirming, mut contradicting) = (0, 0);
        for c in partners.get(&pair.a).into_iter().flatten() {
            let (Some(from_a), Some(from_b)) = (says.get(&(pair.a, *c)), says.get(&(pair.b, *c)))
            else {
                continue;
            };
            let (mut agree, mut differ) = (0, 0);
            for (k, l, _) in &pair.matches {
                match (from_a.get(k), from_b.get(l)) {
                    (Some(x), Some(y)) if x == y => agree += 1,
                    (Some(_), Some(_)) => differ += 1,
                    _ => {}
                }
            }
            if agree >= params.min_matches && agree >= 2 * differ {
                confirming += 1;
            } else if differ >= params.min_matches && differ > agree {
                contradicting += 1;
            }
        }
        (confirming, contradicting)
    };
    let degree = |i: u32| partners.get(&i).map_or(0, Vec::len);
    let keep = parallel::map(pairs.len(), |p| {
        let pair = &pairs[p];
        let (confirming, contradicting) = witnesses(pair);
        if contradicting > confirming {
            return false;
        }
        let is_near = is_video && ((pair.b - pair.a) as usize) <= params.near;
        let is_poor = degree(pair.a).min(degree(pair.b)) <= params.min_witnesses;
        is_near || (!is_video && is_poor) || confirming >= params.min_witnesses
    });
    let mut rejected = Vec::new();
    let mut keep = keep.into_iter();
    pairs.retain(|pair| {
        let is_kept = keep.next().unwrap_or(true);
        if !is_kept {
            rejected.push((pair.a, pair.b));
        }
        is_kept
    });
    rejected
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Rigid;
    use crate::reconstruction::{TwoView, TwoViewKind};

    /// A pair whose matches move keypoints on by `shift`.
    fn pair(a: u32, b: u32, shift: u32) -> VerifiedPair {
        VerifiedPair {
            a,
            b,
            geometry: TwoView {
                kind: TwoViewKind::General,
                b_from_a: Rigid::identity(),
                inliers: Vec::new(),
                parallax_rad: 0.1,
            },
            matches: (0..40).map(|k| (k + a, k + b + shift, 0.9)).collect(),
        }
    }

    #[test]
    fn loops_need_agreeing_neighbours() {
        // A keypoint's number grows by one a picture; 50 and 51 see the same as 0 and 1.
        let mut pairs: Vec<VerifiedPair> = (0..60).map(|i| pair(i, i + 1, 0)).collect();
        pairs.extend((0..58).map(|i| pair(i, i + 2, 0)));
        for (a, b) in [(0, 50), (0, 51), (1, 50), (1, 51)] {
            pairs.push(pair(a, b, 0));
        }
        // A twin: one pair alone, and three that contradict each other.
        pairs.push(pair(10, 40, 7));
        pairs.extend([pair(20, 45, 3), pair(21, 45, 5), pair(20, 46, 9)]);
        let num = pairs.len();
        let mut rejected = reject_lonely(&mut pairs, true, &LoopParams::default());
        rejected.sort_unstable();
        assert_eq!(rejected, [(10, 40), (20, 45), (20, 46), (21, 45)]);
        assert_eq!(pairs.len(), num - 4);
    }
}
