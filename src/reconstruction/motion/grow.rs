//! Growth of a reconstruction: register pictures, triangulate, adjust, and again.
//!
//! Tracks are joined once from the verified matches. After each round every track is looked at anew under the poses as they
//! are now, so that nothing that was believed too early stays.

use super::adjust::Effort;
use super::refine::GivenPoses;
use super::{CameraGroup, MotionParams, Picture, VerifiedPair};
use crate::geometry::{CamFromWorld, Camera};
use crate::math::Rng;
use crate::math::elementary::ln;
use crate::math::order::sort_by_key;
use crate::math::parallel;
use crate::math::stats::median_in_place;
use crate::pose::{self, Focal, PointCorrespondence, PoseOptions, PoseScratch, WorldNoise};
use crate::reconstruction::points::{Nodes, best_point, join, nearest_first};
use crate::reconstruction::{Bundle, Observation, PointParams, PosedView, TwoView};
use nalgebra::Vector3;

pub(super) const NO_TRACK: u32 = u32::MAX;

/// What does not change while a reconstruction grows.
pub(super) struct Ground<'a> {
    pub(super) pictures: &'a [Picture<'a>],
    pub(super) groups: &'a [CameraGroup],
    pub(super) pairs: &'a [VerifiedPair],
    pub(super) params: &'a MotionParams,
    /// Keypoints that were matched to each other, at most one a picture.
    pub(super) tracks: Vec<Vec<Observation>>,
    /// Track of each keypoint of each picture.
    pub(super) track_of: Vec<Vec<u32>>,
    /// Poses that hold the world in place, where there are some.
    pub(super) given: Option<GivenPoses>,
}

/// A point with the observations that agree with it.
#[derive(Debug, Clone)]
pub(super) struct Point {
    pub(super) position: Vector3<f64>,
    pub(super) observations: Vec<Observation>,
}

/// A picture that may be registered next.
pub(super) struct Candidate {
    pub(super) picture: usize,
    /// Points that it sees.
    count: usize,
    /// The more, the better.
    rank: usize,
}

/// A reconstruction while it grows.
#[derive(Debug, Clone)]
pub(super) struct Attempt {
    /// One camera for each group.
    pub(super) cameras: Vec<Camera>,
    /// One for each picture.
    pub(super) poses: Vec<Option<CamFromWorld>>,
    /// One for each track.
    pub(super) points: Vec<Option<Point>>,
    /// Points that a picture saw when it could not be located, or lost its pose again.
    tried: Vec<usize>,
    /// How often a picture lost its pose again.
    lost: Vec<u8>,
}

