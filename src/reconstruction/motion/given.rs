//! Whether pictures contradict a focal length that was given.
//!
//! Essential matrices do not notice a wrong one: the model bends until it fits nearly as well, and is wrong without a word. So
//! what was adjusted with the given focal length is adjusted once more with a free one.

use super::adjust::Effort;
use super::grow::{Attempt, Ground};
use super::{CameraGroup, MotionError};

/// Pictures that are asked at least.
const ASKED_FROM: usize = 12;
/// A difference of so many per cent is none: radial terms that a camera without distortion leaves out make one or two.
const MAX_DIFFERENCE: f64 = 0.08;
/// The errors have to fall by this share: before a flat wall any focal length does.
const MIN_GAIN: f64 = 0.02;
/// How free the focal length is, as a standard deviation of ln f.
const FREE_SIGMA_LN: f64 = 0.3;

/// The first camera group whose given focal length the model contradicts.
pub(super) fn contradicted(ground: &Ground<'_>, attempt: &Attempt) -> Option<MotionError> {
    for (g, group) in ground.groups.iter().enumerate() {
        let own = (ground.pictures.iter().zip(&attempt.poses))
            .filter(|(picture, pose)| picture.camera == g && pose.is_some());
        if !group.has_focal || group.refines || own.count() < ASKED_FROM {
            continue;
        }
        let mut groups: Vec<CameraGroup> = ground.groups.to_vec();
        groups[g].refines = true;
        groups[g].sigma_ln = FREE_SIGMA_LN;
        let mut free = attempt.clone();
        let Some(summary) = ground.adjust_with(&groups, &mut free, &Effort::thorough()) else {
            continue;
        };
        let given_px = group.prior_focal_px();
        let seen_px = free.cameras[g].focal_px().0;
        let is_other = (seen_px / given_px - 1.0).abs() > MAX_DIFFERENCE;
        if is_other && summary.final_cost < (1.0 - MIN_GAIN) * summary.initial_cost {
            return Some(MotionError::Focal {
                group: g,
                given_px,
                seen_px,
            });
        }
    }
    None
}
