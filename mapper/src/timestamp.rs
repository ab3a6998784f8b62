//! The clock: when a file is made.

use landline::scene_file::Timestamp;
use std::ffi::OsString;
use std::time::{SystemTime, UNIX_EPOCH};

/// The variable of <https://reproducible-builds.org/specs/source-date-epoch/>.
const VARIABLE: &str = "SOURCE_DATE_EPOCH";

/// The variable holds no moment.
#[derive(Debug, thiserror::Error)]
#[error("environment variable {VARIABLE} is {found:?}: expected seconds since the start of 1970")]
pub struct EpochError {
    found: OsString,
}

/// The present moment; with `SOURCE_DATE_EPOCH` in the environment that one, so that equal runs give equal files.
///
/// # Errors
/// When the variable holds no number of seconds.
pub fn now() -> Result<Timestamp, EpochError> {
    from_variable(std::env::var_os(VARIABLE))
}

fn from_variable(value: Option<OsString>) -> Result<Timestamp, EpochError> {
    let seconds = match value {
        Some(found) => match found.to_str().and_then(|text| text.parse::<u32>().ok()) {
            Some(seconds) => i64::from(seconds),
            None => return Err(EpochError { found }),
        },
        // A clock before 1970 is not set.
        None => SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |d| d.as_secs() as i64),
    };
    Ok(Timestamp::from_unix_seconds(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variable_outranks_the_clock() {
        let of = |text: &str| from_variable(Some(text.into()));
        let made = of("951868799").expect("a number").to_string();
        assert_eq!(made, "2000-02-29T23:59:59Z");
        for text in ["", "-1", "today", "1e9"] {
            let error = of(text).expect_err("no number").to_string();
            assert!(error.contains("SOURCE_DATE_EPOCH"), "{error}");
        }
        let read = from_variable(None).expect("a clock");
        assert!(read > of("1700000000").expect("a number"));
    }
}
