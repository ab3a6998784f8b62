//! Parts of a model that verified matches contradict.
//!
//! A stretch of a video can hang on the rest by one loop that is wrong, or by points too far away to hold it, and still agree
//! with itself: reprojection errors do not show that. The matches between its pictures and the others do, for they were
//! verified without the model.

use super::MotionParams;
use super::grow::{Attempt, Ground};
use crate::geometry::vector_from_rotation;
use crate::math::order::sort_by_key;
use crate::math::parallel;
use crate::math::stats::median_in_place;
use crate::reconstruction::{TwoViewKind, epipolar_distance, essential};
use nalgebra::Vector3;

/// A pair agrees with the model when this share of its matches does.
const AGREEING_SHARE: f64 = 0.5;
/// The model is wrong where the pairs turn otherwise than it does by so many degrees, in the median,
const MAX_TURN_DEG: f64 = 5.0;
/// and agree with each other: half of them are off from that by at most this share of it. Matches near their epipolar lines do not
/// tell (of a stretch that lay 30 degrees off, half of those with its neighbours in time were), and a pair alone does not either:
/// along a corridor what pairs say is off by ten degrees, each by its own.
const MAX_SPREAD: f64 = 0.5;
/// Fewer pictures are not judged by their turns: the focal length, by which pairs were compared, is not known well before.
const JUDGED_FROM: usize = 30;
/// A part stays when the matches of contradicting pairs are at most this share of those of agreeing ones.
const MAX_CONTRADICTION: f64 = 0.5;

/// A verified pair of registered pictures under the model.
struct Judged {
    a: usize,
    b: usize,
    num_matches: usize,
    agrees: bool,
    /// Rotation vector by which the model turns otherwise than the pair alone says, about axes of the world, in radians.
    off: Vector3<f64>,
}

impl Judged {
    /// Whether it is a step of a video, no loop.
    fn is_step(&self, params: &MotionParams) -> bool {
        params.candidates.is_video && self.b - self.a <= params.loops.near
    }
}

fn judge(ground: &Ground<'_>, attempt: &Attempt) -> Vec<Judged> {
    let (_, views, position) = ground.posed(attempt);
    let view = |i: usize| views.get(position[i] as usize);
    let judged = parallel::map(ground.pairs.len(), |p| {
        let pair = &ground.pairs[p];
        let (a, b) = (pair.a as usize, pair.b as usize);
        let (first, second) = (view(a)?, view(b)?);
        let e = essential(&first.cam_from_world, &second.cam_from_world);
        let limit = 2.0 * ground.params.max_error_px / first.focal_px.min(second.focal_px);
        let near = pair
            .matches
            .iter()
            .filter(|(k, l, _)| {
                let place = |v: &crate::reconstruction::PosedView<'_>, i: u32| {
                    v.planar[i as usize].push(1.0)
                };
                epipolar_distance(&e, &place(first, *k), &place(second, *l)) <= limit
            })
            .count();
        let (from, to) = (&first.cam_from_world, &second.cam_from_world);
        let own = pair.geometry.b_from_a.rotation * from.rotation;
        // Lines are the same for a step ahead and for one back: along a wall only its direction tells a twin room.
        let step = (*to * from.inverse()).translation;
        let goes_back = pair.geometry.kind == TwoViewKind::General
            && step.dot(&pair.geometry.b_from_a.translation) < 0.0;
        Some(Judged {
            a,
            b,
            num_matches: pair.matches.len(),
            agrees: !goes_back && near as f64 >= AGREEING_SHARE * pair.matches.len() as f64,
            off: vector_from_rotation(&(to.rotation.transpose() * own)),
        })
    });
    judged.into_iter().flatten().collect()
}

/// Matches of agreeing and of contradicting pairs.
fn sides(pairs: &[&Judged]) -> (usize, usize) {
    let matches = |agrees: bool| -> usize {
        let own = pairs.iter().filter(|p| p.agrees == agrees);
        own.map(|p| p.num_matches).sum()
    };
    (matches(true), matches(false))
}

