//! Where a reconstruction starts, and how it goes on from there.

use super::adjust::Effort;
use super::contradict::drop_contradicted;
use super::grow::{Attempt, Ground};
use super::{CameraGroup, MotionParams, PairMatches, Picture, VerifiedPair, verify};
use crate::geometry::{Camera, CameraModel};
use crate::math::order::sort_by;
use crate::reconstruction::{Stage, TwoViewKind, Watch, vote_focal};

/// The camera with another focal length and no distortion; a given model keeps its own.
pub(super) fn with_focal(camera: &Camera, focal_px: f64) -> Camera {
    let c = camera.principal_point();
    Camera {
        model: CameraModel::SimpleRadial {
            f: focal_px,
            cx: c.x,
            cy: c.y,
            k: 0.0,
        },
        ..*camera
    }
}

/// Pairs that vote for one group.
const MAX_VOTERS: usize = 120;

/// Focal lengths in pixels to try for each group, best first; empty where it is given.
pub(super) fn focal_hypotheses(
    pictures: &[Picture<'_>],
    groups: &[CameraGroup],
    matches: &[PairMatches],
    params: &MotionParams,
) -> Vec<Vec<f64>> {
    groups
        .iter()
        .enumerate()
        .map(|(g, group)| {
            if group.has_focal {
                return Vec::new();
            }
            let camera = &group.camera;
            let voters =
                verify::fundamentals(pictures, camera, g, matches, MAX_VOTERS, &params.two_view);
            let side = f64::from(camera.width.max(camera.height));
            vote_focal(&voters)
                .hypotheses
                .iter()
                .map(|f| f * side)
                .collect()
        })
        .collect()
}

/// Start pairs that are tried out for each focal hypothesis.
const MAX_STARTS: usize = 3;
/// Pictures that a start is grown to before starts are compared.
const TRIAL_PICTURES: usize = 10;

/// The start that grows best among the best pairs and focal hypotheses, or none when no pair is fit; `None` when stopped.
pub(super) async fn best_start(
    ground: &Ground<'_>,
    matches: &[PairMatches],
    cameras: &[Camera],
    hypotheses: &[Vec<f64>],
    is_done: &[bool],
    tried: &mut Vec<(u32, u32)>,
    watch: &mut Watch<'_>,
) -> Option<Option<Attempt>> {
    let mut ranked: Vec<(f64, &VerifiedPair)> = ground
        .pairs
        .iter()
        .filter(|p| {
            p.geometry.kind == TwoViewKind::General
                && !is_done[p.a as usize]
                && !is_done[p.b as usize]
                && !tried.contains(&(p.a, p.b))
        })
        .map(|p| {
            // Wide enough for depth, narrow enough for many points in common with others.
            let angle = p.geometry.parallax_rad.to_degrees();
            let fit = (angle / 5.0).min(1.0) * (20.0 / angle.max(1e-6)).min(1.0);
            (p.matches.len() as f64 * fit * fit, p)
        })
        .collect();
    sort_by(&mut ranked, |x, y| {
        y.0.total_cmp(&x.0)
            .then((x.1.a, x.1.b).cmp(&(y.1.a, y.1.b)))
    });
    let mut chosen: Vec<&VerifiedPair> = Vec::new();
    for (_, pair) in ranked {
        let is_apart = chosen
            .iter()
            .all(|c| c.a.abs_diff(pair.a) > 3 || c.b.abs_diff(pair.b) > 3);
        if is_apart {
            chosen.push(pair);
        }
        if chosen.len() == MAX_STARTS {
            break;
        }
    }
    // All groups go with their first hypothesis; the group of the start pair also with its second.
    let mut best: Option<((usize, usize), Attempt)> = None;
    for pair in chosen {
        tried.push((pair.a, pair.b));
        let group = ground.pictures[pair.a as usize].camera;
        let alternatives = hypotheses.get(group).map_or(0, Vec::len).max(1);
        for h in 0..alternatives {
            let mut cameras = cameras.to_vec();
            let mut geometry = pair.geometry.clone();
            let other = hypotheses.get(group).and_then(|of_group| of_group.get(h));
            if let (1.., Some(focal)) = (h, other) {
                cameras[group] = with_focal(&cameras[group], *focal);
                let Some(again) = reverified(ground, matches, &cameras, pair) else {
                    continue;
                };
                geometry = again.geometry;
            }
            let (a, b) = (pair.a as usize, pair.b as usize);
            let Some(mut attempt) = ground.start(&cameras, a, b, &geometry) else {
                continue;
            };
            while attempt.num_registered() < TRIAL_PICTURES {
                watch.tell(Stage::Grow, 0, ground.pictures.len()).await?;
                if !grow_once(
                    ground,
                    &mut attempt,
                    2,
                    ground.params.min_sure_share,
                    is_done,
                ) {
                    break;
                }
            }
            let rank = (attempt.num_registered(), attempt.num_observations());
            if best.as_ref().is_none_or(|(most, _)| rank > *most) {
                best = Some((rank, attempt));
            }
        }
    }
    Some(best.map(|(_, attempt)| attempt))
}

fn reverified(
    ground: &Ground<'_>,
    matches: &[PairMatches],
    cameras: &[Camera],
    pair: &VerifiedPair,
) -> Option<VerifiedPair> {
    let raw = matches.iter().find(|m| (m.a, m.b) == (pair.a, pair.b))?;
    let (a, b) = (pair.a as usize, pair.b as usize);
    let place = |i: usize| {
        let picture = &ground.pictures[i];
        verify::places(picture, &cameras[picture.camera])
    };
    let focal = verify::mean_focal(ground.pictures, cameras, a, b);
    verify::verify_pair(raw, &place(a), &place(b), focal, &ground.params.two_view)
}

/// One round; false when no picture could be added.
fn grow_once(
    ground: &Ground<'_>,
    attempt: &mut Attempt,
    most: usize,
    min_share: f64,
    is_done: &[bool],
) -> bool {
    let num = ground.register(attempt, most, min_share, is_done);
    if num == 0 {
        return false;
    }
    ground.triangulate(attempt, 1.0);
    ground.adjust(attempt, &Effort::quick());
    ground.triangulate(attempt, 1.0);
    clean(ground, attempt);
    true
}

/// Takes out what the rest contradicts. How many pictures it were.
pub(super) fn clean(ground: &Ground<'_>, attempt: &mut Attempt) -> usize {
    let mut num = ground.drop_strays(attempt);
    num += drop_contradicted(ground, attempt);
    if num > 0 {
        ground.triangulate(attempt, 1.0);
    }
    num
}

/// Draws together what came apart by drift: points and losses get wide, then narrow again.
pub(super) fn close_loops(ground: &Ground<'_>, attempt: &mut Attempt) {
    for factor in [4.0, 2.0] {
        ground.triangulate(attempt, factor);
        ground.adjust(attempt, &Effort::wide(factor));
    }
    ground.triangulate(attempt, 1.0);
}

/// Grows until nothing can be added, adjusts thoroughly, tries once more what was left out.
pub(super) async fn grow_all(
    ground: &Ground<'_>,
    mut attempt: Attempt,
    is_done: &[bool],
    watch: &mut Watch<'_>,
) -> Option<Attempt> {
    let total = ground.pictures.len();
    for round in 0..3 {
        // First what is sure; what fits half only waits until the rest stands.
        let min_share = if round == 0 {
            ground.params.min_sure_share
        } else {
            ground.params.min_inlier_share
        };
        loop {
            watch
                .tell(Stage::Grow, attempt.num_registered(), total)
                .await?;
            let most = (attempt.num_registered() / 4).max(2);
            if !grow_once(ground, &mut attempt, most, min_share, is_done) {
                break;
            }
        }
        watch.tell(Stage::Adjust, round, 3).await?;
        close_loops(ground, &mut attempt);
        ground.adjust(&mut attempt, &Effort::thorough());
        ground.triangulate(&mut attempt, 1.0);
        let num_strays = clean(ground, &mut attempt);
        attempt.try_all_again();
        let has_more = ground
            .candidates(&attempt)
            .iter()
            .any(|c| !is_done[c.picture]);
        if num_strays == 0 && !has_more {
            break;
        }
    }
    ground.adjust(&mut attempt, &Effort::thorough());
    ground.triangulate(&mut attempt, 1.0);
    clean(ground, &mut attempt);
    watch.tell(Stage::Adjust, 3, 3).await?;
    Some(attempt)
}
