//! The second look as one step of a frame: from which poses, and what becomes of the first answer.

use super::Relocalizer;
use super::error::LocateError;
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera};
use crate::landmarks::{
    FoundAgain, LandmarkTable, Landmarks, LookOptions, SecondLook, SolvedCamera,
};
use crate::math::elementary::ln;
use crate::math::stats::median_in_place;
use crate::pose::{
    Degeneracy, Focal, PointCorrespondence, PoseError, PoseEstimate, PoseOptions, PoseOutcome,
    PoseScratch, PoseStatus,
};

/// Fewer landmarks found again do not carry an answer.
const MIN_FOUND: u32 = 20;
/// Nor does a smaller share of those that should be seen.
const MIN_SHARE: f64 = 0.05;
/// A pose that finds so many, and this share, has no rival.
const CLEAR_FOUND: u32 = 60;
const CLEAR_SHARE: f64 = 0.12;

/// Another camera than the given one is believed where so many times as much is found with it,
const OTHER_CAMERA_GAIN: f64 = 1.1;
/// and, where the given one was said to be known, more by so many times what chance adds to a count,
const KNOWN_CAMERA_SPREADS: f64 = 2.0;
/// and the evidence is so many times as strong. (Maps are never quite straight: cameras that were right gained up to 13 per cent of
/// what was found, and 6 of the evidence.)
const KNOWN_CAMERA_EVIDENCE: f64 = 1.07;
/// A solved camera whose pixels are less square than by so much, or whose focal length is less sure, explains how the map is bent,
/// and stood up to 1.8 m off in a rendered room.
const KNOWN_CAMERA_ASPECT: f64 = 0.03;
/// A bent map brings a tenth or two more. With so much more found the given camera is wrong, and the picture may be stretched: wide
/// ones that were drawn into a frame of the scene's shape lay 33 to 65 cm off in three rooms, in the median and surely.
const OTHER_CAMERA_CERTAIN_GAIN: f64 = 1.5;
/// By no more than 16 : 9 and 4 : 3 differ, though.
const STRETCHED_ASPECT: f64 = 0.36;
const KNOWN_CAMERA_SIGMA: f64 = 0.01;
/// Matches around wrong projections draw towards them: so many looks lead to the right camera.
const OTHER_CAMERA_LOOKS: usize = 8;
/// From so large a change of ln f on it is worth trying twice of it.
const LEAST_LEAP: f64 = 0.02;
/// Spread of ln f around a solved focal length while looking with it.
const SOLVED_FOCAL_SIGMA_LN: f64 = 0.1;

/// What a scene with landmarks brings to each frame.
#[derive(Debug)]
pub(super) struct Again {
    landmarks: Landmarks,
    scene_camera: Option<Camera>,
    look: SecondLook,
    scratch: PoseScratch,
    depths: Vec<f64>,
}

/// An answer of the second look.
type Answer = (PoseOutcome, FoundAgain);

/// Where a look starts.
#[derive(Debug, Clone, Copy)]
struct From {
    camera: Camera,
    cam_from_world: CamFromWorld,
    focal: Focal,
}

/// The best answer so far with what it started from, and whether no other look came after it.
#[derive(Debug, Default)]
struct Best {
    answer: Option<(Answer, From)>,
    is_last: bool,
}

impl Best {
    /// Takes over the answer of the last look if more was found.
    fn offer(&mut self, answer: Option<Answer>, from: &From) {
        let least = self.answer.map_or(0, |((_, found), _)| weight(&found));
        let better = answer.filter(|(_, found)| weight(found) > least);
        self.is_last = better.is_some();
        if let Some(better) = better {
            self.answer = Some((better, *from));
        }
    }
}

/// A frame, and how it is looked at.
#[derive(Debug, Clone, Copy)]
struct Frame<'a> {
    features: &'a FeatureSet,
    take: LookOptions,
    options: &'a PoseOptions,
}

impl Again {
    /// Bytes held by the landmarks.
    pub(super) fn num_bytes(&self) -> usize {
        self.landmarks.num_bytes()
    }

    /// `scene_camera` is that of the pictures that taught the scene.
    pub(super) fn new(table: &LandmarkTable, scene_camera: Option<Camera>) -> Self {
        Self {
            landmarks: Landmarks::new(table),
            scene_camera,
            look: SecondLook::default(),
            scratch: PoseScratch::default(),
            depths: Vec::new(),
        }
    }

