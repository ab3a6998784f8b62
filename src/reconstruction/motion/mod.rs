//! Structure from motion: camera poses from pictures alone.
//!
//! * **In and out**: [`Picture`]s with features and a camera group each; out a [`Motion`]: components of posed pictures with
//!   points, refined cameras, and for every picture left out the reason.
//! * **Spaces and units**: pixels of each picture; the world is that of the first picture of each component's start, in an
//!   arbitrary unit.
//! * **Method**: candidate pairs ([`candidate_pairs`]), mutual matches, two-view geometry with a label, focal length by vote,
//!   loops that need agreeing neighbours, then growth from a start pair: register, triangulate, adjust. The largest model
//!   wins; a toy of a few pictures is never delivered while more can be had.
//! * **Invariants**: no files, no clock, threads only with `parallel`; the same pictures give the same result.
//! * **Cost**: matching and verification grow with pairs, adjustment with the cube of the pictures.
//!
//! Known limit: parts that verified matches contradict, or between which pairs turn otherwise than the model, are taken out, and
//! may come back as components of their own; `rms_px` alone would not show them. A long walk may so come in pieces.
//!
//! Sources: Schönberger and Frahm, Structure-from-Motion Revisited (2016), for what incremental mapping needs.

mod adjust;
mod candidates;
mod contradict;
mod given;
mod grow;
mod join;
mod jump;
mod link;
mod loops;
mod refine;
mod start;
#[cfg(test)]
mod tests;
mod verify;
mod zoom;

pub use candidates::{CandidateParams, candidate_pairs};
pub use jump::Jump;
pub use link::WeakLink;
pub use loops::LoopParams;
pub use refine::{Agreement, Disagreement, RefineParams, Refined, Refinement, disagreement};
pub use verify::{PairMatches, VerifiedPair};
pub use zoom::MIN_APART_LN;

use super::{FOCAL_RANGE, Observation, Observer, PointTrack, TwoViewKind, TwoViewParams, Watch};
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera, Similarity};
use grow::{Attempt, Ground};
use start::{best_start, focal_hypotheses, grow_all, with_focal};
use zoom::Film;

/// A picture to be posed.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// In pixels of its camera.
    pub features: &'a FeatureSet,
    /// Index of its camera group.
    pub camera: usize,
}

/// Pictures that were taken with the same camera and zoom.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraGroup {
    /// As given; of an unknown camera only the size and the principal point count.
    pub camera: Camera,
    /// Whether the focal length is given at all.
    pub has_focal: bool,
    /// Whether focal length and one radial term are adjusted.
    pub refines: bool,
    /// Standard deviation of ln f about the start while it is refined.
    pub sigma_ln: f64,
}

impl CameraGroup {
    /// Intrinsics that are taken as they are.
    pub fn given(camera: Camera) -> Self {
        Self {
            camera,
            has_focal: true,
            refines: false,
            sigma_ln: 0.02,
        }
    }

    /// Only the size of the pictures is known.
    pub fn unknown(width: u32, height: u32) -> Self {
        let focal = super::FOCAL_PRIOR * f64::from(width.max(height));
        Self {
            camera: Camera::centered(width, height, focal),
            has_focal: false,
            refines: true,
            sigma_ln: 0.3,
        }
    }

    fn prior_focal_px(&self) -> f64 {
        let (fx, fy) = self.camera.focal_px();
        0.5 * (fx + fy)
    }
}

/// Thresholds and limits.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionParams {
    /// Which pairs are compared.
    pub candidates: CandidateParams,
    /// Least cosine of matched descriptors.
    pub min_cosine: f32,
    /// Two-view geometry.
    pub two_view: TwoViewParams,
    /// Loops.
    pub loops: LoopParams,
    /// Largest reprojection error of an observation.
    pub max_error_px: f64,
    /// Least angle between two rays of a point.
    pub min_angle_deg: f64,
    /// Points that a picture must agree with to be registered.
    pub min_inliers: usize,
    /// Share of the points that it sees, once everything else stands.
    pub min_inlier_share: f64,
    /// Share of the points that it sees, before.
    pub min_sure_share: f64,
    /// Points that two pictures must have to start.
    pub min_start_points: usize,
    /// Pictures from which on the focal length is adjusted.
    pub refine_focal_from: usize,
    /// Pictures from which on the radial term is adjusted.
    pub refine_radial_from: usize,
    /// Pictures in the smallest component that is delivered.
    pub min_component: usize,
}

