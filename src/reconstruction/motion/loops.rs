//! Pairs far apart in a video are believed when their neighbours agree.
//!
//! Twin rooms and repeated furniture match well in single pairs. A true loop is seen by several pictures in a row, and the
//! rotations round each triangle of pairs close; what does neither is rejected and reported.

use super::VerifiedPair;
use nalgebra::Matrix3;
use std::collections::HashMap;

/// What makes a loop trustworthy.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopParams {
    /// Pairs at most this far apart in a video are no loops.
    pub near: usize,
    /// Triangles with agreeing rotations that a loop needs.
    pub min_triangles: usize,
    /// Share of its triangles that has to agree.
    pub min_share: f64,
    /// Largest rotation left after going round a triangle.
    pub max_error_deg: f64,
}

impl Default for LoopParams {
    fn default() -> Self {
        Self {
            near: 12,
            min_triangles: 2,
            min_share: 0.4,
            max_error_deg: 3.0,
        }
    }
}

/// Keeps the pairs that triangles support; returns the rejected ones, (first, second). Without order every pair needs support,
/// unless it has none to have: a picture with one or two partners keeps them.
pub(super) fn reject_lonely(
    pairs: &mut Vec<VerifiedPair>,
    is_video: bool,
    params: &LoopParams,
) -> Vec<(u32, u32)> {
    let mut rotations: HashMap<(u32, u32), Matrix3<f64>> = HashMap::new();
    let mut partners: HashMap<u32, Vec<u32>> = HashMap::new();
    for pair in pairs.iter() {
        rotations.insert((pair.a, pair.b), pair.geometry.b_from_a.rotation);
        partners.entry(pair.a).or_default().push(pair.b);
        partners.entry(pair.b).or_default().push(pair.a);
    }
    let rotation = |from: u32, to: u32| -> Option<Matrix3<f64>> {
        if from < to {
            rotations.get(&(from, to)).copied()
        } else {
            rotations.get(&(to, from)).map(Matrix3::transpose)
        }
    };
    // 2 cos + 1 = trace.
    let least_trace = 1.0 + 2.0 * crate::math::elementary::cos(params.max_error_deg.to_radians());
    // Triangles that a pair is part of, by how well the other two sides are supported themselves: (agreeing, closed).
    let support = |pair: &VerifiedPair, trust: &HashMap<(u32, u32), f64>| -> (f64, f64) {
        let side = |i: u32, j: u32| trust.get(&(i.min(j), i.max(j))).copied().unwrap_or(1.0);
        let (mut agreeing, mut closed) = (0.0, 0.0);
        for c in partners.get(&pair.a).into_iter().flatten() {
            let (Some(ca), Some(bc)) = (rotation(*c, pair.a), rotation(pair.b, *c)) else {
                continue;
            };
            let weight = side(*c, pair.a) * side(pair.b, *c);
            closed += weight;
            let round = pair.geometry.b_from_a.rotation * ca * bc;
            if round.trace() >= least_trace {
                agreeing += weight;
            }
        }
        (agreeing, closed)
    };
    let mut trust: HashMap<(u32, u32), f64> = HashMap::new();
    for _ in 0..3 {
        trust = pairs
            .iter()
            .map(|pair| {
                let (agreeing, closed) = support(pair, &trust);
                // One triangle in two is neither for nor against.
                ((pair.a, pair.b), (agreeing + 0.5) / (closed + 1.0))
            })
            .collect();
    }
    let degree = |i: u32| partners.get(&i).map_or(0, Vec::len);
    let keep: Vec<bool> = pairs
        .iter()
        .map(|pair| {
            let (agreeing, closed) = support(pair, &trust);
            let is_contradicted = closed >= 2.0 && agreeing < params.min_share * closed;
            if is_contradicted {
                return false;
            }
            let is_near = is_video && ((pair.b - pair.a) as usize) <= params.near;
            let is_poor = degree(pair.a).min(degree(pair.b)) <= params.min_triangles;
            is_near || (!is_video && is_poor) || agreeing >= params.min_triangles as f64 * 0.5
        })
        .collect();
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
    use crate::geometry::{Rigid, rotation_from_vector};
    use crate::reconstruction::{TwoView, TwoViewKind};
    use nalgebra::Vector3;

    fn pair(a: u32, b: u32, angle: f64) -> VerifiedPair {
        VerifiedPair {
            a,
            b,
            geometry: TwoView {
                kind: TwoViewKind::General,
                b_from_a: Rigid::new(
                    rotation_from_vector(&Vector3::new(0.0, angle, 0.0)),
                    Vector3::x(),
                ),
                inliers: Vec::new(),
                parallax_rad: 0.1,
            },
            matches: Vec::new(),
        }
    }

    #[test]
    fn loops_need_agreeing_neighbours() {
        // The camera turns 0.01 a picture; 50 and 51 see the same as 0 and 1.
        let mut pairs: Vec<VerifiedPair> = (0..60).map(|i| pair(i, i + 1, 0.01)).collect();
        pairs.extend((0..58).map(|i| pair(i, i + 2, 0.02)));
        for (a, b) in [(0, 50), (0, 51), (1, 50), (1, 51)] {
            pairs.push(pair(a, b, 0.01 * f64::from(b - a)));
        }
        // A twin: one pair alone, and one that its neighbours contradict.
        pairs.push(pair(10, 40, 1.0));
        pairs.extend([pair(20, 45, 1.0), pair(21, 45, 0.2), pair(20, 46, -0.4)]);
        let num = pairs.len();
        let mut rejected = reject_lonely(&mut pairs, true, &LoopParams::default());
        rejected.sort_unstable();
        assert_eq!(rejected, [(10, 40), (20, 45), (20, 46), (21, 45)]);
        assert_eq!(pairs.len(), num - 4);
    }
}
