//! Whether the world is mirrored: whether more would agree if it were seen from the other side.
//!
//! A left-handed map, or one with a swapped sign, leaves every true point behind the camera. A flat or thin part of such a map
//! fits a proper pose all the same (on a plane a reflection is a rotation), with many more inliers than chance gives. So where
//! few agree of what the network is confident of, the search is repeated on the reflected world.

use super::options::PoseOptions;
use super::problem::Problem;
use super::ransac::Search;
use super::soft::Soft;
use super::watch::Watch;

/// With more than this share of the inliers that the confidences promise, a pose needs no second look.
const THIN_SHARE: f64 = 0.3;

/// Samples of the second search: its inliers, if there are any, outnumber the first one's, and they are many of few wrong ones.
const MAX_SAMPLES: u32 = 96;

/// The reflected world must explain so many times more.
const MIN_GAIN: f32 = 2.5;

/// Buffers of the second search.
#[derive(Debug, Default)]
pub(super) struct Mirror {
    problem: Problem,
    search: Search,
}

impl Mirror {
    /// Whether the reflected world explains clearly more than `ranking`; only asked where there are few inliers.
    pub(super) fn explains_more(
        &mut self,
        problem: &Problem,
        options: &PoseOptions,
        soft: &Soft,
        (num_inliers, ranking): (usize, f32),
        watch: &mut Watch<'_>,
    ) -> bool {
        let points = problem.points.iter().map(|p| p.belief.prior);
        let lines = problem.lines.iter().map(|l| l.belief.prior);
        let expected: f64 = points.chain(lines).sum();
        if num_inliers as f64 >= THIN_SHARE * expected {
            return false;
        }
        self.problem.reflect(problem);
        let options = PoseOptions {
            max_iterations: MAX_SAMPLES.min(options.max_iterations),
            prior: None,
            gravity: None,
            ..*options
        };
        let soft = Soft {
            prior: None,
            gravity: None,
            ..*soft
        };
        self.search.run(&self.problem, &options, &soft, watch);
        self.search
            .kept
            .first()
            .is_some_and(|best| best.ranking.total > MIN_GAIN * ranking)
    }
}
