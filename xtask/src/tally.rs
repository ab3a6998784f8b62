//! Counting tests over all tiers, and the closing line.

use std::fmt;
use std::ops::{Add, AddAssign};

/// How many tests passed, failed and were skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) passed: usize,
    pub(crate) failed: usize,
    pub(crate) skipped: usize,
}

impl Tally {
    /// One check that held or did not.
    pub(crate) fn one(passed: bool) -> Self {
        Self {
            passed: usize::from(passed),
            failed: usize::from(!passed),
            skipped: 0,
        }
    }

    /// Moves `count` tests that reported themselves as skipped from the passed ones, where their runner put them.
    pub(crate) fn with_skips(mut self, count: usize) -> Self {
        let moved = count.min(self.passed);
        self.passed -= moved;
        self.skipped += moved;
        self
    }
}

impl Add for Tally {
    type Output = Self;

    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} passed, {} failed, {} skipped",
            self.passed, self.failed, self.skipped
        )
    }
}

/// Reads the closing lines of libtest and of wasm-bindgen's test runner. Feed it every line of a run.
#[derive(Clone, Debug, Default)]
pub(crate) struct LibtestReader {
    tally: Tally,
    results: usize,
}

impl LibtestReader {
    pub(crate) fn line(&mut self, line: &str) {
        let Some((_, rest)) = line.split_once("test result: ") else {
            return;
        };
        let count = |word: &str| -> usize {
            rest.split([';', '.'])
                .filter_map(|part| part.trim().strip_suffix(word))
                .find_map(|number| number.trim().parse().ok())
                .unwrap_or(0)
        };
        self.results += 1;
        self.tally += Tally {
            passed: count("passed"),
            failed: count("failed"),
            skipped: count("ignored"),
        };
    }

    /// What was counted. A run that failed without counting a failure (it did not compile, or a test binary died)
    /// counts as one failure, and so does a run that claims success and closed no test binary.
    pub(crate) fn finish(self, succeeded: bool) -> Tally {
        let mut tally = self.tally;
        if (!succeeded && tally.failed == 0) || (succeeded && self.results == 0) {
            tally.failed += 1;
        }
        tally
    }
}

/// Reads the closing comment lines of Node's test runner in TAP form.
#[derive(Clone, Debug, Default)]
pub(crate) struct TapReader {
    tally: Tally,
    closed: bool,
}

impl TapReader {
    pub(crate) fn line(&mut self, line: &str) {
        // Only the unindented comments close the run; nested ones belong to one test.
        let mut words = line.split(' ');
        let (Some("#"), Some(word), Some(number), None) =
            (words.next(), words.next(), words.next(), words.next())
        else {
            return;
        };
        let Ok(number) = number.trim().parse::<usize>() else {
            return;
        };
        match word {
            "pass" => (self.tally.passed, self.closed) = (number, true),
            "fail" | "cancelled" => self.tally.failed += number,
            "skipped" | "todo" => self.tally.skipped += number,
            _ => {}
        }
    }

    /// What was counted, with the rule of [`LibtestReader::finish`].
    pub(crate) fn finish(self, succeeded: bool) -> Tally {
        let mut tally = self.tally;
        if (!succeeded && tally.failed == 0) || (succeeded && !self.closed) {
            tally.failed += 1;
        }
        tally
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_the_closing_lines_of_libtest() {
        let mut reader = LibtestReader::default();
        for line in [
            "running 3 tests",
            "test result: ok. 3 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.01s",
            "\u{1b}[0mtest result: FAILED. 10 passed; 2 failed; 0 ignored; 0 measured; 7 filtered out",
        ] {
            reader.line(line);
        }
        assert_eq!(
            reader.finish(false),
            Tally {
                passed: 13,
                failed: 2,
                skipped: 1
            }
        );
    }

    #[test]
    fn counts_a_run_that_did_not_compile_as_a_failure() {
        assert_eq!(LibtestReader::default().finish(false).failed, 1);
    }

    #[test]
    fn counts_a_run_without_a_test_binary_as_a_failure() {
        assert_eq!(LibtestReader::default().finish(true).failed, 1);
    }

    #[test]
    fn reads_the_closing_comments_of_node() {
        let mut reader = TapReader::default();
        for line in [
            "# tests 4",
            "# pass 2",
            "# fail 1",
            "# cancelled 0",
            "# skipped 1",
            "# todo 0",
            "    # pass 9",
        ] {
            reader.line(line);
        }
        assert_eq!(
            reader.finish(false),
            Tally {
                passed: 2,
                failed: 1,
                skipped: 1
            }
        );
    }

    #[test]
    fn moves_self_reported_skips_out_of_the_passed() {
        let tally = Tally {
            passed: 5,
            failed: 0,
            skipped: 1,
        };
        assert_eq!(
            tally.with_skips(2),
            Tally {
                passed: 3,
                failed: 0,
                skipped: 3
            }
        );
    }
}
