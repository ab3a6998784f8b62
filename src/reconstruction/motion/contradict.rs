//! Parts of a model that verified matches contradict.
//!
//! A stretch of a video can hang on the rest by one loop that is wrong, or by points too far away to hold it, and still agree
//! with itself: reprojection errors do not show that. The matches between its pictures and the others do, for they were
//! verified without the model.

use super::grow::{Attempt, Ground};
use crate::geometry::CamFromWorld;
use crate::math::parallel;
use crate::reconstruction::{epipolar_distance, essential};

/// A pair agrees with the model when this share of its matches does,
const AGREEING_SHARE: f64 = 0.5;
/// and the model turns from one to the other as the pair alone says, within so many degrees. Matches near their epipolar lines
/// do not tell: of a stretch that lay 30 degrees off, half of those with its neighbours in time were.
const MAX_TURN_DEG: f64 = 5.0;
/// A part stays when the matches of contradicting pairs are at most this share of those of agreeing ones.
const MAX_CONTRADICTION: f64 = 0.5;

/// A verified pair of registered pictures under the model.
struct Judged {
    a: usize,
    b: usize,
    num_matches: usize,
    agrees: bool,
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
        let own = CamFromWorld::new(
            pair.geometry.b_from_a.rotation * from.rotation,
            to.translation,
        );
        let turn = to.rotation_angle_to(&own);
        Some(Judged {
            a,
            b,
            num_matches: pair.matches.len(),
            agrees: near as f64 >= AGREEING_SHARE * pair.matches.len() as f64
                && turn.to_degrees() <= MAX_TURN_DEG,
        })
    });
    judged.into_iter().flatten().collect()
}

/// The part of each picture: of a video the stretches over whose every step more matches agree than contradict, of other pictures
/// what agreeing pairs hold together.
fn parts(ground: &Ground<'_>, judged: &[Judged]) -> Vec<usize> {
    let params = ground.params;
    let mut part: Vec<usize> = (0..ground.pictures.len()).collect();
    if params.candidates.is_video {
        let mut sides = vec![(0, 0); part.len()];
        for pair in judged.iter().filter(|p| p.b - p.a <= params.loops.near) {
            for (agreeing, contradicting) in &mut sides[pair.a..pair.b] {
                *if pair.agrees { agreeing } else { contradicting } += pair.num_matches;
            }
        }
        for i in 1..part.len() {
            let (agreeing, contradicting) = sides[i - 1];
            if agreeing > contradicting {
                part[i] = part[i - 1];
            }
        }
        return part;
    }
    for pair in judged.iter().filter(|p| p.agrees) {
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
    let part = parts(ground, &judged);
    let mut sizes = vec![0usize; part.len()];
    for (i, p) in part.iter().enumerate() {
        sizes[*p] += usize::from(attempt.poses[i].is_some());
    }
    let mut parts: Vec<usize> = (0..sizes.len()).filter(|p| sizes[*p] > 0).collect();
    parts.sort_by_key(|p| (core::cmp::Reverse(sizes[*p]), *p));
    let mut is_kept = vec![false; part.len()];
    // A part that was doubtful beside the first may be sure beside more of them.
    let mut waiting = parts.split_off(parts.len().min(1));
    if let [largest] = parts.as_slice() {
        is_kept[*largest] = true;
    }
    loop {
        let is_sure = |p: usize| {
            let (mut agreeing, mut contradicting) = (0, 0);
            for pair in &judged {
                let (x, y) = (part[pair.a], part[pair.b]);
                if (x == p && is_kept[y]) || (y == p && is_kept[x]) {
                    if pair.agrees {
                        agreeing += pair.num_matches;
                    } else {
                        contradicting += pair.num_matches;
                    }
                }
            }
            agreeing > 0 && contradicting as f64 <= MAX_CONTRADICTION * agreeing as f64
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
