//! Where the camera's way jumps.

use crate::geometry::CamFromWorld;
use crate::math::stats::{median_in_place, quantile_in_place};

/// A step is judged by so many before and behind it.
const AROUND: usize = 5;
/// So many times as large as those around it a step is a jump. Where the zoom changed in two films it was 5.7 and 7.5 times, at a
/// film's cut 32; in seven other films no step was more than 2.4 times.
const MIN_TIMES: f64 = 4.5;
/// Steps of a film are alike: four of five are at most so many times the median. Photographs that were taken here and there are none.
const REGULAR: f64 = 3.0;

/// Two pictures of a film between which the camera's way is far longer than around them: a cut, or another zoom, which looks like
/// another distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jump {
    /// The last picture before it.
    pub before: usize,
    /// The first one behind it.
    pub after: usize,
    /// Its length by the median of the steps around it.
    pub times: f64,
}

impl Jump {
    /// The largest jump of a film, if there is one. A picture without a pose makes two steps of one.
    pub(super) fn largest(cam_from_world: &[Option<CamFromWorld>]) -> Option<Self> {
        let placed = cam_from_world.iter().enumerate();
        let placed: Vec<_> = placed
            .filter_map(|(i, pose)| Some((i, pose.as_ref()?.center_in_world())))
            .collect();
        let steps: Vec<f64> = placed
            .windows(2)
            .map(|pair| (pair[1].1 - pair[0].1).norm() / (pair[1].0 - pair[0].0) as f64)
            .collect();
        let mut all = steps.clone();
        let (usual, long) = (
            median_in_place(&mut all)?,
            quantile_in_place(&mut all, 0.8)?,
        );
        if !(long <= REGULAR * usual) {
            return None;
        }
        // At either end there is nothing to judge by.
        let judged = AROUND..steps.len().saturating_sub(AROUND);
        let times = judged.filter_map(|i| {
            let mut near = [&steps[i - AROUND..i], &steps[i + 1..=i + AROUND]].concat();
            Some((i, steps[i] / median_in_place(&mut near)?))
        });
        let (i, times) = times.max_by(|a, b| a.1.total_cmp(&b.1))?;
        (times.is_finite() && times > MIN_TIMES).then(|| Self {
            before: placed[i].0,
            after: placed[i + 1].0,
            times,
        })
    }

    /// What it means and what helps, for people, with the names of the two pictures.
    pub fn message(&self, before: &str, after: &str) -> String {
        format!(
            "The camera jumps between {before} and {after}, by {:.0} times its steps around there. If the zoom or the lens changed \
             there, what was filmed before and after does not fit: make a map of either alone. If the film was cut there, all is well.",
            self.times
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    /// Cameras on a line, a step for each picture; those of no length have no pose.
    fn way(steps: &[f64]) -> Vec<Option<CamFromWorld>> {
        let mut at = 0.0;
        let pose = |step: &f64| {
            at += step;
            (*step > 0.0)
                .then(|| CamFromWorld::new(Matrix3::identity(), Vector3::new(-at, 0.0, 0.0)))
        };
        steps.iter().map(pose).collect()
    }

    #[test]
    fn a_step_far_longer_than_those_around_it_is_named() {
        let mut steps: Vec<f64> = (0..30).map(|i| 1.0 + 0.5 * f64::from(i % 3)).collect();
        assert_eq!(Jump::largest(&way(&steps)), None);
        // Faster for a while, and once for a single picture.
        for step in &mut steps[20..26] {
            *step = 4.0;
        }
        steps[12] = 9.0;
        let jump = Jump::largest(&way(&steps)).expect("nine times as long");
        assert_eq!((jump.before, jump.after), (11, 12));
        assert!((jump.times - 6.0).abs() < 1e-9, "{jump:?}");
        let words = jump.message("a.jpg", "b.jpg");
        assert!(
            words.contains("between a.jpg and b.jpg, by 6 times"),
            "{words}"
        );
        // As long as it is, four pictures without a pose explain it.
        steps[12] = 1.0;
        steps[8..12].fill(0.0);
        let mut gap = way(&steps);
        for pose in gap.iter_mut().skip(12).flatten() {
            pose.translation.x -= 6.0;
        }
        assert_eq!(Jump::largest(&gap), None);
    }

    #[test]
    fn photographs_taken_here_and_there_have_no_jumps() {
        let steps: Vec<f64> = (0..40).map(|i| [0.2, 0.2, 0.2, 5.0][i % 4]).collect();
        assert_eq!(Jump::largest(&way(&steps)), None);
        assert_eq!(Jump::largest(&way(&[1.0, 1.0, 30.0, 1.0])), None, "too few");
        assert_eq!(Jump::largest(&[]), None);
    }
}
