//! Pieces joined across a gap that only views from far apart bridge.
//!
//! Growth does not cross such a gap: the first picture beyond it has few matches, half of them wrong, and is taken for a stray.
//! Once both sides stand, one similarity has to put all matches across on their epipolar lines. Every pair across proposes one,
//! and the best of them is believed where it explains about as much as the pairs do each for itself, in several pictures of
//! either side. Depths of points play no part: seen from one side only they are poor, and so is the pose of a single picture.

use super::adjust::Effort;
use super::candidates::bridging_pairs;
use super::grow::{Attempt, Ground};
use super::loops::reject_lonely;
use super::start::{clean, close_loops, grow_all};
use super::zoom::keeps;
use super::{PairMatches, VerifiedPair, verify};
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Rigid, Similarity, rotation_from_vector};
use crate::math::least_squares::{Damping, LeastSquares, Normal, minimize};
use crate::math::order::sort_by_key;
use crate::math::stats::median_in_place;
use crate::math::{elementary, parallel};
use crate::reconstruction::Watch;
use crate::reconstruction::relative::{RelativePose, refine_pose, sampson_sq};
use nalgebra::{Matrix3, SVector, Vector3};

/// Pictures of either side that have to agree with the join.
const MIN_AGREEING: usize = 3;
/// Of what the pairs across find each for itself, this share at least agrees with the join: things that are there several
/// times look alike in every pair, but not in one place.
const MIN_AGREEING_SHARE: f64 = 0.75;
/// Of what each piece saw for itself, this share must still fit when both are one world.
const MIN_KEPT: f64 = 0.9;
/// Pairs across that propose and judge, those with most matches of their own. There may be many more, as between rooms that look
/// alike, and each proposal costs time with every pair.
const MAX_ASKED: usize = 64;
/// Proposals that are refined, the best.
const MAX_REFINED: usize = 16;
/// Losses of the rounds that bring the worlds together, in usual error limits: what a single picture says is off by much.
const WIDTHS: [f64; 5] = [16.0, 8.0, 4.0, 2.0, 1.0];
/// Lengths of the step between two pictures that are tried, in depths of what they see.
const STEPS: [f64; 9] = [0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8];
/// Step of the derivatives, in radians, shares of the unit and shares of the scale.
const STEP: f64 = 1e-6;

/// Two pictures, one of each piece, with their matches on the planes z = 1.
struct Crossing {
    /// Index of the verified pair.
    pair: usize,
    first: usize,
    second: usize,
    cam_from_first: CamFromWorld,
    cam_from_second: CamFromWorld,
    focal_px: f64,
    matches: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Matches that agree when only the two pictures are asked.
    num_own: usize,
    /// How the second picture stands to the first by itself, the step between them being of unit length.
    own: RelativePose,
    /// Median depths of what each sees in its own world.
    depth_in_first: f64,
    depth_in_second: f64,
}

impl Crossing {
    /// How the second world lies in the first if the pair's own movement is right and the step is so long.
    fn proposal(&self, step: f64) -> Similarity {
        let scale = self.depth_in_first / self.depth_in_second;
        let turn = self.own.rotation * self.cam_from_first.rotation;
        let shift =
            self.own.rotation * self.cam_from_first.translation + self.own.translation * step;
        let rotation = turn.transpose() * self.cam_from_second.rotation;
        let center = -(turn.transpose() * shift);
        Similarity {
            scale,
            rotation,
            translation: center - rotation * self.cam_from_second.center_in_world() * scale,
        }
    }

    fn movement(&self, first_from_second: &Similarity) -> RelativePose {
        let moved = first_from_second.transform_pose(&self.cam_from_second);
        let second_from_first = moved * self.cam_from_first.inverse();
        // Of unit length, as between any two pictures: else a shorter step would pass for a better one.
        let length = second_from_first.translation.norm().max(f64::MIN_POSITIVE);
        RelativePose {
            rotation: second_from_first.rotation,
            translation: second_from_first.translation / length,
        }
    }

    /// Positions of the matches that lie on their epipolar lines and before both cameras.
    fn agreeing(&self, first_from_second: &Similarity, max_error_px: f64) -> Vec<usize> {
        let movement = self.movement(first_from_second);
        let e = movement.essential();
        let limit = max_error_px / self.focal_px;
        let agrees = |m: &usize| {
            let (a, b) = &self.matches[*m];
            sampson_sq(&e, a, b) <= limit * limit
                && movement
                    .depths(a, b)
                    .is_some_and(|(za, zb)| za > 0.0 && zb > 0.0)
        };
        (0..self.matches.len()).filter(agrees).collect()
    }
}