    /// The best answer from the poses of the first one.
    fn best(
        &mut self,
        frame: &Frame<'_>,
        camera: &Camera,
        first: &PoseOutcome,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Answer>, PoseError> {
        let size = (camera.width, camera.height);
        if !self.look.load(&self.landmarks, frame.features, size) {
            return Ok(None);
        }
        let mut best = Best::default();
        let mut is_mirrored = first.degeneracy == Some(Degeneracy::Mirrored);
        self.look_from(first, frame, &mut best, clock)?;
        if frame.take.points && !best.answer.is_some_and(|(a, _)| is_convincing(&a)) {
            let recalled = self.look.recall(
                &self.landmarks,
                frame.features,
                camera,
                frame.options,
                &mut self.scratch,
                clock,
            )?;
            is_mirrored |= recalled.degeneracy == Some(Degeneracy::Mirrored);
            self.look_from(&recalled, frame, &mut best, clock)?;
        }
        // The search saw more in a mirrored world: what is symmetric is found again all the same, and only a clear view counts.
        if is_mirrored && !best.answer.is_some_and(|((_, found), _)| is_clear(&found)) {
            return Ok(None);
        }
        self.look_with_stretched_camera(frame, camera, &mut best, clock)?;
        self.look_with_other_cameras(frame, &mut best, clock)?;
        match best.answer {
            Some((_, from)) if !best.is_last => self.look_once(&from, frame, clock),
            other => Ok(other.map(|(answer, _)| answer)),
        }
    }

    /// Looks from the pose of an answer and from its rival; the best of all looks so far is kept.
    fn look_from(
        &mut self,
        outcome: &PoseOutcome,
        frame: &Frame<'_>,
        best: &mut Best,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<(), PoseError> {
        let Some(estimate) = &outcome.estimate else {
            return Ok(());
        };
        let rival = estimate.runner_up.map(|r| r.cam_from_world);
        for cam_from_world in [Some(estimate.cam_from_world), rival].into_iter().flatten() {
            if best.answer.is_some_and(|((_, found), _)| is_clear(&found)) {
                break;
            }
            let from = From {
                camera: estimate.camera,
                cam_from_world,
                focal: frame.options.focal,
            };
            let answer = self.look_once(&from, frame, clock)?;
            best.offer(answer, &from);
        }
        Ok(())
    }

    /// A picture of another shape than the scene's, with intrinsics that nobody knows, may be the scene's camera, stretched: a video
    /// that was drawn into a frame of another shape. The first pose is no start for that, the search is made anew.
    fn look_with_stretched_camera(
        &mut self,
        frame: &Frame<'_>,
        picture: &Camera,
        best: &mut Best,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<(), PoseError> {
        let (width, height) = (picture.width, picture.height);
        let Some(scene) = self.scene_camera.filter(|scene| {
            frame.options.focal == Focal::Unknown
                && frame.take.points
                && scene.for_size(width, height).is_none()
        }) else {
            return Ok(());
        };
        let stretched = scene.stretched_to(width, height);
        let options = PoseOptions {
            focal: Focal::Known,
            ..*frame.options
        };
        let recalled = self.look.recall(
            &self.landmarks,
            frame.features,
            &stretched,
            &options,
            &mut self.scratch,
            clock,
        )?;
        let Some(estimate) = &recalled.estimate else {
            return Ok(());
        };
        let from = From {
            camera: stretched,
            cam_from_world: estimate.cam_from_world,
            focal: Focal::Known,
        };
        let answer = self.look_once(&from, frame, clock)?;
        best.offer(answer, &from);
        Ok(())
    }

    /// Whether the camera fits what was found. Where it does not, looks with the one that does: a picture that was zoomed, cropped
    /// or squeezed looks like one from elsewhere.
    fn look_with_other_cameras(
        &mut self,
        frame: &Frame<'_>,
        best: &mut Best,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<(), PoseError> {
        let Some(((outcome, given), from)) = best.answer else {
            return Ok(());
        };
        if !best.is_last {
            self.look_once(&from, frame, clock)?;
            best.is_last = true;
        }
        let mut seen = outcome.estimate;
        let mut other = Best::default();
        let mut has_leapt = false;
        for turn in 0..OTHER_CAMERA_LOOKS {
            let Some(now) = seen else { break };
            let mut next = self.other_camera(&now, frame, turn > 0);
            if next.is_none() && turn > 0 && !has_leapt {
                has_leapt = true;
                next = self.leap(&from.camera, &now);
            }
            let Some(solved) = next else { break };
            let from = From {
                camera: solved.camera,
                cam_from_world: solved.cam_from_world,
                focal: Focal::Refine {
                    sigma_ln: SOLVED_FOCAL_SIGMA_LN,
                },
            };
            let answer = self.look_once(&from, frame, clock)?;
            best.is_last = false;
            seen = answer.and_then(|(outcome, _)| outcome.estimate);
            other.offer(answer, &from);
        }
        let is_known = frame.options.focal == Focal::Known;
        if other
            .answer
            .is_some_and(|(other, _)| is_believed(&other, &(outcome, given), is_known))
        {
            *best = other;
        }
        Ok(())
    }

    /// Twice as far from the given focal length as a solved one, at the distance from which the points look as large: matches drawn
    /// towards a wrong projection leave the solver on the way.
    fn leap(&mut self, given: &Camera, solved: &PoseEstimate) -> Option<SolvedCamera> {
        let factor = solved.camera.focal_px().0 / given.focal_px().0;
        if ln(factor).abs() < LEAST_LEAP {
            return None;
        }
        let mut pose = solved.cam_from_world;
        let depth = |p: &PointCorrespondence| pose.transform_point(&p.point_in_world).z;
        self.depths.clear();
        self.depths.extend(self.look.points().iter().map(depth));
        pose.translation.z += (factor - 1.0) * median_in_place(&mut self.depths)?;
        Some(SolvedCamera {
            camera: solved.camera.with_focal_scaled(factor),
            cam_from_world: pose,
        })
    }

    /// A camera that fits what was found by the last look better than that of its answer.
    fn other_camera(
        &mut self,
        answer: &PoseEstimate,
        frame: &Frame<'_>,
        is_doubted: bool,
    ) -> Option<SolvedCamera> {
        let (camera, pose) = (&answer.camera, &answer.cam_from_world);
        let narrow = self.look.other_camera(camera, pose, is_doubted);
        narrow.or_else(|| {
            let (landmarks, features) = (&self.landmarks, frame.features);
            let look = &mut self.look;
            (!is_doubted && frame.take.points)
                .then(|| look.other_camera_in_wide_windows(landmarks, features, camera, pose))?
        })
    }

    fn look_once(
        &mut self,
        from: &From,
        frame: &Frame<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Answer>, PoseError> {
        let options = PoseOptions {
            focal: from.focal,
            ..*frame.options
        };
        self.look.look(
            &self.landmarks,
            frame.features,
            &from.camera,
            &from.cam_from_world,
            frame.take,
            &options,
            &mut self.scratch,
            clock,
        )
    }
}

/// Whether an answer with another camera is better than that of the given one beyond what chance and an uneven map bring.
fn is_believed((other, more): &Answer, (given, found): &Answer, is_known: bool) -> bool {
    let (more, found) = (f64::from(weight(more)), f64::from(weight(found)));
    if !(more > OTHER_CAMERA_GAIN * found) {
        return false;
    }
    let (true, Some(other), Some(given)) = (is_known, &other.estimate, &given.estimate) else {
        return true;
    };
    let focal = |e: &PoseEstimate| e.camera.focal_px();
    let (was, is) = (focal(given), focal(other));
    let aspect = (is.1 * was.0) / (is.0 * was.1);
    let is_certain = more > OTHER_CAMERA_CERTAIN_GAIN * found;
    let least_square = if is_certain {
        STRETCHED_ASPECT
    } else {
        KNOWN_CAMERA_ASPECT
    };
    more - found > KNOWN_CAMERA_SPREADS * found.sqrt()
        && other.log_evidence > KNOWN_CAMERA_EVIDENCE * given.log_evidence
        && (aspect - 1.0).abs() < least_square
        && other.sigma_focal_px < KNOWN_CAMERA_SIGMA * is.0
}

fn weight(found: &FoundAgain) -> u32 {
    found.found_points + found.found_lines
}

fn is_clear(found: &FoundAgain) -> bool {
    weight(found) >= CLEAR_FOUND && found.share() >= CLEAR_SHARE
}

fn is_convincing((outcome, found): &Answer) -> bool {
    outcome.status == PoseStatus::Ok && weight(found) >= MIN_FOUND && found.share() >= MIN_SHARE
}

impl Relocalizer {
    /// Looks again from the first answer, if the scene has landmarks: a better pose from what is found, the correspondences of
    /// the frame being those then, or the first answer as it was. With the share that was found, where something was.
    pub(super) fn look_again(
        &mut self,
        first: PoseOutcome,
        camera: &Camera,
        options: &PoseOptions,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<(PoseOutcome, Option<FoundAgain>), LocateError> {
        let is_wanted = self.options.live.look_again;
        let Some(again) = self.scene.again_mut().filter(|_| is_wanted) else {
            return Ok((first, None));
        };
        let take = LookOptions {
            points: self.options.live.max_points > 0,
            lines: self.options.live.max_lines > 0,
        };
        let frame = Frame {
            features: self.front_end.features(),
            take,
            options,
        };
        let Some(answer) = again.best(&frame, camera, &first, clock)? else {
            let nothing = first.estimate.map(|_| FoundAgain::default());
            return Ok((first, nothing));
        };
        let (mut outcome, found) = answer;
        if !is_convincing(&answer) {
            return Ok((first, Some(found)));
        }
        outcome.stats = first.stats;
        core::mem::swap(&mut self.pose, &mut again.scratch);
        replace(&mut self.points, again.look.points());
        replace(&mut self.lines, again.look.lines());
        Ok((outcome, Some(found)))
    }

    /// How well the points of the frame's answer tell the focal length, as a standard deviation of its logarithm.
    pub(super) fn told_focal(&mut self, answer: &PoseEstimate) -> Option<f64> {
        let again = self.scene.again_mut()?;
        let look = &mut again.look;
        look.focal_sigma_ln(&self.points, &answer.camera, &answer.cam_from_world)
    }
}

/// Takes over a list without giving up the memory.
fn replace<T: Copy>(list: &mut Vec<T>, with: &[T]) {
    list.clear();
    list.extend_from_slice(with);
}
