//! One robust loop for every two-view model: sample, solve, score by a truncated sum of squares, optimise locally, stop when a
//! better model would have been seen.
//!
//! LO-RANSAC (Chum, Matas, Kittler 2003) with the MSAC score (Torr and Zisserman 2000). Items are expected best first: half of
//! the samples prefer the front of the list (in the spirit of PROSAC), the other half are uniform, so a bad order costs at most
//! a factor of two.

use crate::math::Rng;
use crate::math::elementary::ln_1p;

/// What the loop needs to know about a model.
pub(super) trait RobustProblem {
    /// A hypothesis.
    type Model: Clone;
    /// Items in a minimal sample, at most eight.
    const SAMPLE: usize;

    /// Items in all.
    fn num_items(&self) -> usize;

    /// Appends the models of a minimal sample.
    fn solve(&self, sample: &[usize], out: &mut Vec<Self::Model>);

    /// Squared error of an item under a model, in the unit of [`RobustOptions::max_error_sq`].
    fn error_sq(&self, model: &Self::Model, item: usize) -> f64;

    /// A better model from all inliers of one; `None` when there is none.
    fn refine(&self, model: &Self::Model, inliers: &[usize]) -> Option<Self::Model>;
}

/// Limits of the search.
#[derive(Debug, Clone, Copy)]
pub(super) struct RobustOptions {
    /// Items with a smaller squared error are inliers.
    pub(super) max_error_sq: f64,
    /// Samples at most.
    pub(super) max_iterations: usize,
    /// Samples at least.
    pub(super) min_iterations: usize,
    /// Probability with which no better model is missed.
    pub(super) confidence: f64,
}

/// The best model.
#[derive(Debug, Clone)]
pub(super) struct Found<M> {
    pub(super) model: M,
    /// Sorted.
    pub(super) inliers: Vec<usize>,
}

/// Sum of truncated errors; gives up with infinity as soon as it passes `best`.
fn cost<P: RobustProblem>(problem: &P, model: &P::Model, limit: f64, best: f64) -> f64 {
    let mut sum = 0.0;
    for i in 0..problem.num_items() {
        let e = problem.error_sq(model, i);
        sum += if e < limit { e / limit } else { 1.0 };
        if sum >= best {
            return f64::INFINITY;
        }
    }
    sum
}

pub(super) fn inliers_of<P: RobustProblem>(
    problem: &P,
    model: &P::Model,
    limit: f64,
) -> Vec<usize> {
    (0..problem.num_items())
        .filter(|i| problem.error_sq(model, *i) < limit)
        .collect()
}

/// Searches for the model with the least truncated cost. `None` when no sample gives one.
pub(super) fn search<P: RobustProblem>(
    problem: &P,
    options: &RobustOptions,
    rng: &mut Rng,
) -> Option<Found<P::Model>> {
    let n = problem.num_items();
    if n < P::SAMPLE {
        return None;
    }
    let mut best: Option<(P::Model, f64)> = None;
    let mut candidates = Vec::new();
    let mut needed = options.max_iterations;
    let mut sample = [0usize; 8];
    let mut iteration = 0;
    while iteration
        < needed
            .max(options.min_iterations)
            .min(options.max_iterations)
    {
        iteration += 1;
        if !draw(n, &mut sample[..P::SAMPLE], iteration % 2 == 0, rng) {
            continue;
        }
        candidates.clear();
        problem.solve(&sample[..P::SAMPLE], &mut candidates);
        let mut is_better = false;
        for model in &candidates {
            let least = best.as_ref().map_or(n as f64, |b| b.1);
            let c = cost(problem, model, options.max_error_sq, least);
            if c < least {
                best = Some((model.clone(), c));
                is_better = true;
            }
        }
        if is_better && let Some(current) = best.take() {
            let improved = optimise(problem, current, options.max_error_sq);
            let share = 1.0 - improved.1 / n as f64;
            needed = iterations_needed(share, P::SAMPLE, options);
            best = Some(improved);
        }
    }
    let (model, _) = best?;
    let inliers = inliers_of(problem, &model, options.max_error_sq);
    Some(Found { model, inliers })
}

