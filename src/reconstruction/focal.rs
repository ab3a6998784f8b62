//! A focal length for pictures that come without one, from their epipolar geometries.
//!
//! With square pixels and the right focal length, `K' F K` is an essential matrix: its two larger singular values are equal.
//! Every general pair votes on log-spaced focal lengths; a broad prior around 0.85 of the longer side decides where pairs are
//! silent. Pairs that a homography explains and pairs that move straight ahead say nothing and have no vote.

use super::two_view::Uncalibrated;
use crate::math::elementary::{exp, ln};
use nalgebra::{Matrix3, Vector3};

/// Focal lengths outside these multiples of the longer side belong to no camera that makes rooms.
pub const FOCAL_RANGE: (f64, f64) = (0.4, 2.5);

/// Where phones, webcams and headsets lie, as a multiple of the longer side.
pub const FOCAL_PRIOR: f64 = 0.85;

/// Standard deviation of ln f of the prior.
const PRIOR_SIGMA_LN: f64 = 0.35;

/// Candidates over the range: 2.4 % from one to the next.
const NUM_CANDIDATES: usize = 78;

/// Relative difference of the two singular values at which a vote is half.
const TOLERANCE: f64 = 0.04;

/// What the pairs say.
#[derive(Debug, Clone, PartialEq)]
pub struct FocalVote {
    /// Hypotheses as multiples of the longer side, best first; at most two, clearly different ones.
    pub hypotheses: Vec<f64>,
    /// Pairs that had a vote.
    pub num_votes: usize,
    /// Width of the peak as a standard deviation of ln f; the prior's when nobody voted.
    pub sigma_ln: f64,
}

/// 1 - (second / first singular value) of `K' F K`: 0 for an essential matrix.
fn asymmetry(f: &Matrix3<f64>, focal: f64) -> f64 {
    let k = Matrix3::from_diagonal(&Vector3::new(focal, focal, 1.0));
    let e = k * f * k;
    let g = e.transpose() * e;
    let trace = g.trace();
    // With a zero singular value: s1^2 + s2^2 and s1^2 s2^2.
    let product = 0.5 * (trace * trace - (g * g).trace());
    let root = (trace * trace - 4.0 * product).max(0.0).sqrt();
    let (large, small) = (0.5 * (trace + root), (0.5 * (trace - root)).max(0.0));
    if large > 0.0 {
        1.0 - (small / large).sqrt()
    } else {
        1.0
    }
}

fn candidate(i: usize) -> f64 {
    let (low, high) = (ln(FOCAL_RANGE.0), ln(FOCAL_RANGE.1));
    exp(low + (high - low) * i as f64 / (NUM_CANDIDATES - 1) as f64)
}

/// Collects the votes. Fundamental matrices are of places relative to the principal point in units of the longer side.
pub fn vote_focal(pairs: &[Uncalibrated]) -> FocalVote {
    let mut score = [0.0; NUM_CANDIDATES];
    let mut num_votes = 0;
    for pair in pairs {
        if pair.is_homography {
            continue;
        }
        let curve: [f64; NUM_CANDIDATES] =
            core::array::from_fn(|i| asymmetry(&pair.fundamental, candidate(i)) / TOLERANCE);
        let (low, high) = curve
            .iter()
            .fold((f64::MAX, 0f64), |(l, h), v| (l.min(*v), h.max(*v)));
        // A flat curve, or one that never reaches an essential matrix, has nothing to say.
        if !(low < 2.0 && high > 4.0 * low.max(0.5)) {
            continue;
        }
        num_votes += 1;
        let weight = (pair.num_inliers as f64).sqrt();
        for (s, v) in score.iter_mut().zip(curve) {
            *s += weight / (1.0 + v * v);
        }
    }
    let total: f64 = score.iter().sum();
    let mut belief = [0.0; NUM_CANDIDATES];
    for (i, b) in belief.iter_mut().enumerate() {
        let off = ln(candidate(i) / FOCAL_PRIOR) / PRIOR_SIGMA_LN;
        let prior = exp(-0.5 * off * off);
        *b = if total > 0.0 {
            // The prior bends the vote, it does not outvote it.
            score[i] / total * (0.3 + 0.7 * prior)
        } else {
            prior
        };
    }
    let mut hypotheses = Vec::new();
    let mut sigma_ln = PRIOR_SIGMA_LN;
    let mut free = [true; NUM_CANDIDATES];
    while hypotheses.len() < 2 {
        let best = (0..NUM_CANDIDATES)
            .filter(|i| free[*i])
            .max_by(|a, b| belief[*a].total_cmp(&belief[*b]).then(b.cmp(a)));
        let Some(best) = best else { break };
        if hypotheses.is_empty() && num_votes > 0 {
            let half = (0..NUM_CANDIDATES)
                .filter(|i| belief[*i] > 0.5 * belief[best])
                .count();
            let step = ln(FOCAL_RANGE.1 / FOCAL_RANGE.0) / (NUM_CANDIDATES - 1) as f64;
            sigma_ln = half as f64 * step / 2.355;
        }
        hypotheses.push(peak(&belief, best));
        for (i, f) in free.iter_mut().enumerate() {
            *f = *f && i.abs_diff(best) > 8;
        }
    }
    FocalVote {
        hypotheses,
        num_votes,
        sigma_ln,
    }
}