/// Median depth of the points that a picture sees.
fn depth(ground: &Ground<'_>, attempt: &Attempt, i: usize) -> Option<f64> {
    let pose = attempt.poses[i]?;
    let points = ground.track_of[i]
        .iter()
        .filter_map(|t| attempt.points.get(*t as usize)?.as_ref());
    let mut depths: Vec<f64> = points
        .map(|p| pose.transform_point(&p.position).z)
        .filter(|z| *z > 0.0)
        .collect();
    median_in_place(&mut depths)
}

/// All pairs across that third pictures confirmed, with all their matches: those that agree with a pair's own geometry would
/// speak for it where it is wrong.
fn crossings(
    ground: &Ground<'_>,
    matches: &[PairMatches],
    first: &Attempt,
    second: &Attempt,
) -> Vec<Crossing> {
    let places = |attempt: &Attempt, i: usize| -> Vec<Vector3<f64>> {
        let picture = &ground.pictures[i];
        let planar = verify::places(picture, &attempt.cameras[picture.camera]);
        planar.iter().map(|p| p.push(1.0)).collect()
    };
    let mut found = Vec::new();
    for (p, pair) in ground.pairs.iter().enumerate() {
        let (a, b) = (pair.a as usize, pair.b as usize);
        let ((i, j), is_swapped) = if first.poses[a].is_some() {
            ((a, b), false)
        } else {
            ((b, a), true)
        };
        let (Some(cam_from_first), Some(cam_from_second)) = (first.poses[i], second.poses[j])
        else {
            continue;
        };
        let Some(raw) = find(matches, pair) else {
            continue;
        };
        let (from, to) = (places(first, i), places(second, j));
        let in_order = |m: &(u32, u32, f32)| if is_swapped { (m.1, m.0) } else { (m.0, m.1) };
        let both = |k: u32, l: u32| (from[k as usize], to[l as usize]);
        let depths = depth(ground, first, i).zip(depth(ground, second, j));
        let Some((depth_in_first, depth_in_second)) = depths else {
            continue;
        };
        let b_from_a = pair.geometry.b_from_a;
        let movement = if is_swapped {
            b_from_a.inverse()
        } else {
            b_from_a
        };
        let own = RelativePose {
            rotation: movement.rotation,
            translation: movement.translation,
        };
        let all = raw.matches.iter().map(in_order).map(|(k, l)| both(k, l));
        found.push(Crossing {
            pair: p,
            first: i,
            second: j,
            cam_from_first,
            cam_from_second,
            focal_px: verify::mean_focal(ground.pictures, &first.cameras, a, b),
            matches: all.collect(),
            num_own: pair.matches.len(),
            own,
            depth_in_first,
            depth_in_second,
        });
    }
    found
}

/// How the second world lies in the first so that matches across lie on their epipolar lines. Depths of points play no part: seen
/// from one side only, as far from a gap, they are poor.
struct Closing<'a> {
    crossings: &'a [&'a Crossing],
    loss_px: f64,
}

