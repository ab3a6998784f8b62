//! Levenberg-Marquardt: one loop for every problem that has normal equations.
//!
//! A problem says how its equations look at some parameters, how a damped step is made of them and where it leads
//! ([`LeastSquares`]); [`minimize`] does the rest with Nielsen's damping. The cost never rises.

use nalgebra::{SMatrix, SVector};

/// What [`minimize`] has to know of a problem.
pub trait LeastSquares {
    /// What is looked for.
    type Parameters;
    /// Equations at some parameters, with the cost there.
    type Normal;
    /// A change of the parameters.
    type Step;

    /// Equations and cost at some parameters.
    fn normal(&mut self, at: &Self::Parameters) -> Self::Normal;

    /// The cost that comes with equations.
    fn cost(&self, normal: &Self::Normal) -> f64;

    /// The step that solves damped equations; `None` when they have no solution.
    fn step(&self, normal: &Self::Normal, lambda: f64) -> Option<Self::Step>;

    /// Squared length of a step, in units in which [`Damping::least_step_sq`] means something.
    fn step_sq(&self, step: &Self::Step) -> f64;

    /// Parameters changed by a step.
    fn moved(&self, at: &Self::Parameters, step: &Self::Step) -> Self::Parameters;

    /// Whether parameters may be accepted if their cost is lower.
    fn is_usable(&self, _at: &Self::Parameters) -> bool {
        true
    }
}

/// When and how far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damping {
    /// Most steps that are tried.
    pub max_steps: usize,
    /// Damping of the first step.
    pub start: f64,
    /// Factor after a step that was accepted.
    pub shrink: f64,
    /// Least damping.
    pub least: f64,
    /// Least damping after a step that was refused.
    pub least_when_refused: f64,
    /// Beyond this damping nothing is gained any more.
    pub most: f64,
    /// Ends when a step lowers the cost by less than this share of 1 + cost.
    pub least_drop: f64,
    /// Ends at steps whose squared length is below this.
    pub least_step_sq: f64,
}

impl Default for Damping {
    fn default() -> Self {
        Self {
            max_steps: 10,
            start: 1e-5,
            shrink: 0.2,
            least: 1e-9,
            least_when_refused: 1e-6,
            most: 1e8,
            least_drop: 1e-10,
            least_step_sq: 1e-18,
        }
    }
}

/// Moves parameters to a least cost nearby; `is_over` is asked before each step. Returns them with their equations.
pub fn minimize<P: LeastSquares>(
    problem: &mut P,
    start: P::Parameters,
    damping: &Damping,
    mut is_over: impl FnMut() -> bool,
) -> (P::Parameters, P::Normal) {
    let mut parameters = start;
    let mut normal = problem.normal(&parameters);
    let (mut lambda, mut growth) = (damping.start, 2.0);
    for _ in 0..damping.max_steps {
        if is_over() {
            break;
        }
        let Some(step) = problem.step(&normal, lambda) else {
            lambda *= growth;
            growth *= 2.0;
            continue;
        };
        let size = problem.step_sq(&step);
        let candidate = problem.moved(&parameters, &step);
        let next = problem.normal(&candidate);
        let drop = problem.cost(&normal) - problem.cost(&next);
        if drop >= 0.0 && problem.is_usable(&candidate) {
            parameters = candidate;
            let relative = drop / (1.0 + problem.cost(&next).abs());
            normal = next;
            lambda = (lambda * damping.shrink).max(damping.least);
            growth = 2.0;
            if relative < damping.least_drop || size < damping.least_step_sq {
                break;
            }
        } else {
            lambda = (lambda * growth).max(damping.least_when_refused);
            growth *= 2.0;
            if size < damping.least_step_sq || lambda > damping.most {
                break;
            }
        }
    }
    (parameters, normal)
}

