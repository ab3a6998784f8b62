//! Number of false alarms of a rectangle: a binomial tail times the number of tests.
//!
//! Source: `[lsd2012]`, section on the number of false alarms. The tail is summed until its error is below a tenth of
//! the value, as published; where the sum stops shows in the output.

use super::params::{MAX_HALVINGS, Tolerance};
use core::f64::consts::{LN_10, LOG10_2, PI};

/// Share of the value that may be lost by ending the sum early.
const RELATIVE_ERROR: f64 = 0.1;
/// Entries of the table of log-gamma values; larger arguments are computed. 4096 pixels are a rectangle of 1000 x 4.
const TABLE_LEN: usize = 4096;

/// What the number of false alarms depends on besides the counts, computed once per size and precision.
#[derive(Debug)]
pub(super) struct NfaTable {
    precision: f64,
    log10_tests: f64,
    levels: [Level; MAX_HALVINGS + 1],
    /// `ln(gamma(i))`, filled as far as needed.
    log_gamma: Vec<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Level {
    tolerance: Tolerance,
    ln_p: f64,
    ln_rest: f64,
    odds: f64,
    p: f64,
}

impl NfaTable {
    /// For a default precision `precision` (angle tolerance over pi).
    pub(super) fn new(precision: f64, log10_tests: f64) -> Self {
        let mut p = precision;
        let levels = core::array::from_fn(|_| {
            let level = Level {
                tolerance: Tolerance::new(p * PI),
                ln_p: libm::log(p),
                ln_rest: libm::log(1.0 - p),
                odds: p / (1.0 - p),
                p,
            };
            p /= 2.0;
            level
        });
        let mut log_gamma = Vec::with_capacity(TABLE_LEN);
        log_gamma.push(f64::INFINITY);
        Self {
            precision,
            log10_tests,
            levels,
            log_gamma,
        }
    }

    /// Same table with another number of tests, reusing what does not depend on it.
    pub(super) fn prepare(&mut self, precision: f64, log10_tests: f64) {
        if self.precision == precision {
            self.log10_tests = log10_tests;
        } else {
            *self = Self::new(precision, log10_tests);
        }
    }

    pub(super) fn tolerance(&self, halvings: usize) -> Tolerance {
        self.levels[halvings].tolerance
    }

    pub(super) fn precision(&self, halvings: usize) -> f64 {
        self.levels[halvings].p
    }

    fn log_gamma(&mut self, n: usize) -> f64 {
        if let Some(&value) = self.log_gamma.get(n) {
            return value;
        }
        if n >= TABLE_LEN {
            return libm::lgamma(n as f64);
        }
        for i in self.log_gamma.len()..=n {
            self.log_gamma.push(libm::lgamma(i as f64));
        }
        self.log_gamma[n]
    }

    /// -log10 of the number of false alarms of `k` aligned pixels among `n`.
    pub(super) fn neg_log10(&mut self, n: usize, k: usize, halvings: usize) -> f64 {
        let level = self.levels[halvings];
        if n == 0 || k == 0 {
            return -self.log10_tests;
        }
        let (total, aligned) = (n as f64, k as f64);
        if n == k {
            return -self.log10_tests - total * (level.ln_p / LN_10);
        }
        let ln_first = self.log_gamma(n + 1) - self.log_gamma(k + 1) - self.log_gamma(n - k + 1)
            + aligned * level.ln_p
            + (total - aligned) * level.ln_rest;
        let mut term = libm::exp(ln_first);
        if term == 0.0 {
            return if aligned > total * level.p {
                -ln_first / LN_10 - self.log10_tests
            } else {
                -self.log10_tests
            };
        }
        let mut tail = term;
        for i in k + 1..=n {
            let left = (n - i + 1) as f64;
            let ratio = left / i as f64;
            let factor = ratio * level.odds;
            term *= factor;
            tail += term;
            if ratio < 1.0 {
                // The terms left are at most a geometric series with this factor.
                let error = term * ((1.0 - power(factor, n - i + 1)) / (1.0 - factor) - 1.0);
                if self.is_small(error, tail) {
                    break;
                }
            }
        }
        -libm::log10(tail) - self.log10_tests
    }

