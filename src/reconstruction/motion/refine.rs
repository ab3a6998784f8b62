//! Better poses from poor ones: given poses are bent until the pictures agree, and no further.
//!
//! What headsets, phones and scanners report is right over short stretches and drifts over long ones. Matches are found
//! without the poses, for those would hide their own errors; points and losses are wide at first, so that what came apart by
//! drift is one point again, then narrow. The given poses stay as priors, each for itself and each relative to the one before:
//! they keep unit and axes, and hold what no picture says anything about.

use super::adjust::Effort;
use super::grow::{Attempt, Ground};
use super::{CameraGroup, MotionError, MotionParams, PairMatches, Picture};
use super::{loops, verify};
use crate::geometry::{CamFromWorld, Camera};
use crate::math::stats::median_in_place;
use crate::reconstruction::bundle::{BundleProblem, PosePrior, RelativePrior};
use crate::reconstruction::{Observer, PosedView, Stage, Watch, epipolar_distance, essential};

/// How far given poses are believed.
#[derive(Debug, Clone, PartialEq)]
pub struct RefineParams {
    /// Standard deviation of a given position, as a share of the median depth of what is seen.
    pub position_share: f64,
    /// Standard deviation of a given rotation about each axis.
    pub rotation_deg: f64,
    /// The same of the step from one picture to the next.
    pub step_share: f64,
    /// The same of the turn from one picture to the next.
    pub turn_deg: f64,
    /// Limits of the rounds, in usual ones.
    pub widths: Vec<f64>,
}

impl Default for RefineParams {
    fn default() -> Self {
        Self {
            position_share: 0.03,
            rotation_deg: 2.0,
            step_share: 0.01,
            turn_deg: 0.5,
            widths: vec![6.0, 4.0, 2.0, 1.5],
        }
    }
}

/// Given poses as the adjustment takes them.
#[derive(Debug, Clone)]
pub(super) struct GivenPoses {
    /// One for each picture.
    pub(super) cam_from_world: Vec<Option<CamFromWorld>>,
    pub(super) sigma_position: f64,
    pub(super) sigma_rad: f64,
    pub(super) sigma_step: f64,
    pub(super) sigma_turn: f64,
}

impl GivenPoses {
    /// Adds the priors of the registered pictures, which are the problem's cameras in this order.
    pub(super) fn hold(&self, registered: &[usize], problem: &mut BundleProblem) {
        let known = registered.iter().zip(0..);
        let known: Vec<(u32, CamFromWorld)> = known
            .filter_map(|(i, camera)| Some((camera, self.cam_from_world[*i]?)))
            .collect();
        let absolute = known.iter().map(|(camera, cam_from_world)| PosePrior {
            camera: *camera,
            cam_from_world: *cam_from_world,
            sigma_rad: self.sigma_rad,
            sigma_position: self.sigma_position,
        });
        problem.pose_priors.extend(absolute);
        let relative = known.windows(2).filter_map(|both| {
            let [(a, first), (b, second)] = both else {
                return None;
            };
            Some(RelativePrior {
                cameras: (*a, *b),
                cam_from_world: (*first, *second),
                sigma_rad: self.sigma_turn,
                sigma_position: self.sigma_step,
            })
        });
        problem.relative_priors.extend(relative);
    }
}

/// How well poses and pictures agree.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Agreement {
    /// Points that two pictures and more see within the usual limit.
    pub num_points: usize,
    /// Keypoints that see them.
    pub num_observations: usize,
    /// Median distance of matches, found without the poses, from their epipolar lines.
    pub epipolar_px: f64,
}

/// Adjusted poses.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// One for each picture that had one.
    pub cam_from_world: Vec<Option<CamFromWorld>>,
    /// One for each camera group.
    pub cameras: Vec<Camera>,
    /// Of the given poses.
    pub before: Agreement,
    /// Of the adjusted ones.
    pub after: Agreement,
    /// Median distance that pictures moved, in the unit of the world.
    pub moved: f64,
    /// Median angle that pictures turned.
    pub turned_rad: f64,
}

