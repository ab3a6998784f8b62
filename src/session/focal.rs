//! Remembers the focal length of cameras whose intrinsics nobody told.
//!
//! Each located frame with a free focal length is one measurement of ln f with a standard deviation. They are combined by
//! the median, because a wrong position gives a wildly wrong focal length, and an average would carry it along for ever.

use crate::math::stats::median_in_place;
use crate::relocalizer::FocalBelief;
use std::collections::{BTreeMap, VecDeque};

/// Measurements kept per camera.
const CAPACITY: usize = 64;
/// Fewer measurements are not worth remembering.
const MIN_COUNT: usize = 5;
/// A single frame with a relative deviation above this says too little.
const MAX_SIGMA_LN: f64 = 0.10;
/// A value from an earlier session is believed no better than this: a good start that a few frames can correct.
const RECALLED_SIGMA_LN: f64 = 0.02;
/// Focal length divided by width, from a view of 150 degrees to one of 3.
const PLAUSIBLE: core::ops::RangeInclusive<f64> = 0.13..=20.0;
/// Cameras that are remembered; the least recently named is dropped.
const MAX_CAMERAS: usize = 16;

/// Beliefs by the name of the camera.
#[derive(Debug, Clone, Default)]
pub struct FocalMemory {
    cameras: BTreeMap<String, Known>,
    uses: u64,
}

/// What is kept of one camera.
#[derive(Debug, Clone, Default)]
struct Known {
    /// ln f of the last frames.
    measured: VecDeque<f64>,
    /// Focal length divided by the width, from an earlier session.
    recalled: Option<f64>,
    /// When it was named last.
    used: u64,
}

impl FocalMemory {
    /// Forgets all cameras.
    pub fn clear(&mut self) {
        self.cameras.clear();
    }

    /// What is known about a camera; `None` for an empty name, or for too few measurements and nothing from before.
    pub fn belief(&self, camera: &str) -> Option<FocalBelief> {
        let known = self.cameras.get(camera)?;
        let measured = &known.measured;
        if measured.len() < MIN_COUNT {
            return known.recalled.map(|focal_per_width| FocalBelief {
                focal_per_width,
                sigma_ln: RECALLED_SIGMA_LN,
            });
        }
        let mut room = [0.0; CAPACITY];
        let values = room.get_mut(..measured.len())?;
        values.iter_mut().zip(measured).for_each(|(v, m)| *v = *m);
        let middle = median_in_place(values)?;
        values.iter_mut().for_each(|v| *v = (*v - middle).abs());
        // 1.4826 turns the median deviation into a standard deviation, 1.2533 is the median's loss against the mean.
        let spread = 1.4826 * median_in_place(values)?;
        let n = measured.len() as f64;
        let sigma_ln = (1.2533 * spread / libm::sqrt(n)).max(1e-3);
        Some(FocalBelief {
            focal_per_width: libm::exp(middle),
            sigma_ln,
        })
    }

    /// Adds the focal length that a located frame gave.
    pub fn learn(&mut self, camera: &str, focal_per_width: f64, sigma_ln: f64) {
        let usable =
            focal_per_width > 0.0 && focal_per_width.is_finite() && sigma_ln <= MAX_SIGMA_LN;
        if camera.is_empty() || !usable {
            return;
        }
        let measured = &mut self.named(camera).measured;
        if measured.len() == CAPACITY {
            measured.pop_front();
        }
        measured.push_back(libm::log(focal_per_width));
    }

    /// Takes over what an earlier session believed; measurements of this one outvote it. False when the value is none.
    pub fn recall(&mut self, camera: &str, focal_per_width: f64) -> bool {
        let usable = !camera.is_empty() && PLAUSIBLE.contains(&focal_per_width);
        if usable {
            self.named(camera).recalled = Some(focal_per_width);
        }
        usable
    }

    /// The entry of a camera, in place of the one that was not named for longest when there are too many.
    fn named(&mut self, camera: &str) -> &mut Known {
        if !self.cameras.contains_key(camera) && self.cameras.len() >= MAX_CAMERAS {
            let oldest = self.cameras.iter().min_by_key(|(_, known)| known.used);
            if let Some(name) = oldest.map(|(name, _)| name.clone()) {
                self.cameras.remove(&name);
            }
        }
        self.uses += 1;
        let known = self.cameras.entry(camera.to_owned()).or_default();
        known.used = self.uses;
        known
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn learns_in_spite_of_wrong_frames() {
        let mut memory = FocalMemory::default();
        for i in 0..20 {
            let f = if i % 5 == 0 {
                2.5
            } else {
                0.9 + 0.002 * f64::from(i % 3)
            };
            memory.learn("back", f, 0.02);
        }
        let belief = memory.belief("back");
        assert!(belief.is_some_and(|b| (b.focal_per_width - 0.902).abs() < 0.004 && b.is_frozen()));
    }

    #[test]
    fn says_nothing_after_few_or_vague_frames() {
        let mut memory = FocalMemory::default();
        for _ in 0..4 {
            memory.learn("a", 0.9, 0.02);
            memory.learn("", 0.9, 0.02);
            memory.learn("b", 0.9, 0.5);
            memory.learn("b", f64::NAN, 0.01);
        }
        assert_eq!(memory.belief("a"), None);
        assert_eq!(memory.belief(""), None);
        assert_eq!(memory.belief("b"), None);
    }

    #[test]
    fn recalls_until_this_session_knows_better() {
        let mut memory = FocalMemory::default();
        assert!(memory.recall("back", 0.8));
        let recalled = memory.belief("back");
        assert!(recalled.is_some_and(|b| b.focal_per_width == 0.8 && !b.is_frozen()));
        for _ in 0..MIN_COUNT {
            memory.learn("back", 0.9, 0.01);
        }
        let learned = memory.belief("back");
        assert!(learned.is_some_and(|b| (b.focal_per_width - 0.9).abs() < 1e-12));
        assert!(
            !memory.recall("", 0.8) && !memory.recall("a", f64::NAN) && !memory.recall("a", 0.0)
        );
        assert_eq!(memory.belief("a"), None);
    }

    #[test]
    fn keeps_a_bounded_number_of_cameras() {
        let mut memory = FocalMemory::default();
        for i in 0..40 {
            for _ in 0..6 {
                memory.learn(&format!("camera {i}"), 1.0, 0.01);
            }
        }
        assert_eq!(memory.cameras.len(), MAX_CAMERAS);
        assert!(memory.belief("camera 39").is_some());
        assert!(memory.belief("camera 0").is_none());
    }
}