impl LeastSquares for Closing<'_> {
    type Parameters = Similarity;
    type Normal = Normal<7>;
    type Step = SVector<f64, 7>;

    fn normal(&mut self, at: &Similarity) -> Normal<7> {
        let steps: Vec<(Similarity, Similarity)> = (0..7)
            .map(|k| {
                let step = SVector::<f64, 7>::from_fn(|r, _| if r == k { STEP } else { 0.0 });
                (self.moved(at, &step), self.moved(at, &-step))
            })
            .collect();
        let mut normal = Normal::default();
        let width_sq = self.loss_px * self.loss_px;
        for crossing in self.crossings {
            let e = crossing.movement(at).essential();
            let slopes: Vec<Matrix3<f64>> = (steps.iter())
                .map(|(ahead, back)| {
                    let (ahead, back) = (crossing.movement(ahead), crossing.movement(back));
                    (ahead.essential() - back.essential()) / (2.0 * STEP)
                })
                .collect();
            for (a, b) in &crossing.matches {
                // The length of the gradient changes little, as in Sampson's own steps.
                let product = b.dot(&(e * a));
                let to_px = crossing.focal_px * (sampson_sq(&e, a, b).sqrt() / product.abs());
                if !to_px.is_finite() {
                    continue;
                }
                let residual = to_px * product;
                let row = SVector::<f64, 7>::from_fn(|k, _| to_px * b.dot(&(slopes[k] * a)));
                let relative = residual * residual / width_sq;
                normal.add(&row, residual, 1.0 / (1.0 + relative));
                normal.cost += 0.5 * width_sq * elementary::ln(1.0 + relative);
            }
        }
        normal
    }

    fn cost(&self, normal: &Normal<7>) -> f64 {
        normal.cost
    }

    fn step(&self, normal: &Normal<7>, lambda: f64) -> Option<SVector<f64, 7>> {
        normal.step(lambda)
    }

    fn step_sq(&self, step: &SVector<f64, 7>) -> f64 {
        step.norm_squared()
    }

    fn moved(&self, at: &Similarity, step: &SVector<f64, 7>) -> Similarity {
        let turn = Vector3::new(step[0], step[1], step[2]);
        Similarity {
            rotation: rotation_from_vector(&turn) * at.rotation,
            translation: at.translation + Vector3::new(step[3], step[4], step[5]) * at.scale,
            scale: at.scale * elementary::exp(step[6]),
        }
    }
}

/// What holds two pieces together.
struct Seam {
    first_from_second: Similarity,
    /// All verified pairs: those across with what agrees, without those that are contradicted. By itself a pair over a wide gap
    /// is often wrong, before a wall it has two answers.
    pairs: Vec<VerifiedPair>,
}

/// How the second world lies in the first, if enough pictures agree about it.
fn seam(
    ground: &Ground<'_>,
    matches: &[PairMatches],
    first: &Attempt,
    second: &Attempt,
) -> Option<Seam> {
    let crossings = crossings(ground, matches, first, second);
    if crossings.len() < MIN_AGREEING {
        return None;
    }
    let limit = ground.params.max_error_px;
    let mut asked: Vec<&Crossing> = crossings.iter().collect();
    sort_by_key(&mut asked, |c| core::cmp::Reverse(c.num_own));
    asked.truncate(MAX_ASKED);
    let num_agreeing = |s: &Similarity, limit: f64| -> usize {
        asked.iter().map(|c| c.agreeing(s, limit).len()).sum()
    };
    let mut proposals = parallel::map(asked.len(), |i| {
        let steps = STEPS.map(|s| asked[i].proposal(s * asked[i].depth_in_first));
        let scored = steps.map(|s| (num_agreeing(&s, WIDTHS[1] * limit), s));
        scored.into_iter().max_by_key(|s| s.0)
    });
    sort_by_key(&mut proposals, |p| {
        core::cmp::Reverse(p.as_ref().map(|p| p.0))
    });
    proposals.truncate(MAX_REFINED);
    let refined = parallel::map(proposals.len(), |i| {
        let mut found = proposals[i].as_ref()?.1;
        for width in WIDTHS {
            let mut closing = Closing {
                crossings: &asked,
                loss_px: width * limit,
            };
            let damping = Damping {
                max_steps: 20,
                least_drop: 1e-6,
                ..Damping::default()
            };
            (found, _) = minimize(&mut closing, found, &damping, || false);
        }
        Some((num_agreeing(&found, limit), found))
    });
    let (_, best) = refined.into_iter().flatten().max_by_key(|f| f.0)?;
    // Steps of a video by themselves too: loops between rooms that look alike may be many more.
    let is_step = |c: &&Crossing| {
        let candidates = &ground.params.candidates;
        candidates.is_video && c.first.abs_diff(c.second) <= ground.params.loops.near
    };
    let explains = |of: &[&Crossing]| {
        let num: usize = of.iter().map(|c| c.agreeing(&best, limit).len()).sum();
        let num_own: usize = of.iter().map(|c| c.num_own).sum();
        num as f64 >= MIN_AGREEING_SHARE * num_own as f64
    };
    let all: Vec<&Crossing> = crossings.iter().collect();
    let steps: Vec<&Crossing> = crossings.iter().filter(is_step).collect();
    if !explains(&all) || !explains(&steps) {
        return None;
    }
    let mut pairs = ground.pairs.to_vec();
    let mut is_kept = vec![true; pairs.len()];
    let mut is_agreeing = vec![false; ground.pictures.len()];
    for crossing in &crossings {
        let agreeing = crossing.agreeing(&best, limit);
        let pair = &mut pairs[crossing.pair];
        is_kept[crossing.pair] = explains(&[crossing]);
        if !is_kept[crossing.pair] {
            continue;
        }
        is_agreeing[crossing.first] = true;
        is_agreeing[crossing.second] = true;
        let raw = find(matches, pair)?;
        pair.matches = agreeing.iter().map(|m| raw.matches[*m]).collect();
        // What the pair says by itself, next to the right answer: the pieces are bent where they end, and come out otherwise.
        let own = agreeing.iter().map(|m| crossing.matches[*m]);
        let sigma = limit / crossing.focal_px;
        let movement = crossing.movement(&best);
        let movement = refine_pose(&movement, own, sigma * sigma, 10).unwrap_or(movement);
        let b_from_a = Rigid::new(movement.rotation, movement.translation);
        let is_swapped = pair.a as usize != crossing.first;
        pair.geometry.inliers.clone_from(&agreeing);
        pair.geometry.b_from_a = if is_swapped {
            b_from_a.inverse()
        } else {
            b_from_a
        };
    }
    let mut is_kept = is_kept.into_iter();
    pairs.retain(|_| is_kept.next().unwrap_or(true));
    let agreeing_in = |piece: &Attempt| {
        let both = piece.poses.iter().zip(&is_agreeing);
        both.filter(|(pose, agrees)| pose.is_some() && **agrees)
            .count()
    };
    (agreeing_in(first).min(agreeing_in(second)) >= MIN_AGREEING).then_some(Seam {
        first_from_second: best,
        pairs,
    })
}

