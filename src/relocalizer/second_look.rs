//! The second look as one step of a frame: from which poses, and what becomes of the first answer.

use super::Relocalizer;
use super::error::LocateError;
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera};
use crate::landmarks::{FoundAgain, LandmarkTable, Landmarks, LookOptions, SecondLook};
use crate::pose::{PoseError, PoseOptions, PoseOutcome, PoseScratch, PoseStatus};

/// Fewer landmarks found again do not carry an answer.
const MIN_FOUND: u32 = 20;
/// Nor does a smaller share of those that should be seen.
const MIN_SHARE: f64 = 0.05;
/// A pose that finds so many, and this share, has no rival.
const CLEAR_FOUND: u32 = 60;
const CLEAR_SHARE: f64 = 0.12;

/// What a scene with landmarks brings to each frame.
#[derive(Debug)]
pub(super) struct Again {
    landmarks: Landmarks,
    look: SecondLook,
    scratch: PoseScratch,
}

/// An answer of the second look.
type Answer = (PoseOutcome, FoundAgain);

/// The best answer so far with what it started from, and whether no other look came after it.
#[derive(Debug, Default)]
struct Best {
    answer: Option<(Answer, (Camera, CamFromWorld))>,
    is_last: bool,
}

impl Again {
    pub(super) fn new(table: &LandmarkTable) -> Self {
        Self {
            landmarks: Landmarks::new(table),
            look: SecondLook::default(),
            scratch: PoseScratch::default(),
        }
    }

    /// The best answer from the poses of the first one.
    fn best(
        &mut self,
        features: &FeatureSet,
        camera: &Camera,
        first: &PoseOutcome,
        take: LookOptions,
        options: &PoseOptions,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Answer>, PoseError> {
        let size = (camera.width, camera.height);
        if !self.look.load(&self.landmarks, features, size) {
            return Ok(None);
        }
        let mut best = Best::default();
        self.look_from(first, features, take, options, &mut best, clock)?;
        if take.points && !best.answer.is_some_and(|(a, _)| is_convincing(&a)) {
            let recalled = self.look.recall(
                &self.landmarks,
                features,
                camera,
                options,
                &mut self.scratch,
                clock,
            )?;
            self.look_from(&recalled, features, take, options, &mut best, clock)?;
        }
        match best.answer {
            Some((_, start)) if !best.is_last => {
                self.look_once(&start, features, take, options, clock)
            }
            other => Ok(other.map(|(answer, _)| answer)),
        }
    }

    /// Looks from the pose of an answer and from its rival; the best of all looks so far is kept.
    fn look_from(
        &mut self,
        from: &PoseOutcome,
        features: &FeatureSet,
        take: LookOptions,
        options: &PoseOptions,
        best: &mut Best,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<(), PoseError> {
        let Some(estimate) = &from.estimate else {
            return Ok(());
        };
        let rival = estimate.runner_up.map(|r| r.cam_from_world);
        for cam_from_world in [Some(estimate.cam_from_world), rival].into_iter().flatten() {
            if best.answer.is_some_and(|((_, found), _)| is_clear(&found)) {
                break;
            }
            let start = (estimate.camera, cam_from_world);
            let answer = self.look_once(&start, features, take, options, clock)?;
            best.is_last = false;
            if let Some(answer) = answer
                && best
                    .answer
                    .is_none_or(|(b, _)| weight(&answer.1) > weight(&b.1))
            {
                best.answer = Some((answer, start));
                best.is_last = true;
            }
        }
        Ok(())
    }

    fn look_once(
        &mut self,
        (camera, cam_from_world): &(Camera, CamFromWorld),
        features: &FeatureSet,
        take: LookOptions,
        options: &PoseOptions,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Answer>, PoseError> {
        self.look.look(
            &self.landmarks,
            features,
            camera,
            cam_from_world,
            take,
            options,
            &mut self.scratch,
            clock,
        )
    }
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
        let Some(again) = self.again.as_mut().filter(|_| self.options.live.look_again) else {
            return Ok((first, None));
        };
        let take = LookOptions {
            points: self.options.live.max_points > 0,
            lines: self.options.live.max_lines > 0,
        };
        let features = self.front_end.features();
        let Some(answer) = again.best(features, camera, &first, take, options, clock)? else {
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
}

/// Takes over a list without giving up the memory.
fn replace<T: Copy>(list: &mut Vec<T>, with: &[T]) {
    list.clear();
    list.extend_from_slice(with);
}
