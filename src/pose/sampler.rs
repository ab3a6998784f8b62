//! Draws minimal samples: more often from what the network believes in, and of the kind that pays most.
//!
//! Items are drawn with probability proportional to prior^beta; beta falls from 3 to 1/2 over the epochs, so that the first
//! samples bet on the network and the later ones forgive it; when all that has not settled the matter, the exponents take
//! turns. A tenth of the samples is uniform throughout, which guards against a network that is confidently wrong.
//! A last distribution draws only from what the best model leaves unexplained: it looks for a rival structure.

use super::problem::Problem;
use crate::math::Rng;

/// Draws after which the next exponent holds, and the exponents as powers of sqrt(prior).
const EPOCHS: [(u32, i32); 4] = [(64, 6), (512, 4), (4096, 2), (8192, 1)];

/// Number of item distributions: the epochs, the uniform one, the rest.
pub(super) const NUM_DISTRIBUTIONS: usize = EPOCHS.len() + 2;

/// Index of the uniform distribution.
const UNIFORM: usize = EPOCHS.len();

/// Index of the distribution over what the best model leaves unexplained.
pub(super) const REST: usize = EPOCHS.len() + 1;

/// Share of uniform samples.
const UNIFORM_SHARE: f64 = 0.1;

/// Walker's alias table with the probabilities it was built from.
#[derive(Debug, Default)]
pub(super) struct AliasTable {
    /// Normalised probabilities.
    pub(super) probability: Vec<f64>,
    threshold: Vec<f64>,
    alias: Vec<u32>,
    small: Vec<u32>,
    large: Vec<u32>,
}

impl AliasTable {
    fn build(&mut self, weights: impl Iterator<Item = f64>) {
        self.probability.clear();
        self.probability.extend(weights);
        let n = self.probability.len();
        let sum: f64 = self.probability.iter().sum();
        let uniform = 1.0 / n.max(1) as f64;
        for p in &mut self.probability {
            *p = if sum > 0.0 { *p / sum } else { uniform };
        }
        self.threshold.clear();
        self.threshold
            .extend(self.probability.iter().map(|p| p * n as f64));
        self.alias.clear();
        self.alias.extend(0..n as u32);
        self.small.clear();
        self.large.clear();
        for (i, t) in self.threshold.iter().enumerate() {
            if *t < 1.0 {
                self.small.push(i as u32);
            } else {
                self.large.push(i as u32);
            }
        }
        while let (Some(&s), Some(&l)) = (self.small.last(), self.large.last()) {
            self.small.pop();
            self.alias[s as usize] = l;
            self.threshold[l as usize] -= 1.0 - self.threshold[s as usize];
            if self.threshold[l as usize] < 1.0 {
                self.large.pop();
                self.small.push(l);
            }
        }
        // What is left differs from one by rounding only.
        for &i in self.small.iter().chain(&self.large) {
            self.threshold[i as usize] = 1.0;
        }
    }

    fn draw(&self, rng: &mut Rng) -> usize {
        let i = rng.below(self.threshold.len() as u32) as usize;
        if rng.uniform() < self.threshold[i] {
            i
        } else {
            self.alias[i] as usize
        }
    }
}

/// Item distributions of points and lines.
#[derive(Debug, Default)]
pub(super) struct Sampler {
    points: [AliasTable; NUM_DISTRIBUTIONS],
    lines: [AliasTable; NUM_DISTRIBUTIONS],
    epoch: usize,
    draws: u32,
}

impl Sampler {
    pub(super) fn load(&mut self, problem: &Problem) {
        self.epoch = 0;
        self.draws = 0;
        for e in [0, UNIFORM] {
            self.build(problem, e);
        }
    }

    fn build(&mut self, problem: &Problem, e: usize) {
        let power = if e == UNIFORM { 0 } else { EPOCHS[e].1 };
        let weight = |prior: f64| {
            let root = prior.sqrt();
            (0..power).fold(1.0, |w, _| w * root)
        };
        self.points[e].build(problem.points.iter().map(|p| weight(p.belief.prior)));
        self.lines[e].build(problem.lines.iter().map(|l| weight(l.belief.prior)));
    }

    /// Chooses the distribution of the next sample.
    pub(super) fn next_distribution(&mut self, problem: &Problem, rng: &mut Rng) -> usize {
        if self.draws >= EPOCHS[self.epoch].0 && self.epoch + 1 < EPOCHS.len() {
            self.epoch += 1;
            self.build(problem, self.epoch);
        }
        self.draws += 1;
        if rng.uniform() < UNIFORM_SHARE {
            UNIFORM
        } else if self.draws > EPOCHS[EPOCHS.len() - 1].0 {
            self.draws as usize % EPOCHS.len()
        } else {
            self.epoch
        }
    }

    /// Builds the distribution over what a model leaves unexplained, in proportion to the prior.
    pub(super) fn build_rest(
        &mut self,
        problem: &Problem,
        is_point_explained: &[bool],
        is_line_explained: &[bool],
    ) {
        let weight = |prior: f64, is_explained: bool| if is_explained { 0.0 } else { prior };
        let points = problem.points.iter().zip(is_point_explained);
        self.points[REST].build(points.map(|(p, is)| weight(p.belief.prior, *is)));
        let lines = problem.lines.iter().zip(is_line_explained);
        self.lines[REST].build(lines.map(|(l, is)| weight(l.belief.prior, *is)));
    }

    /// The distribution in force, for planning.
    pub(super) fn epoch(&self) -> usize {
        self.epoch
    }

    /// Probabilities of the items of one distribution: (points, lines).
    pub(super) fn probabilities(&self, distribution: usize) -> (&[f64], &[f64]) {
        (
            &self.points[distribution].probability,
            &self.lines[distribution].probability,
        )
    }

    /// Distinct point indices; false when a few attempts found none.
    pub(super) fn draw_points(&self, d: usize, rng: &mut Rng, out: &mut [usize]) -> bool {
        draw_distinct(&self.points[d], rng, out)
    }

    /// Distinct line indices; false when a few attempts found none.
    pub(super) fn draw_lines(&self, d: usize, rng: &mut Rng, out: &mut [usize]) -> bool {
        draw_distinct(&self.lines[d], rng, out)
    }
}

fn draw_distinct(table: &AliasTable, rng: &mut Rng, out: &mut [usize]) -> bool {
    if table.probability.len() < out.len() {
        return false;
    }
    rng.distinct(out, |rng| table.draw(rng))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alias_table_draws_in_proportion() {
        let mut table = AliasTable::default();
        table.build([1.0, 2.0, 3.0, 0.0, 4.0].into_iter());
        let mut rng = Rng::from_seed(4);
        let mut counts = [0.0f64; 5];
        for _ in 0..100_000 {
            counts[table.draw(&mut rng)] += 1e-5;
        }
        for (count, p) in counts.iter().zip([0.1, 0.2, 0.3, 0.0, 0.4]) {
            assert!((count - p).abs() < 0.01, "{counts:?}");
        }
        let mut pair = [0; 2];
        table.build([1.0].into_iter());
        assert!(!draw_distinct(&table, &mut rng, &mut pair));
        table.build([0.0, 0.0].into_iter());
        assert!(draw_distinct(&table, &mut rng, &mut pair));
    }
}