    /// Whether `error` is below a tenth of the value times the tail. The logarithm is taken only when its integer part
    /// does not decide.
    fn is_small(&self, error: f64, tail: f64) -> bool {
        let exponent = ((tail.to_bits() >> 52) & 0x7ff) as i32 - 1023;
        let (a, b) = (
            -f64::from(exponent) * LOG10_2 - self.log10_tests,
            -f64::from(exponent + 1) * LOG10_2 - self.log10_tests,
        );
        let scale = RELATIVE_ERROR * tail;
        const ROUNDING: f64 = 1e-9;
        let (low, high) = (a.abs().min(b.abs()), a.abs().max(b.abs()));
        if a * b > 0.0 && error < scale * (low - ROUNDING) {
            return true;
        }
        if error > scale * (high + ROUNDING) {
            return false;
        }
        error < scale * (-libm::log10(tail) - self.log10_tests).abs()
    }
}

/// Integer power by squaring; unlike the intrinsic it gives the same bits on every target.
fn power(base: f64, exponent: usize) -> f64 {
    let (mut result, mut square, mut left) = (1.0, base, exponent);
    while left > 0 {
        if left & 1 == 1 {
            result *= square;
        }
        square *= square;
        left >>= 1;
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tail summed from its smallest term, logarithms of binomials from a running sum.
    fn exact(n: usize, k: usize, p: f64) -> f64 {
        let ln_factorial: Vec<f64> = (0..=n)
            .scan(0.0, |sum, i| {
                if i > 0 {
                    *sum += (i as f64).ln();
                }
                Some(*sum)
            })
            .collect();
        let ln_term = |j: usize| {
            ln_factorial[n] - ln_factorial[j] - ln_factorial[n - j]
                + j as f64 * p.ln()
                + (n - j) as f64 * (1.0 - p).ln()
        };
        let largest = (k..=n).map(ln_term).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = (k..=n).rev().map(|j| (ln_term(j) - largest).exp()).sum();
        -(sum.ln() + largest) / LN_10
    }

    #[test]
    fn close_to_the_exact_binomial_tail() {
        let mut table = NfaTable::new(0.125, 0.0);
        for n in [1, 2, 5, 17, 60, 200, 777, 2000] {
            for halvings in 0..=MAX_HALVINGS {
                let p = table.precision(halvings);
                for k in (0..=n).step_by(1 + n / 40) {
                    let (got, want) = (table.neg_log10(n, k, halvings), exact(n, k, p));
                    if want > 300.0 {
                        // The first term underflows; it alone stands for the tail then.
                        assert!((got / want - 1.0).abs() < 0.1, "{n} {k} {p}: {got} {want}");
                    } else {
                        assert!(
                            (got - want).abs() <= 0.1 * want.abs() + 1e-9,
                            "{n} {k} {p}: {got} {want}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn edge_cases() {
        let mut table = NfaTable::new(0.125, 10.0);
        assert_eq!(table.neg_log10(0, 0, 0), -10.0);
        assert_eq!(table.neg_log10(30, 0, 0), -10.0);
        assert!((table.neg_log10(30, 30, 0) - (30.0 * 8f64.log10() - 10.0)).abs() < 1e-12);
        // So many pixels that the first term underflows, on either side of the mean.
        assert_eq!(table.neg_log10(20_000, 10, 0), -10.0);
        let far = table.neg_log10(20_000, 15_000, 0);
        assert!((far / exact(20_000, 15_000, 0.125) - 1.0).abs() < 0.01);
    }

    #[test]
    fn ending_test_agrees_with_the_logarithm() {
        let table = NfaTable::new(0.125, 14.3);
        let mut state = 1u64;
        let mut random = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut both = [0; 2];
        for _ in 0..20_000 {
            let tail = 10f64.powf(-40.0 * random());
            let want_scale = 0.1 * tail * (-libm::log10(tail) - 14.3).abs();
            let error = want_scale * (0.2 + 1.6 * random());
            let small = table.is_small(error, tail);
            assert_eq!(small, error < want_scale);
            both[usize::from(small)] += 1;
        }
        assert!(both[0] > 1000 && both[1] > 1000);
    }
}