impl Refined {
    /// Whether the pictures agree clearly better with the adjusted poses: more of them see the same points, and matches that
    /// had no say in the priors lie nearer to their lines.
    pub fn is_better(&self) -> bool {
        let (before, after) = (&self.before, &self.after);
        let length = |a: &Agreement| a.num_observations as f64 / a.num_points.max(1) as f64;
        after.epipolar_px < 0.9 * before.epipolar_px
            && after.num_observations >= before.num_observations
            && length(after) >= length(before)
    }
}

/// Pairs that are looked at to see whether poses and pictures disagree.
const SAMPLE_PAIRS: usize = 200;
/// Median distance of verified matches from their epipolar lines, in pixels of a picture 640 wide, up to which poses are as good
/// as keypoints are.
const GOOD_PX: f64 = 1.1;

/// How far given poses and pictures disagree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disagreement {
    /// Median distance of matches, found without the poses, from their epipolar lines.
    pub epipolar_px: f64,
    /// What it may be where poses are as good as keypoints are.
    pub usual_px: f64,
}

impl Disagreement {
    /// Whether an adjustment is worth trying.
    pub fn is_large(&self) -> bool {
        self.epipolar_px > self.usual_px
    }
}

/// Looks at some of the pairs; `None` where too little matches to judge.
///
/// # Errors
/// [`MotionError`] when a picture names no camera group, there are too few, or the observer stopped it.
pub async fn disagreement(
    pictures: &[Picture<'_>],
    groups: &[CameraGroup],
    given: &[Option<CamFromWorld>],
    pairs: &[(usize, usize)],
    params: &MotionParams,
    observer: &mut dyn Observer,
) -> Result<Option<Disagreement>, MotionError> {
    let step = pairs.len().div_ceil(SAMPLE_PAIRS).max(1);
    let sample: Vec<(usize, usize)> = pairs.iter().copied().step_by(step).collect();
    let matches = super::match_candidates(pictures, groups, &sample, params, observer).await?;
    let refinement = Refinement::new(pictures, groups, given, &matches, params, observer).await?;
    let side = groups.iter().map(|g| g.camera.width.max(g.camera.height));
    let unit = f64::from(side.max().unwrap_or(640)) / 640.0;
    Ok(refinement.epipolar_px().map(|epipolar_px| Disagreement {
        epipolar_px,
        usual_px: GOOD_PX * unit,
    }))
}

/// Verified matches of pictures with poses, ready to say how well these fit and to bend them.
pub struct Refinement<'a> {
    pictures: &'a [Picture<'a>],
    groups: &'a [CameraGroup],
    params: &'a MotionParams,
    given: &'a [Option<CamFromWorld>],
    pairs: Vec<super::VerifiedPair>,
}