impl Default for MotionParams {
    fn default() -> Self {
        Self {
            candidates: CandidateParams::default(),
            min_cosine: 0.82,
            two_view: TwoViewParams {
                max_iterations: 500,
                ..TwoViewParams::default()
            },
            loops: LoopParams::default(),
            max_error_px: 4.0,
            min_angle_deg: 1.5,
            min_inliers: 30,
            min_inlier_share: 0.3,
            min_sure_share: 0.5,
            min_start_points: 40,
            refine_focal_from: 4,
            refine_radial_from: 12,
            min_component: 3,
        }
    }
}

/// Why a picture has no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LeftOut {
    /// It shows nothing that another picture shows.
    NothingInCommon,
    /// All that it has in common with others was seen from the same spot.
    OnlyTurned,
    /// It has much in common with others, but they could not be located either, or it sees too few of their points.
    TooFewPoints,
    /// It sees points of the model, but no pose explains them.
    NoPose,
    /// It has a pose among others, in a piece that could not be joined to the largest.
    OtherPiece,
}

impl LeftOut {
    /// What happened and what helps, for people.
    pub fn message(self) -> &'static str {
        match self {
            Self::NothingInCommon => {
                "shows nothing that another picture shows: take pictures in between, or leave it out"
            }
            Self::OnlyTurned => {
                "the camera only turned on the spot: walk sideways while you film, do not turn only"
            }
            Self::TooFewPoints => {
                "sees too few points of the model: move slower here, with more light and more texture in view"
            }
            Self::NoPose => {
                "no position explains what it shows: another zoom, something that moved, or a place that looks like another"
            }
            Self::OtherPiece => {
                "belongs to another piece of the film that could not be joined: film the way from one to the other"
            }
        }
    }
}

/// Pictures that were posed together, in one world of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// One for each camera group.
    pub cameras: Vec<Camera>,
    /// Standard deviation of ln f of each, from the points; `None` where the focal length is given or undetermined.
    pub focal_sigma_ln: Vec<Option<f64>>,
    /// One for each picture, in their order.
    pub cam_from_world: Vec<Option<CamFromWorld>>,
    /// Points with the keypoints that see them; views are indices of pictures.
    pub points: Vec<PointTrack>,
    /// Root mean square of the reprojection errors.
    pub rms_px: f64,
}

impl Component {
    /// Posed pictures.
    pub fn num_registered(&self) -> usize {
        self.cam_from_world.iter().flatten().count()
    }

    /// Where the model hangs together by so few points that its two sides may differ in scale.
    pub fn weak_link(&self) -> Option<WeakLink> {
        let posed = self.cam_from_world.iter().enumerate();
        let pictures: Vec<usize> = posed.filter_map(|(i, p)| p.map(|_| i)).collect();
        WeakLink::weakest(&self.points, &pictures)
    }

    /// Where a film's camera jumps, as another zoom makes it do.
    pub fn jump(&self) -> Option<Jump> {
        Jump::largest(&self.cam_from_world)
    }

    /// Takes poses and points to another world, whose unit of length may differ.
    pub fn transform(&mut self, to: &Similarity) {
        for pose in self.cam_from_world.iter_mut().flatten() {
            *pose = to.transform_pose(pose);
        }
        for point in &mut self.points {
            point.point_in_world = to.transform_point(&point.point_in_world);
        }
    }
}

/// What came out.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Largest first.
    pub components: Vec<Component>,
    /// Camera of each picture among those of a component: as asked, but that stretches with another zoom have one of their own,
    /// behind the groups that were asked for.
    pub camera_of: Vec<usize>,
    /// For each picture that no component has.
    pub left_out: Vec<(usize, LeftOut)>,
    /// Pairs far apart that their neighbours contradict.
    pub rejected_loops: Vec<(u32, u32)>,
    /// Pairs that were compared, that had geometry, and the three labels.
    pub num_pairs: PairCounts,
    /// What the pairs say about the focal length of each group, in pixels, best first; empty where it was given.
    pub focal_votes_px: Vec<Vec<f64>>,
}