fn find<'a>(matches: &'a [PairMatches], pair: &VerifiedPair) -> Option<&'a PairMatches> {
    matches.iter().find(|m| (m.a, m.b) == (pair.a, pair.b))
}

/// Both pieces in one world, adjusted; none when they do not fit.
fn joined(
    ground: &Ground<'_>,
    first: &Attempt,
    second: &Attempt,
    first_from_second: &Similarity,
) -> Option<Attempt> {
    let poses = first.poses.iter().zip(&second.poses).map(|(own, other)| {
        own.or_else(|| Some(first_from_second.transform_pose(other.as_ref()?)))
    });
    let mut both = ground.posed_attempt(&poses.collect::<Vec<_>>());
    both.cameras.clone_from(&first.cameras);
    close_loops(ground, &mut both);
    ground.adjust(&mut both, &Effort::thorough());
    ground.triangulate(&mut both, 1.0);
    let num_strays = clean(ground, &mut both);
    // A piece that is cut off again, or bent, does not belong there. Where the camera goes straight on, the scale of what lies
    // ahead is in no match across, and the wrong one bends.
    let smaller = first.num_registered().min(second.num_registered());
    let before = first.num_observations() + second.num_observations();
    let fits = num_strays as f64 <= (1.0 - MIN_KEPT) * smaller as f64
        && both.num_observations() as f64 >= MIN_KEPT * before as f64
        && [first, second].iter().all(|p| keeps(p, &both.poses));
    fits.then_some(both)
}

/// What lies across the gaps between pieces.
struct Bridges {
    /// Matches of pairs across.
    matches: Vec<PairMatches>,
    /// All verified pairs, those across with the others.
    pairs: Vec<VerifiedPair>,
}