impl<'a> Refinement<'a> {
    /// Verifies the matches of pictures, one pose for each that has one. Pictures without a pose count for nothing.
    ///
    /// # Errors
    /// [`MotionError`] when a picture names no camera group, there are too few, or the observer stopped it.
    pub async fn new(
        pictures: &'a [Picture<'a>],
        groups: &'a [CameraGroup],
        given: &'a [Option<CamFromWorld>],
        matches: &[PairMatches],
        params: &'a MotionParams,
        observer: &mut dyn Observer,
    ) -> Result<Self, MotionError> {
        super::check(pictures, groups)?;
        let num_posed = given.iter().flatten().count();
        if num_posed < 3 || given.len() != pictures.len() {
            return Err(MotionError::TooFew(num_posed));
        }
        let cameras: Vec<Camera> = groups.iter().map(|g| g.camera).collect();
        let mut watch = Watch::new(observer);
        let mut pairs = verify::verify(pictures, &cameras, matches, &params.two_view, &mut watch)
            .await
            .ok_or(MotionError::Stopped)?;
        loops::reject_lonely(&mut pairs, params.candidates.is_video, &params.loops);
        Ok(Self {
            pictures,
            groups,
            params,
            given,
            pairs,
        })
    }

    /// Median distance of verified matches from the epipolar lines of the given poses; `None` without any.
    pub fn epipolar_px(&self) -> Option<f64> {
        let cameras: Vec<Camera> = self.groups.iter().map(|g| g.camera).collect();
        self.median_distance(&cameras, self.given)
    }

    fn median_distance(&self, cameras: &[Camera], poses: &[Option<CamFromWorld>]) -> Option<f64> {
        let views: Vec<Option<PosedView<'_>>> = self
            .pictures
            .iter()
            .zip(poses)
            .map(|(p, pose)| Some(PosedView::new(cameras[p.camera], (*pose)?, p.features)))
            .collect();
        let mut distances = Vec::new();
        for pair in &self.pairs {
            let (Some(a), Some(b)) = (&views[pair.a as usize], &views[pair.b as usize]) else {
                continue;
            };
            let e = essential(&a.cam_from_world, &b.cam_from_world);
            let focal = a.focal_px.min(b.focal_px);
            for (k, l, _) in &pair.matches {
                let (p, q) = (a.planar[*k as usize], b.planar[*l as usize]);
                let distance = focal * epipolar_distance(&e, &p.push(1.0), &q.push(1.0));
                if distance.is_finite() {
                    distances.push(distance);
                }
            }
        }
        median_in_place(&mut distances)
    }

    /// Bends the given poses until the pictures agree.
    ///
    /// # Errors
    /// [`MotionError::Stopped`] when the observer stopped it, [`MotionError::NoStart`] when no two pictures with poses share
    /// a point.
    pub async fn adjust(
        &self,
        believed: &RefineParams,
        observer: &mut dyn Observer,
    ) -> Result<Refined, MotionError> {
        let mut watch = Watch::new(observer);
        let mut ground = Ground::new(self.pictures, self.groups, &self.pairs, self.params);
        let mut attempt = ground.posed_attempt(self.given);
        ground.triangulate(&mut attempt, 1.0);
        let before = self.agreement(&attempt);
        let widest = believed.widths.first().copied().unwrap_or(1.0);
        ground.triangulate(&mut attempt, widest);
        let Some(depth) = ground.median_depth(&attempt) else {
            return Err(MotionError::NoStart {
                pictures: self.pictures.len(),
                verified: self.pairs.len(),
                turned: 0,
                advice: "check that the poses belong to these pictures",
            });
        };
        ground.given = Some(GivenPoses {
            cam_from_world: self.given.to_vec(),
            sigma_position: believed.position_share * depth,
            sigma_rad: believed.rotation_deg.to_radians(),
            sigma_step: believed.step_share * depth,
            sigma_turn: believed.turn_deg.to_radians(),
        });
        let total = believed.widths.len() + 2;
        for (round, width) in believed.widths.iter().enumerate() {
            watch
                .tell(Stage::Adjust, round, total)
                .await
                .ok_or(MotionError::Stopped)?;
            ground.triangulate(&mut attempt, *width);
            ground.adjust(&mut attempt, &Effort::wide(*width));
        }
        for round in believed.widths.len()..total {
            watch
                .tell(Stage::Adjust, round, total)
                .await
                .ok_or(MotionError::Stopped)?;
            ground.triangulate(&mut attempt, 1.0);
            ground.adjust(&mut attempt, &Effort::thorough());
        }
        ground.triangulate(&mut attempt, 1.0);
        let both = self
            .given
            .iter()
            .flatten()
            .zip(attempt.poses.iter().flatten());
        let (mut moved, mut turned): (Vec<f64>, Vec<f64>) = both
            .map(|(a, b)| {
                let shift = (a.center_in_world() - b.center_in_world()).norm();
                (shift, a.rotation_angle_to(b))
            })
            .unzip();
        Ok(Refined {
            before,
            after: self.agreement(&attempt),
            moved: median_in_place(&mut moved).unwrap_or(0.0),
            turned_rad: median_in_place(&mut turned).unwrap_or(0.0),
            cam_from_world: attempt.poses,
            cameras: attempt.cameras,
        })
    }

    fn agreement(&self, attempt: &Attempt) -> Agreement {
        Agreement {
            num_points: attempt.num_points(),
            num_observations: attempt.num_observations(),
            epipolar_px: self
                .median_distance(&attempt.cameras, &attempt.poses)
                .unwrap_or(f64::INFINITY),
        }
    }
}