impl<'a> Ground<'a> {
    pub(super) fn new(
        pictures: &'a [Picture<'a>],
        groups: &'a [CameraGroup],
        pairs: &'a [VerifiedPair],
        params: &'a MotionParams,
    ) -> Self {
        let nodes = Nodes::of_lengths(pictures.iter().map(|p| p.features.keypoints.len()));
        let mut edges = Vec::new();
        for pair in pairs {
            for (k, l, cosine) in &pair.matches {
                let a = nodes.of(Observation::new(pair.a as usize, *k as usize));
                let b = nodes.of(Observation::new(pair.b as usize, *l as usize));
                edges.push((a, b, *cosine));
            }
        }
        edges.sort_unstable_by(nearest_first);
        let tracks = join(&nodes, &edges);
        let mut track_of: Vec<Vec<u32>> = pictures
            .iter()
            .map(|p| vec![NO_TRACK; p.features.keypoints.len()])
            .collect();
        for (t, track) in tracks.iter().enumerate() {
            for o in track {
                track_of[o.view as usize][o.feature as usize] = t as u32;
            }
        }
        Self {
            pictures,
            groups,
            pairs,
            params,
            tracks,
            track_of,
            given: None,
        }
    }

    /// The same pictures with other pairs.
    pub(super) fn with_pairs<'b>(&'b self, pairs: &'b [VerifiedPair]) -> Ground<'b> {
        Ground::new(self.pictures, self.groups, pairs, self.params)
    }

    /// The same tracks under other beliefs about the cameras.
    pub(super) fn with_cameras<'b>(
        &self,
        pictures: &'b [Picture<'b>],
        groups: &'b [CameraGroup],
    ) -> Ground<'b>
    where
        'a: 'b,
    {
        Ground {
            pictures,
            groups,
            pairs: self.pairs,
            params: self.params,
            tracks: self.tracks.clone(),
            track_of: self.track_of.clone(),
            given: None,
        }
    }

    /// A reconstruction of two pictures; `None` when too few points come out.
    pub(super) fn start(
        &self,
        cameras: &[Camera],
        a: usize,
        b: usize,
        geometry: &TwoView,
    ) -> Option<Attempt> {
        let mut attempt = self.attempt(cameras.to_vec(), vec![None; self.pictures.len()]);
        attempt.poses[a] = Some(CamFromWorld::identity());
        attempt.poses[b] = Some(CamFromWorld::new(
            geometry.b_from_a.rotation,
            geometry.b_from_a.translation,
        ));
        self.triangulate(&mut attempt, 1.0);
        (attempt.num_points() >= self.params.min_start_points).then(|| {
            self.adjust(&mut attempt, &Effort::quick());
            self.triangulate(&mut attempt, 1.0);
            attempt
        })
    }

    fn attempt(&self, cameras: Vec<Camera>, poses: Vec<Option<CamFromWorld>>) -> Attempt {
        let n = self.pictures.len();
        Attempt {
            cameras,
            poses,
            points: vec![None; self.tracks.len()],
            tried: vec![0; n],
            lost: vec![0; n],
        }
    }

    /// A reconstruction that begins with poses, without points.
    pub(super) fn posed_attempt(&self, poses: &[Option<CamFromWorld>]) -> Attempt {
        let cameras = self.groups.iter().map(|g| g.camera).collect();
        self.attempt(cameras, poses.to_vec())
    }

    /// Median depth of the points in the pictures that see them.
    pub(super) fn median_depth(&self, attempt: &Attempt) -> Option<f64> {
        let mut depths: Vec<f64> = attempt
            .points
            .iter()
            .flatten()
            .flat_map(|p| p.observations.iter().map(move |o| (p, o.view)))
            .filter_map(|(p, v)| {
                let pose = attempt.poses[v as usize].as_ref()?;
                Some(pose.transform_point(&p.position).z)
            })
            .collect();
        median_in_place(&mut depths)
    }

    /// Registered pictures with their rays, and the position of each picture among them.
    pub(super) fn posed(&self, attempt: &Attempt) -> (Vec<usize>, Vec<PosedView<'a>>, Vec<u32>) {
        let registered: Vec<usize> = (0..attempt.poses.len())
            .filter(|i| attempt.poses[*i].is_some())
            .collect();
        let views = parallel::map(registered.len(), |r| {
            let picture = &self.pictures[registered[r]];
            let pose = attempt.poses[registered[r]].unwrap_or(CamFromWorld::identity());
            PosedView::new(attempt.cameras[picture.camera], pose, picture.features)
        });
        let mut position = vec![NO_TRACK; attempt.poses.len()];
        for (r, i) in registered.iter().enumerate() {
            position[*i] = r as u32;
        }
        (registered, views, position)
    }

    /// Every track anew under the present poses, with the error limit widened by a factor: what came apart by drift is one
    /// point again while the limit is wide.
    pub(super) fn triangulate(&self, attempt: &mut Attempt, widen: f64) {
        let (registered, views, position) = self.posed(attempt);
        let bundle = Bundle { views: &views };
        let params = PointParams {
            max_error_px: widen * self.params.max_error_px,
            min_angle_deg: self.params.min_angle_deg,
            ..PointParams::default()
        };
        let old = &attempt.points;
        attempt.points = parallel::map(self.tracks.len(), |t| {
            let seen: Vec<Observation> = self.tracks[t]
                .iter()
                .filter(|o| position[o.view as usize] != NO_TRACK)
                .map(|o| Observation {
                    view: position[o.view as usize],
                    feature: o.feature,
                })
                .collect();
            if seen.len() < 2 {
                return None;
            }
            let fits = |position: &Vector3<f64>| -> Vec<Observation> {
                let near = |o: &&Observation| bundle.error_px(**o, position) <= params.max_error_px;
                seen.iter().filter(near).copied().collect()
            };
            let kept = old[t].as_ref().and_then(|known| {
                let inliers = fits(&known.position);
                // A point that most of its observations contradict is searched for anew.
                if inliers.len() < 2 || 3 * inliers.len() < 2 * seen.len() {
                    return None;
                }
                let position = bundle.refine(&inliers, known.position, 1.5 * widen);
                let inliers = fits(&position);
                (inliers.len() >= 2).then_some((position, inliers))
            });
            let (position, inliers) = match kept {
                Some(found) => found,
                None => {
                    let found = best_point(&bundle, &seen, &params, &mut Rng::from_seed(t as u64))?;
                    (found.point_in_world, found.observations)
                }
            };
            let angle = bundle.largest_angle(&inliers, &position);
            (angle.to_degrees() >= params.min_angle_deg).then(|| Point {
                position,
                observations: inliers
                    .iter()
                    .map(|o| Observation {
                        view: registered[o.view as usize] as u32,
                        feature: o.feature,
                    })
                    .collect(),
            })
        });
    }

    /// Pictures without a pose, those that see most points in most places first.
    pub(super) fn candidates(&self, attempt: &Attempt) -> Vec<Candidate> {
        let mut found: Vec<Candidate> = (0..self.pictures.len())
            .filter(|i| attempt.poses[*i].is_none() && attempt.lost[*i] < MAX_LOST)
            .filter_map(|i| {
                let camera = &attempt.cameras[self.pictures[i].camera];
                let (w, h) = (f64::from(camera.width), f64::from(camera.height));
                let (mut count, mut cells) = (0, [false; 64]);
                for (k, t) in self.track_of[i].iter().enumerate() {
                    if *t == NO_TRACK || attempt.points[*t as usize].is_none() {
                        continue;
                    }
                    count += 1;
                    let p = self.pictures[i].features.keypoints[k].pixel;
                    let cell = |v: f64, size: f64| ((8.0 * v / size).max(0.0) as usize).min(7);
                    cells[8 * cell(p.y, h) + cell(p.x, w)] = true;
                }
                let spread = cells.iter().filter(|c| **c).count();
                let is_new = attempt.tried[i] == 0 || 4 * count > 5 * attempt.tried[i];
                (count >= self.params.min_inliers && is_new).then_some(Candidate {
                    picture: i,
                    count,
                    rank: count * spread,
                })
            })
            .collect();
        sort_by_key(&mut found, |c| (core::cmp::Reverse(c.rank), c.picture));
        found
    }

    /// Keypoints of a picture that belong to a point.
    pub(super) fn num_seen(&self, attempt: &Attempt, i: usize) -> usize {
        let has_point = |t: &&u32| **t != NO_TRACK && attempt.points[**t as usize].is_some();
        self.track_of[i].iter().filter(has_point).count()
    }

    /// Where a picture was taken from, by the points that it sees.
    fn locate(
        &self,
        attempt: &Attempt,
        i: usize,
        min_share: f64,
        scratch: &mut PoseScratch,
    ) -> Option<CamFromWorld> {
        let picture = &self.pictures[i];
        let points: Vec<PointCorrespondence> = self.track_of[i]
            .iter()
            .zip(&picture.features.keypoints)
            .filter(|(t, _)| **t != NO_TRACK)
            .filter_map(|(t, keypoint)| {
                let point = attempt.points[*t as usize].as_ref()?;
                Some(PointCorrespondence {
                    pixel: keypoint.pixel,
                    point_in_world: point.position,
                    confidence: 0.7,
                    sigma_px: 0.0,
                    sigma_m: 0.0,
                })
            })
            .collect();
        let options = PoseOptions {
            max_point_error_px: 2.0 * self.params.max_error_px,
            max_iterations: 2_000,
            seed: i as u64,
            focal: Focal::Known,
            world_noise: WorldNoise::Negligible,
            ..PoseOptions::default()
        };
        let camera = &attempt.cameras[picture.camera];
        let outcome = pose::estimate(&points, &[], camera, &options, scratch, &mut || 0.0).ok()?;
        let found = outcome.located()?;
        let num = found.num_point_inliers as usize;
        let is_enough =
            num >= self.params.min_inliers && num as f64 >= min_share * points.len() as f64;
        let judges_zoom = self.groups[picture.camera].refines
            && attempt.num_registered() >= self.params.refine_radial_from;
        if is_enough && judges_zoom {
            let focal = Focal::Refine {
                sigma_ln: FREE_SIGMA_LN,
            };
            let options = PoseOptions { focal, ..options };
            let free = pose::estimate(&points, &[], camera, &options, scratch, &mut || 0.0).ok()?;
            let is_other = free.located().is_some_and(|free| {
                let (own_px, px) = (free.camera.focal_px().0, camera.focal_px().0);
                let off_ln = ln(own_px / px).abs();
                off_ln > MAX_ZOOM_LN && off_ln > ZOOM_SIGMAS * free.sigma_focal_px / own_px
            });
            if is_other {
                return None;
            }
        }
        is_enough.then_some(found.cam_from_world)
    }

    /// Registers the most promising pictures that are not taken, `most` of them at most. How many it were.
    pub(super) fn register(
        &self,
        attempt: &mut Attempt,
        most: usize,
        min_share: f64,
        is_taken: &[bool],
    ) -> usize {
        let mut candidates = self.candidates(attempt);
        candidates.retain(|c| !is_taken[c.picture]);
        // What sees little now may see more after the others.
        let least = candidates.first().map_or(0, |c| c.rank / 2);
        candidates.retain(|c| c.rank >= least);
        candidates.truncate(2 * most);
        let found = parallel::map_with(candidates.len(), PoseScratch::new, |scratch, c| {
            self.locate(attempt, candidates[c].picture, min_share, scratch)
        });
        let mut num = 0;
        let mut num_failed = 0;
        for (candidate, pose) in candidates.into_iter().zip(found) {
            let i = candidate.picture;
            match pose {
                Some(pose) if num < most => {
                    attempt.poses[i] = Some(pose);
                    num += 1;
                }
                Some(_) => {}
                None => {
                    attempt.tried[i] = candidate.count;
                    num_failed += 1;
                }
            }
        }
        // Those that fail do not come again before they see more: the next in line get their turn.
        if num == 0 && num_failed > 0 {
            return self.register(attempt, most, min_share, is_taken);
        }
        num
    }

    /// Takes poses from pictures that the points of the others contradict. How many it were.
    ///
    /// Only points count that two other pictures see: what a stray made up with one neighbour does not speak for it.
    pub(super) fn drop_strays(&self, attempt: &mut Attempt) -> usize {
        let shares: Vec<Option<(usize, usize, f64)>> = parallel::map(attempt.poses.len(), |i| {
            attempt.poses[i]?;
            let (mut fits, mut seen) = (0, 0);
            for t in self.track_of[i].iter().filter(|t| **t != NO_TRACK) {
                let Some(point) = &attempt.points[*t as usize] else {
                    continue;
                };
                let is_own = point.observations.iter().any(|o| o.view as usize == i);
                if point.observations.len() >= 2 + usize::from(is_own) {
                    seen += 1;
                    fits += usize::from(is_own);
                }
            }
            Some((fits, seen, fits as f64 / (seen as f64).max(1.0)))
        });
        let mut all: Vec<f64> = shares.iter().flatten().map(|s| s.2).collect();
        let least = STRAY_SHARE * median_in_place(&mut all).unwrap_or(0.0);
        let mut num = 0;
        for (i, share) in shares.into_iter().enumerate() {
            let Some((fits, seen, share)) = share else {
                continue;
            };
            let is_stray = share < least || fits < self.params.min_inliers;
            if is_stray && attempt.num_registered() > 3 {
                attempt.drop_pose(i, seen);
                num += 1;
            }
        }
        num
    }
}