/// Compares pictures across the gaps that were not compared before, or not believed: with the cameras that growth found, and
/// with each other as witnesses. `None` when stopped.
async fn bridges(
    ground: &Ground<'_>,
    matches: &[PairMatches],
    pieces: &[Attempt],
    watch: &mut Watch<'_>,
) -> Option<Bridges> {
    let (pictures, params) = (ground.pictures, ground.params);
    let piece = |i: usize| pieces.iter().position(|p| p.poses[i].is_some());
    let piece_of: Vec<Option<usize>> = (0..pictures.len()).map(piece).collect();
    let is_across = |m: &&PairMatches| {
        let ends = (piece_of[m.a as usize], piece_of[m.b as usize]);
        matches!(ends, (Some(a), Some(b)) if a != b)
    };
    let mut across: Vec<PairMatches> = matches.iter().filter(is_across).cloned().collect();
    let features: Vec<&FeatureSet> = pictures.iter().map(|p| p.features).collect();
    let mut new = bridging_pairs(&features, &piece_of, &params.candidates);
    new.retain(|(a, b)| {
        !across
            .iter()
            .any(|m| (m.a as usize, m.b as usize) == (*a, *b))
    });
    let least = params.two_view.min_inliers;
    across.extend(verify::match_candidates(pictures, &new, params.min_cosine, least, watch).await?);
    let cameras = &pieces.first()?.cameras;
    let held = ground.pairs;
    let holds = |a: u32, b: u32| held.iter().any(|p| (p.a, p.b) == (a, b));
    let unsure: Vec<PairMatches> = (across.iter())
        .filter(|m| !holds(m.a, m.b))
        .cloned()
        .collect();
    let mut pairs = held.to_vec();
    pairs.extend(verify::verify(pictures, cameras, &unsure, &params.two_view, watch).await?);
    let mut believed = pairs.clone();
    let rejected = reject_lonely(&mut believed, params.candidates.is_video, &params.loops);
    // What held before holds.
    let mut at = 0..;
    pairs.retain(|p| at.next().is_some_and(|i| i < held.len()) || !rejected.contains(&(p.a, p.b)));
    Some(Bridges {
        matches: across,
        pairs,
    })
}

/// Joins pieces where views from far apart bridge the gap between them; the pairs that then hold, or none when nothing was
/// joined and `pieces` are as they were. `None` when stopped.
pub(super) async fn bridge_gaps(
    ground: &Ground<'_>,
    matches: &[PairMatches],
    pieces: &mut Vec<Attempt>,
    watch: &mut Watch<'_>,
) -> Option<Option<Vec<VerifiedPair>>> {
    if pieces.len() < 2 {
        return Some(None);
    }
    let bridges = bridges(ground, matches, pieces, watch).await?;
    let wide = ground.with_pairs(&bridges.pairs);
    let mut moved = pieces.clone();
    for piece in &mut moved {
        triangulate_anew(&wide, piece);
    }
    let joined = join_pieces(&wide, &bridges.matches, &mut moved, watch).await?;
    if joined.is_some() {
        *pieces = moved;
    }
    Some(joined)
}

/// Points of a piece on the tracks of other pairs.
fn triangulate_anew(ground: &Ground<'_>, piece: &mut Attempt) {
    piece.points = vec![None; ground.tracks.len()];
    ground.triangulate(piece, 1.0);
}

/// Sorts pieces by the number of their pictures.
pub(super) fn largest_first(pieces: &mut [Attempt]) {
    sort_by_key(pieces, |p| core::cmp::Reverse(p.num_registered()));
}

/// Joins what can be joined, the largest first, and lets it grow on; the pairs that then hold, or none when nothing was joined.
/// `None` when stopped.
async fn join_pieces(
    start: &Ground<'_>,
    matches: &[PairMatches],
    pieces: &mut Vec<Attempt>,
    watch: &mut Watch<'_>,
) -> Option<Option<Vec<VerifiedPair>>> {
    let mut pairs: Option<Vec<VerifiedPair>> = None;
    largest_first(pieces);
    let mut at = 0;
    while at + 1 < pieces.len() {
        let held = pairs.clone();
        let before = start.with_pairs(held.as_deref().unwrap_or(start.pairs));
        let next = (at + 1..pieces.len()).find_map(|other| {
            let (first, second) = (&pieces[at], &pieces[other]);
            let seam = seam(&before, matches, first, second)?;
            let ground = start.with_pairs(&seam.pairs);
            let both = joined(&ground, first, second, &seam.first_from_second)?;
            Some((other, both, seam.pairs))
        });
        let Some((other, both, seam_pairs)) = next else {
            at += 1;
            continue;
        };
        pieces.remove(other);
        let ground = start.with_pairs(&seam_pairs);
        let mut is_done = vec![false; ground.pictures.len()];
        for (p, piece) in pieces.iter_mut().enumerate() {
            if p == at {
                continue;
            }
            for (done, pose) in is_done.iter_mut().zip(&piece.poses) {
                *done |= pose.is_some();
            }
            triangulate_anew(&ground, piece);
        }
        pieces[at] = grow_all(&ground, both, &is_done, watch).await?;
        pairs = Some(seam_pairs);
    }
    Some(pairs)
}
