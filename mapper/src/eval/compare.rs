//! Is one method better than another on the same pictures? A paired bootstrap over pictures.

use super::{PoseError, Summary};
use crate::units::Ruler;
use landline::math::Rng;
use landline::math::stats::quantile_in_place;
use serde::Serialize;

const NUM_SAMPLES: usize = 2000;

/// Two methods on the same pictures; differences are first minus second, so below zero the first is more accurate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the first.
    pub first: String,
    /// Name of the second.
    pub second: String,
    /// Difference of the median positions, and the range that holds 95 % of the resampled differences.
    pub position: [f64; 3],
    /// The same of the rotations in degrees.
    pub rotation_deg: [f64; 3],
    /// The same of the recall within 2 cm / 2 deg, as a share.
    pub recall: [f64; 3],
    /// Share of resamples in which the first has the lower median position.
    pub first_is_better: f64,
    /// Pictures on which the first, and on which the second is nearer the true position.
    pub wins: [usize; 2],
}

impl Comparison {
    /// Compares; for each picture the errors of all seeds, `None` for no pose. Both lists are of the same pictures.
    pub fn new(
        (first, a): (&str, &[Vec<Option<PoseError>>]),
        (second, b): (&str, &[Vec<Option<PoseError>>]),
    ) -> Self {
        let num = a.len().min(b.len());
        let statistics = |errors: &[Vec<Option<PoseError>>], chosen: &[usize]| -> [f64; 3] {
            let pooled: Vec<Option<PoseError>> = chosen
                .iter()
                .filter_map(|i| errors.get(*i))
                .flatten()
                .copied()
                .collect();
            let s = Summary::of(&pooled, &[]);
            [
                s.median_position,
                s.median_rotation_deg,
                s.recall_at(0.02).unwrap_or(f64::NAN),
            ]
        };
        let difference = |chosen: &[usize]| -> [f64; 3] {
            let (x, y) = (statistics(a, chosen), statistics(b, chosen));
            // Two failures are alike, not undefined.
            std::array::from_fn(|i| if x[i] == y[i] { 0.0 } else { x[i] - y[i] })
        };
        let all: Vec<usize> = (0..num).collect();
        let measured = difference(&all);
        let mut rng = Rng::from_seed(1);
        let mut samples: [Vec<f64>; 3] = Default::default();
        for _ in 0..NUM_SAMPLES {
            let chosen: Vec<usize> = all.iter().map(|_| rng.below(num as u32) as usize).collect();
            for (list, d) in samples.iter_mut().zip(difference(&chosen)) {
                list.push(d);
            }
        }
        let first_is_better =
            samples[0].iter().filter(|d| **d < 0.0).count() as f64 / NUM_SAMPLES as f64;
        let range = |i: usize, list: &mut Vec<f64>| -> [f64; 3] {
            let low = quantile_in_place(list, 0.025).unwrap_or(f64::NAN);
            let high = quantile_in_place(list, 0.975).unwrap_or(f64::NAN);
            [measured[i], low, high]
        };
        let mean = |errors: &[Option<PoseError>]| -> f64 {
            let sum: f64 = errors
                .iter()
                .map(|e| e.map_or(f64::INFINITY, |e| e.position))
                .sum();
            sum / errors.len().max(1) as f64
        };
        let mut wins = [0; 2];
        for (x, y) in a.iter().zip(b) {
            let (x, y) = (mean(x), mean(y));
            wins[0] += usize::from(x < y);
            wins[1] += usize::from(y < x);
        }
        let [positions, rotations, recalls] = &mut samples;
        Self {
            first: first.to_owned(),
            second: second.to_owned(),
            position: range(0, positions),
            rotation_deg: range(1, rotations),
            recall: range(2, recalls),
            first_is_better,
            wins,
        }
    }
}

impl Comparison {
    /// In one sentence.
    pub fn text(&self, ruler: &Ruler) -> String {
        let [p, p_low, p_high] = self
            .position
            .map(|v| format!("{:+.*}", ruler.digits, ruler.factor * v));
        let (symbol, recall) = (ruler.symbol, ruler.threshold(0.02));
        let [r, r_low, r_high] = self.rotation_deg;
        let [c, c_low, c_high] = self.recall.map(|v| 100.0 * v);
        format!(
            "{} against {}: median {p} {symbol} ({p_low} .. {p_high}), {r:+.3} deg ({r_low:+.3} .. {r_high:+.3}), \
             {recall}/2 {c:+.1} points ({c_low:+.1} .. {c_high:+.1}); nearer on {} pictures, farther on {}; lower median in \
             {:.1} % of resamples",
            self.first,
            self.second,
            self.wins[0],
            self.wins[1],
            100.0 * self.first_is_better
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::scene_file::Units;

    fn errors(position: impl Fn(usize) -> f64) -> Vec<Vec<Option<PoseError>>> {
        (0..40)
            .map(|i| {
                vec![Some(PoseError {
                    position: position(i),
                    rotation_deg: 0.5,
                })]
            })
            .collect()
    }

    #[test]
    fn a_clear_difference_is_sure_and_none_is_not() {
        let near = errors(|i| 0.010 + 0.0001 * i as f64);
        let far = errors(|i| 0.020 + 0.0001 * i as f64);
        let c = Comparison::new(("near", &near), ("far", &far));
        assert!((c.position[0] + 0.01).abs() < 1e-12);
        assert!(c.position[1] <= c.position[0] && c.position[0] <= c.position[2]);
        assert!(c.position[2] < 0.0, "{c:?}");
        assert_eq!((c.wins, c.first_is_better), ([40, 0], 1.0));
        assert_eq!(c.rotation_deg, [0.0; 3]);
        let told = |units| c.text(&Ruler::of(units));
        assert!(told(Units::Metres).contains("median -1.00 cm ("));
        assert!(told(Units::Arbitrary).contains("median -0.0100 units ("));

        // As many better by a centimetre as worse by one: the range holds zero.
        let mixed = errors(|i| 0.015 + 0.0001 * i as f64 + if i % 2 == 0 { 0.01 } else { -0.01 });
        let middle = errors(|i| 0.015 + 0.0001 * i as f64);
        let c = Comparison::new(("mixed", &mixed), ("middle", &middle));
        assert!(c.position[1] < 0.0 && c.position[2] > 0.0, "{c:?}");

        let lost = vec![vec![None]; 40];
        let c = Comparison::new(("lost", &lost), ("lost too", &lost));
        assert_eq!(
            (c.position[0], c.first_is_better, c.wins),
            (0.0, 0.0, [0, 0])
        );
    }
}