/// Top of the parabola through a maximum and its neighbours.
fn peak(belief: &[f64; NUM_CANDIDATES], at: usize) -> f64 {
    let offset = if at == 0 || at + 1 == NUM_CANDIDATES {
        0.0
    } else {
        let (l, c, r) = (belief[at - 1], belief[at], belief[at + 1]);
        let bend = l - 2.0 * c + r;
        if bend < 0.0 {
            (0.5 * (l - r) / bend).clamp(-0.5, 0.5)
        } else {
            0.0
        }
    };
    let step = ln(FOCAL_RANGE.1 / FOCAL_RANGE.0) / (NUM_CANDIDATES - 1) as f64;
    candidate(at) * exp(offset * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_vector;
    use crate::math::Rng;
    use crate::reconstruction::relative::essential;

    fn pairs(focal: f64, n: usize, rng: &mut Rng) -> Vec<Uncalibrated> {
        (0..n)
            .map(|_| {
                let r = rotation_from_vector(&Vector3::from_fn(|_, _| 0.2 * rng.normal()));
                let t = Vector3::from_fn(|_, _| rng.normal()).normalize();
                let k = Matrix3::from_diagonal(&Vector3::new(1.0 / focal, 1.0 / focal, 1.0));
                let noise = Matrix3::from_fn(|_, _| 2e-3 * rng.normal());
                let f = (k * essential(&r, &t) * k).normalize() + noise;
                Uncalibrated {
                    fundamental: f,
                    num_inliers: 100,
                    is_homography: false,
                }
            })
            .collect()
    }

    #[test]
    fn an_essential_matrix_has_no_asymmetry() {
        let mut rng = Rng::from_seed(1);
        for _ in 0..100 {
            let r = rotation_from_vector(&Vector3::from_fn(|_, _| rng.normal()));
            let e = essential(&r, &Vector3::from_fn(|_, _| rng.normal()));
            assert!(asymmetry(&e, 1.0) < 1e-6);
            assert!(asymmetry(&e, 1.3) > 1e-3);
        }
    }

    #[test]
    fn pairs_find_the_focal_length_and_silence_leaves_the_prior() {
        let mut rng = Rng::from_seed(2);
        for focal in [0.6, 0.82, 1.1, 1.6] {
            let vote = vote_focal(&pairs(focal, 60, &mut rng));
            let found = vote.hypotheses[0];
            assert!((found / focal - 1.0).abs() < 0.06, "{focal}: {found}");
            assert!(vote.num_votes > 20);
        }
        let silent = vote_focal(&[]);
        assert!((silent.hypotheses[0] / FOCAL_PRIOR - 1.0).abs() < 0.02);
        assert_eq!(silent.num_votes, 0);
    }
}
