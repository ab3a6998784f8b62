//! What holds the world in place when nothing else does.

use super::BundleProblem;

/// Without anything that holds the world in place: the first camera stays, and the scale by one coordinate.
pub(super) fn hold_gauge(problem: &BundleProblem, columns: &[usize], is_active: &mut [bool]) {
    let is_held = problem.cameras.iter().any(|c| c.is_fixed) || !problem.pose_priors.is_empty();
    let (false, Some(first)) = (is_held, problem.cameras.first()) else {
        return;
    };
    is_active[..6].fill(false);
    let center = first.cam_from_world.center_in_world();
    let offset = |c: usize| problem.cameras[c].cam_from_world.center_in_world() - center;
    let farthest = (1..problem.cameras.len()).max_by(|a, b| {
        offset(*a)
            .norm_squared()
            .total_cmp(&offset(*b).norm_squared())
    });
    if let Some(c) = farthest {
        is_active[columns[c] + 3 + offset(c).iamax()] = false;
    }
}