impl Motion {
    /// Pictures that the largest component does not have, in their order: those of other pieces, and those of none.
    pub fn without_pose(&self) -> Vec<(usize, LeftOut)> {
        let has_pose = |i: usize| {
            let largest = self.components.first();
            largest.is_some_and(|c| c.cam_from_world[i].is_some())
        };
        let reason = |i: usize| {
            let of_picture = self.left_out.iter().find(|(l, _)| *l == i);
            of_picture.map_or(LeftOut::OtherPiece, |(_, reason)| *reason)
        };
        let without = (0..self.camera_of.len()).filter(|i| !has_pose(*i));
        without.map(|i| (i, reason(i))).collect()
    }
}

/// How many pairs came how far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PairCounts {
    /// With enough matches.
    pub matched: usize,
    /// With geometry.
    pub verified: usize,
    /// Labelled general.
    pub general: usize,
    /// Labelled planar.
    pub planar: usize,
    /// Labelled rotation only.
    pub turned: usize,
}

/// Why there is no model at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// Fewer than two pictures.
    #[error("too few pictures ({0}): poses need at least three that overlap, better thirty")]
    TooFew(usize),
    /// A picture names a camera group that is not there.
    #[error("picture {picture} names camera group {group}, there are {num_groups}")]
    NoGroup {
        /// Which one.
        picture: usize,
        /// What it names.
        group: usize,
        /// How many there are.
        num_groups: usize,
    },
    /// No two pictures see the same thing from two places.
    #[error(
        "no two of the {pictures} pictures show the same thing from two places ({verified} pairs overlap, {turned} of them only turned): {advice}"
    )]
    NoStart {
        /// Pictures in all.
        pictures: usize,
        /// Pairs with geometry.
        verified: usize,
        /// Pairs that only turned.
        turned: usize,
        /// What helps.
        advice: &'static str,
    },
    /// The pictures are of another camera than the one that was given.
    #[error(
        "the focal length given for camera group {group} is {given_px:.0} pixels, but the pictures say about {seen_px:.0}: \
         leave it out, or give that of the pictures as they are (a crop or a zoom has another)"
    )]
    Focal {
        /// Camera group.
        group: usize,
        /// As given.
        given_px: f64,
        /// As the model has it when it is free.
        seen_px: f64,
    },
    /// No few focal lengths explain the pictures.
    #[error("the zoom changes all along the film, and no model can be trusted: film with one zoom")]
    Zoom,
    /// The caller stopped it.
    #[error("stopped")]
    Stopped,
}

