//! Which answers of the solver are believed.

use super::result::{Counts, NotLocated};
use crate::landmarks::FoundAgain;
use crate::pose::{Degeneracy, PoseEstimate, PoseOutcome};

/// Fewer features than this are not worth a look.
const MIN_FEATURES: usize = 8;
/// Fewer things that agree are not believed, whatever the evidence says: repeated predictions (a network that was taught
/// another place) are not independent of each other, and the solver's evidence takes them to be.
const MIN_INLIERS: u32 = 12;
/// And no fewer than one in so many of what the solver was given: the scene of another room finds chance poses with up to
/// 30 of 900, while in its own room a third of them agree.
const MIN_INLIER_SHARE: u32 = 12;

/// Where even the best pose finds a smaller share of the landmarks that it should show, it is another place, or a part that was not
/// taught.
const OTHER_PLACE_SHARE: f64 = 0.05;

/// Of the matches of the last look so many agree where camera and picture are right (three rooms: 0.7 to 0.92 between the tenths at
/// either end). Where a squeezed picture, or a principal point far off, was taken for a part they were 0.55 to 0.7, and 0.58 to 0.72
/// in mirrored pictures.
const FITTING_SHARE: f64 = 0.75;

/// Whether so much agrees that nothing need be doubted.
pub(super) fn is_fitting(counts: &Counts) -> bool {
    counts.agreeing_share() >= FITTING_SHARE
}

/// The pose, or why it is none.
///
/// `found` is what a second look found again, where the scene has landmarks and there was a pose to look from.
pub(super) fn accept(
    solved: &PoseOutcome,
    counts: &Counts,
    found: Option<&FoundAgain>,
) -> Result<PoseEstimate, NotLocated> {
    let given = counts.num_point_correspondences + counts.num_line_correspondences;
    let needed = MIN_INLIERS.max(given as u32 / MIN_INLIER_SHARE);
    if let Some(estimate) = solved.located()
        && estimate.num_point_inliers + estimate.num_line_inliers >= needed
    {
        return Ok(*estimate);
    }
    if counts.num_keypoints + counts.num_segments < MIN_FEATURES {
        return Err(NotLocated::FewFeatures);
    }
    if solved.degeneracy == Some(Degeneracy::Mirrored) {
        return Err(NotLocated::Mirrored);
    }
    let reason = NotLocated::from_status(solved.status).unwrap_or(NotLocated::FewInliers);
    let is_elsewhere = found.is_some_and(|f| f.share() < OTHER_PLACE_SHARE);
    Err(match reason {
        NotLocated::FewInliers | NotLocated::Ambiguous if is_elsewhere => NotLocated::OtherPlace,
        other => other,
    })
}
