//! What the confidence of located pictures is worth: in bins, beside the share of answers that are right.

use super::PoseError;
use crate::units::Ruler;
use serde::Serialize;
use std::fmt::Write as _;

/// Lower ends of the bins; the last one ends at 1.
const BINS: [f64; 5] = [0.0, 0.5, 0.7, 0.9, 0.99];
/// An answer within this position error (world units) and rotation error (degrees) is right.
const RIGHT: (f64, f64) = (0.25, 10.0);
/// Above this an answer is called confident.
pub const CONFIDENT: f64 = 0.9;

/// Answers whose confidence lies in one bin.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Bin {
    /// Answers.
    pub count: usize,
    /// Sum of their confidences.
    pub sum_confidence: f64,
    /// Those of them that are right.
    pub num_right: usize,
}

/// The confidence of all located pictures against their errors.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Reliability {
    /// In the order of [`BINS`].
    pub bins: [Bin; BINS.len()],
    /// Confident answers that are wrong.
    pub num_confident_wrong: usize,
}

impl Reliability {
    /// Of answers: confidence and error.
    pub fn of(answers: impl Iterator<Item = (f64, PoseError)>) -> Self {
        let mut all = Self::default();
        for (confidence, error) in answers {
            let is_right = error.position <= RIGHT.0 && error.rotation_deg <= RIGHT.1;
            let above = BINS.iter().filter(|least| **least <= confidence).count();
            let bin = &mut all.bins[above.saturating_sub(1)];
            bin.count += 1;
            bin.sum_confidence += confidence;
            bin.num_right += usize::from(is_right);
            all.num_confident_wrong += usize::from(!is_right && confidence > CONFIDENT);
        }
        all
    }

    /// Mean over the answers of how far the share of right ones in their bin is from its mean confidence; none without
    /// answers.
    pub fn calibration_error(&self) -> Option<f64> {
        let count: usize = self.bins.iter().map(|b| b.count).sum();
        let off = self
            .bins
            .iter()
            .map(|b| (b.num_right as f64 - b.sum_confidence).abs());
        (count > 0).then(|| off.sum::<f64>() / count as f64)
    }

    /// For people.
    pub fn text(&self, ruler: &Ruler) -> String {
        let mut out = format!(
            "confidence of the located (right: within {} {} and {} deg):\n",
            ruler.threshold(RIGHT.0),
            ruler.symbol,
            RIGHT.1
        );
        let ends = BINS.iter().skip(1).chain(&[1.0]);
        for ((bin, from), to) in self.bins.iter().zip(&BINS).zip(ends) {
            if bin.count > 0 {
                let count = bin.count as f64;
                let _ = writeln!(
                    out,
                    "  {from:4.2} to {to:4.2}: {:5} answers, mean confidence {:.3}, right {:.3}",
                    bin.count,
                    bin.sum_confidence / count,
                    bin.num_right as f64 / count,
                );
            }
        }
        if let Some(error) = self.calibration_error() {
            let _ = write!(
                out,
                "  calibration error {error:.3}, {} confident (> {CONFIDENT}) and wrong",
                self.num_confident_wrong
            );
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn confident_wrong_answers_are_counted_and_widen_the_calibration_error() {
        let answer = |confidence: f64, position: f64| {
            let error = PoseError {
                position,
                rotation_deg: 0.1,
            };
            (confidence, error)
        };
        let calibrated = [
            answer(0.95, 0.01),
            answer(0.95, 0.02),
            answer(0.6, 0.01),
            answer(0.6, 2.0),
        ];
        let all = Reliability::of(calibrated.into_iter());
        assert_eq!(all.num_confident_wrong, 0);
        assert_eq!(all.bins.map(|b| b.count), [0, 2, 0, 2, 0]);
        // (|2 - 1.9| + |1 - 1.2|) / 4
        let error = all.calibration_error().expect("answers");
        assert!((error - 0.075).abs() < 1e-12, "{error}");
        let worse = Reliability::of(calibrated.into_iter().chain([answer(1.0, 0.3)]));
        assert_eq!(worse.num_confident_wrong, 1);
        assert!(worse.calibration_error() > all.calibration_error());
        assert_eq!(
            Reliability::of(std::iter::empty()).calibration_error(),
            None
        );
    }
}
