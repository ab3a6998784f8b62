//! Which kinds of samples there are, and what each is worth.

use super::solvers::SolverKind;

/// A kind of sample.
#[derive(Debug)]
pub(super) struct Composition {
    pub(super) kind: SolverKind,
    /// How many points and lines it takes.
    pub(super) points: i32,
    pub(super) lines: i32,
    /// Probability that a sample of noisy inliers leads to the model.
    usefulness: f64,
    /// Of drawing and solving, in microseconds on one core of a server CPU; only the ratios matter.
    cost_us: f64,
    /// Candidate poses left after the tests on the sample itself.
    candidates: f64,
}

const fn composition(
    kind: SolverKind,
    points: i32,
    lines: i32,
    usefulness: f64,
    cost_us: f64,
    candidates: f64,
) -> Composition {
    Composition {
        kind,
        points,
        lines,
        usefulness,
        cost_us,
        candidates,
    }
}

const CALIBRATED: [Composition; 4] = [
    composition(SolverKind::P3p, 3, 0, 0.4, 0.7, 1.5),
    composition(SolverKind::P2p1ll, 2, 1, 0.35, 0.6, 0.5),
    composition(SolverKind::P1p2ll, 1, 2, 0.25, 1.0, 0.4),
    composition(SolverKind::P3ll, 0, 3, 0.15, 3.0, 0.5),
];
const UPRIGHT: [Composition; 2] = [
    composition(SolverKind::Up2p, 2, 0, 0.3, 0.3, 1.2),
    composition(SolverKind::Up1p1ll, 1, 1, 0.2, 0.3, 0.6),
];
const FOCAL: [Composition; 2] = [
    composition(SolverKind::Pnplf, 4, 0, 0.3, 8.0, 1.5),
    composition(SolverKind::Pnplf, 2, 2, 0.2, 8.0, 1.5),
];

/// Most kinds of samples in one search.
pub(super) const MAX_COMPOSITIONS: usize = CALIBRATED.len() + UPRIGHT.len() + FOCAL.len();

/// With the focal length unknown, the probability that the drawn one is near enough for a useful sample.
const FOCAL_HIT: f64 = 0.25;

/// Time a point or line costs to rank, in microseconds.
const ITEM_US: f64 = 0.0015;

impl Composition {
    /// The kinds of samples that a problem with so many points and lines allows.
    pub(super) fn usable(
        num_points: usize,
        num_lines: usize,
        has_gravity: bool,
        is_focal_unknown: bool,
    ) -> [Option<&'static Self>; MAX_COMPOSITIONS] {
        let upright: &'static [Self] = if has_gravity { &UPRIGHT } else { &[] };
        let focal: &'static [Self] = if is_focal_unknown { &FOCAL } else { &[] };
        let fits =
            |c: &&'static Self| num_points >= c.points as usize && num_lines >= c.lines as usize;
        let mut out = [None; MAX_COMPOSITIONS];
        let all = CALIBRATED.iter().chain(upright).chain(focal).filter(fits);
        for (slot, c) in out.iter_mut().zip(all) {
            *slot = Some(c);
        }
        out
    }

    /// Probability that a sample leads to the model, when a drawn point is one of its inliers with the first probability and
    /// a drawn line with the second.
    pub(super) fn hit(&self, point_share: f64, line_share: f64, is_focal_drawn: bool) -> f64 {
        let focal = if is_focal_drawn && self.kind != SolverKind::Pnplf {
            FOCAL_HIT
        } else {
            1.0
        };
        focal * self.usefulness * point_share.powi(self.points) * line_share.powi(self.lines)
    }

    /// Time of a sample for a problem of so many correspondences.
    pub(super) fn time_us(&self, num_items: usize) -> f64 {
        self.cost_us + self.candidates * ITEM_US * num_items as f64
    }
}