/// Normal equations `h step = -g` of `N` unknowns, with the cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normal<const N: usize> {
    /// Sum of weight * row * row^T.
    pub h: SMatrix<f64, N, N>,
    /// Sum of weight * residual * row.
    pub g: SVector<f64, N>,
    /// Half the sum of squares, or what the problem takes in its place.
    pub cost: f64,
}

impl<const N: usize> Default for Normal<N> {
    fn default() -> Self {
        Self {
            h: SMatrix::zeros(),
            g: SVector::zeros(),
            cost: 0.0,
        }
    }
}

impl<const N: usize> Normal<N> {
    /// Adds a residual with its derivatives; the cost is the caller's.
    pub fn add(&mut self, row: &SVector<f64, N>, residual: f64, weight: f64) {
        self.g += weight * residual * row;
        self.h += weight * row * row.transpose();
    }

    /// Step of the equations with each diagonal element raised by `lambda` times itself; an unknown that no residual
    /// depends on stays put. `None` when they are not positive definite.
    pub fn step(&self, lambda: f64) -> Option<SVector<f64, N>> {
        let mut h = self.h;
        let floor = 1e-12 * h.trace();
        for i in 0..N {
            let d = h[(i, i)];
            h[(i, i)] = if d > 0.0 {
                d + lambda * d.max(floor)
            } else {
                1.0
            };
        }
        let step = -h.cholesky()?.solve(&self.g);
        step.iter().all(|s| s.is_finite()).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector2, Vector3};

    /// Rosenbrock's valley as a sum of squares: 10 (y - x^2), 1 - x.
    struct Valley;

    impl LeastSquares for Valley {
        type Parameters = Vector2<f64>;
        type Normal = Normal<2>;
        type Step = Vector2<f64>;

        fn normal(&mut self, at: &Vector2<f64>) -> Normal<2> {
            let mut normal = Normal::default();
            let (a, b) = (10.0 * (at.y - at.x * at.x), 1.0 - at.x);
            normal.add(&Vector2::new(-20.0 * at.x, 10.0), a, 1.0);
            normal.add(&Vector2::new(-1.0, 0.0), b, 1.0);
            normal.cost = 0.5 * (a * a + b * b);
            normal
        }
        fn cost(&self, normal: &Normal<2>) -> f64 {
            normal.cost
        }
        fn step(&self, normal: &Normal<2>, lambda: f64) -> Option<Vector2<f64>> {
            normal.step(lambda)
        }
        fn step_sq(&self, step: &Vector2<f64>) -> f64 {
            step.norm_squared()
        }
        fn moved(&self, at: &Vector2<f64>, step: &Vector2<f64>) -> Vector2<f64> {
            at + step
        }
    }

    #[test]
    fn finds_the_bottom_of_a_bent_valley_and_never_rises() {
        let damping = Damping {
            max_steps: 60,
            ..Damping::default()
        };
        let start = Vector2::new(-1.2, 1.0);
        let (found, normal) = minimize(&mut Valley, start, &damping, || false);
        assert!((found - Vector2::new(1.0, 1.0)).norm() < 1e-6, "{found}");
        assert!(normal.cost < 1e-12);
        let mut last = f64::INFINITY;
        for max_steps in 0..20 {
            let damping = Damping {
                max_steps,
                ..damping
            };
            let (_, normal) = minimize(&mut Valley, start, &damping, || false);
            assert!(normal.cost <= last);
            last = normal.cost;
        }
        let (stopped, _) = minimize(&mut Valley, start, &damping, || true);
        assert_eq!(stopped, start);
    }

    #[test]
    fn an_unknown_that_nothing_depends_on_stays_put() {
        let mut normal = Normal::<3>::default();
        normal.add(&Vector3::new(2.0, 0.0, 0.0), 4.0, 1.0);
        normal.add(&Vector3::new(0.0, 0.0, 1.0), -3.0, 2.0);
        let step = normal.step(0.0).expect("definite");
        assert!((step - Vector3::new(-2.0, 0.0, 3.0)).norm() < 1e-12);
        assert!(normal.step(f64::NAN).is_none());
    }
}