/// Refines on the inliers of a wider, then of the right threshold, as long as the cost falls.
fn optimise<P: RobustProblem>(
    problem: &P,
    (mut model, mut least): (P::Model, f64),
    limit: f64,
) -> (P::Model, f64) {
    for factor in [4.0, 1.0, 1.0] {
        let inliers = inliers_of(problem, &model, factor * limit);
        if inliers.len() < P::SAMPLE {
            break;
        }
        let Some(refined) = problem.refine(&model, &inliers) else {
            continue;
        };
        let c = cost(problem, &refined, limit, least);
        if c < least {
            (model, least) = (refined, c);
        }
    }
    (model, least)
}

/// Samples after which a sample of inliers only has been drawn with the wanted probability.
fn iterations_needed(share: f64, sample: usize, options: &RobustOptions) -> usize {
    let good = (0..sample).fold(1.0, |p, _| p * share.clamp(0.0, 1.0));
    if good > 1.0 - 1e-9 {
        return options.min_iterations;
    }
    let needed = ln_1p(-options.confidence) / ln_1p(-good);
    if needed.is_finite() && needed < options.max_iterations as f64 {
        needed as usize + 1
    } else {
        options.max_iterations
    }
}

/// Distinct indices below `n`; with `prefers_front` their density falls linearly from the front to nothing at the end.
fn draw(n: usize, out: &mut [usize], prefers_front: bool, rng: &mut Rng) -> bool {
    rng.distinct(out, |rng| {
        if prefers_front {
            let (u, v) = (rng.uniform(), rng.uniform());
            ((u.min(v) * n as f64) as usize).min(n - 1)
        } else {
            rng.below(n as u32) as usize
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = a x + b through two points.
    struct LineFit(Vec<(f64, f64)>);

    impl RobustProblem for LineFit {
        type Model = (f64, f64);
        const SAMPLE: usize = 2;

        fn num_items(&self) -> usize {
            self.0.len()
        }

        fn solve(&self, sample: &[usize], out: &mut Vec<(f64, f64)>) {
            let (p, q) = (self.0[sample[0]], self.0[sample[1]]);
            let a = (q.1 - p.1) / (q.0 - p.0);
            if a.is_finite() {
                out.push((a, p.1 - a * p.0));
            }
        }

        fn error_sq(&self, (a, b): &(f64, f64), item: usize) -> f64 {
            let (x, y) = self.0[item];
            (y - a * x - b) * (y - a * x - b)
        }

        fn refine(&self, _: &(f64, f64), inliers: &[usize]) -> Option<(f64, f64)> {
            let n = inliers.len() as f64;
            let sum = |f: &dyn Fn((f64, f64)) -> f64| -> f64 {
                inliers.iter().map(|i| f(self.0[*i])).sum()
            };
            let (sx, sy) = (sum(&|p| p.0), sum(&|p| p.1));
            let (sxx, sxy) = (sum(&|p| p.0 * p.0), sum(&|p| p.0 * p.1));
            let a = (n * sxy - sx * sy) / (n * sxx - sx * sx);
            Some((a, (sy - a * sx) / n))
        }
    }

    #[test]
    fn finds_a_line_among_four_times_as_many_outliers() {
        let options = RobustOptions {
            max_error_sq: 0.01,
            max_iterations: 2_000,
            min_iterations: 20,
            confidence: 0.999,
        };
        for seed in 0..50 {
            let mut rng = Rng::from_seed(seed);
            let points = (0..200)
                .map(|i| {
                    let x = rng.range(-5.0, 5.0);
                    let y = if i % 5 == 0 {
                        0.7 * x - 1.0 + 0.02 * rng.normal()
                    } else {
                        rng.range(-5.0, 5.0)
                    };
                    (x, y)
                })
                .collect();
            let found = search(&LineFit(points), &options, &mut rng).expect("a line");
            let (a, b) = found.model;
            assert!((a - 0.7).abs() < 0.02 && (b + 1.0).abs() < 0.05, "{a} {b}");
            assert!(found.inliers.len() >= 38, "{}", found.inliers.len());
        }
        assert!(search(&LineFit(vec![(0.0, 0.0)]), &options, &mut Rng::from_seed(0)).is_none());
    }
}