/// Whether the model turns as pairs say that are off by so much: not when they are off by the same, most of them.
fn turns_alike(off: &[Vector3<f64>]) -> bool {
    let middle = Vector3::from_fn(|axis, _| {
        let mut all: Vec<f64> = off.iter().map(|v| v[axis]).collect();
        median_in_place(&mut all).unwrap_or(0.0)
    });
    let mut spread: Vec<f64> = off.iter().map(|v| (v - middle).norm()).collect();
    let spread = median_in_place(&mut spread).unwrap_or(0.0);
    middle.norm().to_degrees() <= MAX_TURN_DEG || spread > MAX_SPREAD * middle.norm()
}

/// The part of each picture: of a video the stretches whose every step is right, of other pictures what agreeing pairs hold together.
fn parts(ground: &Ground<'_>, judged: &[Judged], judges_turns: bool) -> Vec<usize> {
    let params = ground.params;
    let mut part: Vec<usize> = (0..ground.pictures.len()).collect();
    if params.candidates.is_video && judges_turns {
        for i in 1..part.len() {
            let across: Vec<&Judged> = judged
                .iter()
                .filter(|p| p.a < i && i <= p.b && p.is_step(params))
                .collect();
            let (agreeing, contradicting) = sides(&across);
            let off: Vec<Vector3<f64>> = across.iter().map(|p| p.off).collect();
            if agreeing > contradicting && turns_alike(&off) {
                part[i] = part[i - 1];
            }
        }
        return part;
    }
    for pair in judged.iter().filter(|p| p.agrees) {
        // A loop alone holds no stretch of a video.
        if params.candidates.is_video && !pair.is_step(params) {
            continue;
        }
        let (from, to) = (part[pair.b], part[pair.a]);
        for p in part.iter_mut().filter(|p| **p == from) {
            *p = to;
        }
    }
    part
}

/// Takes the poses from parts that the matches with the largest part contradict. How many pictures it were.
pub(super) fn drop_contradicted(ground: &Ground<'_>, attempt: &mut Attempt) -> usize {
    let judged = judge(ground, attempt);
    let judges_turns = attempt.num_registered() >= JUDGED_FROM;
    let part = parts(ground, &judged, judges_turns);
    let mut sizes = vec![0usize; part.len()];
    for (i, p) in part.iter().enumerate() {
        sizes[*p] += usize::from(attempt.poses[i].is_some());
    }
    let mut parts: Vec<usize> = (0..sizes.len()).filter(|p| sizes[*p] > 0).collect();
    sort_by_key(&mut parts, |p| core::cmp::Reverse(sizes[*p]));
    let mut is_kept = vec![false; part.len()];
    // A part that was doubtful beside the first may be sure beside more of them.
    let mut waiting = parts.split_off(parts.len().min(1));
    if let [largest] = parts.as_slice() {
        is_kept[*largest] = true;
    }
    loop {
        let is_sure = |p: usize| {
            let is_between = |pair: &&Judged| {
                let (x, y) = (part[pair.a], part[pair.b]);
                (x == p && is_kept[y]) || (y == p && is_kept[x])
            };
            let between: Vec<&Judged> = judged.iter().filter(is_between).collect();
            let (agreeing, contradicting) = sides(&between);
            // Of a video the steps count more than any number of loops: a twin room looks like the first in every picture.
            let is_step = |pair: &&Judged| pair.is_step(ground.params);
            let steps: Vec<&Judged> = between.iter().copied().filter(is_step).collect();
            let (right, wrong) = sides(&steps);
            if wrong > right {
                return false;
            }
            // Seen from the part: the other way round a pair is off by the opposite.
            let off: Vec<Vector3<f64>> = between
                .iter()
                .map(|pair| {
                    if part[pair.a] == p {
                        -pair.off
                    } else {
                        pair.off
                    }
                })
                .collect();
            agreeing > 0
                && contradicting as f64 <= MAX_CONTRADICTION * agreeing as f64
                && (!judges_turns || turns_alike(&off))
        };
        let Some(next) = waiting.iter().position(|p| is_sure(*p)) else {
            break;
        };
        is_kept[waiting.remove(next)] = true;
    }
    let strays: Vec<usize> = (0..part.len())
        .filter(|i| attempt.poses[*i].is_some() && !is_kept[part[*i]])
        .collect();
    for i in &strays {
        let seen = ground.num_seen(attempt, *i);
        attempt.drop_pose(*i, seen);
    }
    strays.len()
}