/// A picture whose own focal length differs by so much from its camera's was taken with another zoom or lens: placed with the
/// camera's it would stand where it never was. While a model grows it is off by more than its deviation says: with 0.06 a room that
/// was filmed without zoom fell into pieces.
const MAX_ZOOM_LN: f64 = 0.2;
/// And by so many standard deviations: before a flat wall any focal length fits.
pub(super) const ZOOM_SIGMAS: f64 = 4.0;
/// How free a picture's own focal length is, as a standard deviation of ln f.
const FREE_SIGMA_LN: f64 = 0.3;
/// A picture is a stray when it agrees with this share of what pictures usually agree with.
const STRAY_SHARE: f64 = 0.65;
/// A picture that lost its pose so often is not tried again.
const MAX_LOST: u8 = 3;

impl Attempt {
    pub(super) fn num_registered(&self) -> usize {
        self.poses.iter().flatten().count()
    }

    pub(super) fn num_points(&self) -> usize {
        self.points.iter().flatten().count()
    }

    pub(super) fn num_observations(&self) -> usize {
        self.points
            .iter()
            .flatten()
            .map(|p| p.observations.len())
            .sum()
    }

    /// Takes a pose from a picture, which is not tried again before it sees clearly more points than now.
    pub(super) fn drop_pose(&mut self, i: usize, num_seen: usize) {
        self.poses[i] = None;
        self.tried[i] = num_seen;
        self.lost[i] = self.lost[i].saturating_add(1);
    }

    /// Forgets which pictures could not be located.
    pub(super) fn try_all_again(&mut self) {
        self.tried.fill(0);
    }
}