/// Matches of the candidate pairs: the first half of [`reconstruct_motion`], to be kept where it is to be resumable.
///
/// # Errors
/// [`MotionError::TooFew`], [`MotionError::NoGroup`], [`MotionError::Stopped`].
pub async fn match_pictures(
    pictures: &[Picture<'_>],
    groups: &[CameraGroup],
    params: &MotionParams,
    observer: &mut dyn Observer,
) -> Result<Vec<PairMatches>, MotionError> {
    check(pictures, groups)?;
    let features: Vec<&FeatureSet> = pictures.iter().map(|p| p.features).collect();
    let candidates = candidate_pairs(&features, &params.candidates);
    match_candidates(pictures, groups, &candidates, params, observer).await
}

/// Matches of pairs that the caller chose, first below second.
///
/// # Errors
/// As [`match_pictures`].
pub async fn match_candidates(
    pictures: &[Picture<'_>],
    groups: &[CameraGroup],
    candidates: &[(usize, usize)],
    params: &MotionParams,
    observer: &mut dyn Observer,
) -> Result<Vec<PairMatches>, MotionError> {
    check(pictures, groups)?;
    let mut watch = Watch::new(observer);
    let least = params.two_view.min_inliers;
    verify::match_candidates(pictures, candidates, params.min_cosine, least, &mut watch)
        .await
        .ok_or(MotionError::Stopped)
}

fn check(pictures: &[Picture<'_>], groups: &[CameraGroup]) -> Result<(), MotionError> {
    if pictures.len() < 2 {
        return Err(MotionError::TooFew(pictures.len()));
    }
    match pictures.iter().position(|p| p.camera >= groups.len()) {
        Some(picture) => Err(MotionError::NoGroup {
            picture,
            group: pictures[picture].camera,
            num_groups: groups.len(),
        }),
        None => Ok(()),
    }
}

/// Poses and points from matched pairs.
///
/// # Errors
/// See [`MotionError`]: when nothing can be reconstructed, or the observer stopped it.
pub async fn reconstruct_motion(
    pictures: &[Picture<'_>],
    groups: &[CameraGroup],
    matches: &[PairMatches],
    params: &MotionParams,
    observer: &mut dyn Observer,
) -> Result<Motion, MotionError> {
    check(pictures, groups)?;
    let mut watch = Watch::new(observer);
    let film = Film {
        pictures: pictures.to_vec(),
        groups: groups.to_vec(),
        hypotheses: focal_hypotheses(pictures, groups, matches, params),
        is_between: vec![false; pictures.len()],
    };
    posed(&film, MAX_ZOOMS, matches, params, &mut watch).await
}

/// How often pictures are told apart by their zoom; a film where that does not end is refused.
const MAX_ZOOMS: usize = 1;

/// Poses and points under the focal lengths to try for each group; with another zoom all is done anew, with a camera for each.
async fn posed(
    film: &Film<'_>,
    zooms_left: usize,
    matches: &[PairMatches],
    params: &MotionParams,
    watch: &mut Watch<'_>,
) -> Result<Motion, MotionError> {
    let Film {
        pictures,
        groups,
        hypotheses,
        is_between,
    } = film;
    let mut groups = groups.clone();
    let mut cameras: Vec<Camera> = Vec::new();
    for (group, hypotheses) in groups.iter_mut().zip(hypotheses) {
        if let Some(focal) = hypotheses.first() {
            group.camera = with_focal(&group.camera, *focal);
        }
        cameras.push(group.camera);
    }
    let mut pairs = verify::verify(pictures, &cameras, matches, &params.two_view, watch)
        .await
        .ok_or(MotionError::Stopped)?;
    let rejected_loops =
        loops::reject_lonely(&mut pairs, params.candidates.is_video, &params.loops);
    let count = |kind| pairs.iter().filter(|p| p.geometry.kind == kind).count();
    let num_pairs = PairCounts {
        matched: matches.len(),
        verified: pairs.len(),
        general: count(TwoViewKind::General),
        planar: count(TwoViewKind::Planar),
        turned: count(TwoViewKind::RotationOnly),
    };
    let ground = Ground::new(pictures, &groups, &pairs, params);
    let mut pieces: Vec<Attempt> = Vec::new();
    let mut tried: Vec<(u32, u32)> = Vec::new();
    let mut is_done = is_between.clone();
    loop {
        let num_left = is_done.iter().filter(|d| !**d).count();
        if num_left < params.min_component.max(2) || pieces.len() >= 8 {
            break;
        }
        let Some(start) = best_start(
            &ground, matches, &cameras, hypotheses, &is_done, &mut tried, watch,
        )
        .await
        .ok_or(MotionError::Stopped)?
        else {
            break;
        };
        let grown = grow_all(&ground, start, &is_done, watch)
            .await
            .ok_or(MotionError::Stopped)?;
        let is_small = grown.num_registered() < params.min_component;
        let is_lens = (groups.iter().zip(&grown.cameras)).all(|(group, camera)| {
            let side = f64::from(camera.width.max(camera.height));
            let relative = camera.focal_px().0 / side;
            group.has_focal || (FOCAL_RANGE.0..=FOCAL_RANGE.1).contains(&relative)
        });
        for (done, pose) in is_done.iter_mut().zip(&grown.poses) {
            *done |= pose.is_some();
        }
        // What needs a focal length that no camera has was bent until it fitted.
        if !is_small && is_lens {
            pieces.push(grown);
        }
    }
    join::largest_first(&mut pieces);
    if let Some((zoomed, is_straight)) = zoom::told_apart(&ground, &pieces, film) {
        let is_bent = is_straight.contains(&false);
        if zooms_left > 0 {
            let again = posed(&zoomed, zooms_left - 1, matches, params, watch);
            let again = Box::pin(again).await?;
            let has_more = (again.components.first()).is_some_and(|all| {
                let largest = pieces.first().map_or(0, Attempt::num_registered);
                all.num_registered() > largest
                    && pieces.iter().all(|p| zoom::keeps(p, &all.cam_from_world))
            });
            if is_bent || has_more {
                return Ok(again);
            }
        } else if is_bent {
            return Err(MotionError::Zoom);
        }
    }
    let joined = join::bridge_gaps(&ground, matches, &mut pieces, watch)
        .await
        .ok_or(MotionError::Stopped)?;
    let ground = match &joined {
        Some(pairs) => ground.with_pairs(pairs),
        None => ground,
    };
    for piece in &pieces {
        if let Some(contradiction) = given::contradicted(&ground, piece) {
            return Err(contradiction);
        }
    }
    join::largest_first(&mut pieces);
    let components: Vec<Component> = pieces.iter().map(|p| component(&ground, p)).collect();
    if components.is_empty() {
        return Err(MotionError::NoStart {
            pictures: pictures.len(),
            verified: num_pairs.verified,
            turned: num_pairs.turned,
            advice: if is_between.contains(&true) {
                "the zoom moved while you filmed: film with one zoom"
            } else if 2 * num_pairs.turned > num_pairs.verified && num_pairs.turned > 0 {
                "walk sideways while you film, turning on the spot shows no depth"
            } else if num_pairs.verified == 0 {
                "take more pictures that overlap by half and more, sharp and with light"
            } else {
                "show more depth than one flat wall, and move between pictures"
            },
        });
    }
    let left_out = left_out(&ground, &components, pieces.first());
    Ok(Motion {
        components,
        camera_of: pictures.iter().map(|p| p.camera).collect(),
        left_out,
        rejected_loops,
        num_pairs,
        focal_votes_px: hypotheses.to_vec(),
    })
}

fn component(ground: &Ground<'_>, attempt: &Attempt) -> Component {
    let (_, views, position) = ground.posed(attempt);
    let (mut sum, mut num) = (0.0, 0usize);
    let mut points = Vec::new();
    for point in attempt.points.iter().flatten() {
        let mut own = 0.0;
        for o in &point.observations {
            let view = &views[position[o.view as usize] as usize];
            let error = view.error_px(o.feature as usize, &point.position);
            sum += error * error;
            own += error;
            num += 1;
        }
        let mut observations: Vec<Observation> = point.observations.clone();
        observations.sort_unstable();
        let mut track = PointTrack::new(point.position, observations);
        track.mean_error_px = (own / track.observations.len().max(1) as f64) as f32;
        points.push(track);
    }
    Component {
        cameras: attempt.cameras.clone(),
        focal_sigma_ln: ground.focal_sigmas(attempt),
        cam_from_world: attempt.poses.clone(),
        points,
        rms_px: (sum / num.max(1) as f64).sqrt(),
    }
}

fn left_out(
    ground: &Ground<'_>,
    components: &[Component],
    largest: Option<&Attempt>,
) -> Vec<(usize, LeftOut)> {
    let sees: Vec<usize> = match largest {
        Some(attempt) => ground
            .candidates(attempt)
            .into_iter()
            .map(|c| c.picture)
            .collect(),
        None => Vec::new(),
    };
    (0..ground.pictures.len())
        .filter(|i| components.iter().all(|c| c.cam_from_world[*i].is_none()))
        .map(|i| {
            let of_picture = |p: &&VerifiedPair| p.a as usize == i || p.b as usize == i;
            let mut own = ground.pairs.iter().filter(of_picture).peekable();
            let reason = if own.peek().is_none() {
                LeftOut::NothingInCommon
            } else if own.all(|p| p.geometry.kind == TwoViewKind::RotationOnly) {
                LeftOut::OnlyTurned
            } else if sees.contains(&i) {
                LeftOut::NoPose
            } else {
                LeftOut::TooFewPoints
            };
            (i, reason)
        })
        .collect()
}
