//! When a file was made: a moment in UTC, written in the form of ISO 8601. The clock is the caller's.

use core::fmt;

/// A day, or a second of a day in UTC: `2026-01-31` or `2026-01-31T23:59:59Z`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Timestamp(String);

/// Why a text is no [`Timestamp`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected a date in UTC as ISO 8601, YYYY-MM-DD or YYYY-MM-DDThh:mm:ssZ")]
pub struct TimestampError;

impl Timestamp {
    /// Of seconds since the start of 1970 in UTC, without leap seconds, as Unix counts; years 0 to 9999 are kept, others end
    /// at the nearest of them.
    pub fn from_unix_seconds(seconds: i64) -> Self {
        const FIRST: i64 = -62_167_219_200;
        const LAST: i64 = 253_402_300_799;
        let seconds = seconds.clamp(FIRST, LAST);
        let (days, second) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
        let (year, month, day) = civil_from_days(days);
        let (h, m, s) = (second / 3600, second / 60 % 60, second % 60);
        Self(format!(
            "{year:04}-{month:02}-{day:02}T{h:02}:{m:02}:{s:02}Z"
        ))
    }

    /// Of its text.
    ///
    /// # Errors
    /// [`TimestampError`] for another form, or a day or time of day that does not exist.
    pub fn parse(text: &str) -> Result<Self, TimestampError> {
        let fields = |text: &str, form: &str, separators: [&str; 2]| -> Option<[i64; 3]> {
            let [a, b] = separators;
            let (first, rest) = text.split_once(a)?;
            let (second, third) = rest.split_once(b)?;
            let widths = form.split(' ').map(str::len);
            let mut out = [0; 3];
            for ((value, part), width) in out.iter_mut().zip([first, second, third]).zip(widths) {
                let digits = part.bytes().all(|b| b.is_ascii_digit());
                *value = part
                    .parse()
                    .ok()
                    .filter(|_| digits && part.len() == width)?;
            }
            Some(out)
        };
        let valid = || {
            let (date, time) = match text.split_once('T') {
                Some((date, time)) => (date, Some(time)),
                None => (text, None),
            };
            let [year, month, day] = fields(date, "YYYY MM DD", ["-", "-"])?;
            let exists = (1..=12).contains(&month) && (1..=days_in(year, month)).contains(&day);
            let time_exists = match time {
                None => true,
                Some(time) => {
                    let [h, m, s] = fields(time.strip_suffix('Z')?, "hh mm ss", [":", ":"])?;
                    h < 24 && m < 60 && s < 60
                }
            };
            (exists && time_exists).then(|| Self(text.to_owned()))
        };
        valid().ok_or(TimestampError)
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

fn is_leap(year: i64) -> bool {
    year % 4 == 0 && (year % 100 != 0 || year % 400 == 0)
}

fn days_in(year: i64, month: i64) -> i64 {
    match month {
        2 if is_leap(year) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

/// Year, month and day of a number of days since the start of 1970, in the Gregorian calendar.
fn civil_from_days(days: i64) -> (i64, i64, i64) {
    // Four centuries have the same days each; the year zero starts one of them.
    const FOUR_CENTURIES: i64 = 146_097;
    let since_zero = days + 719_528;
    let mut year = 400 * since_zero.div_euclid(FOUR_CENTURIES);
    let mut left = since_zero.rem_euclid(FOUR_CENTURIES);
    let year_len = |year| if is_leap(year) { 366 } else { 365 };
    while left >= year_len(year) {
        left -= year_len(year);
        year += 1;
    }
    let mut month = 1;
    while left >= days_in(year, month) {
        left -= days_in(year, month);
        month += 1;
    }
    (year, month, left + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_moments() {
        // `date -u -d @N +%FT%TZ`
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_868_799, "2000-02-29T23:59:59Z"),
            (951_868_800, "2000-03-01T00:00:00Z"),
            (1_767_225_599, "2025-12-31T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
            (-1, "1969-12-31T23:59:59Z"),
            (-2_208_988_800, "1900-01-01T00:00:00Z"),
        ] {
            let made = Timestamp::from_unix_seconds(seconds);
            assert_eq!(made.to_string(), text);
            assert_eq!(Timestamp::parse(text), Ok(made));
        }
        for far in [i64::MIN, i64::MAX] {
            let text = Timestamp::from_unix_seconds(far).to_string();
            assert!(Timestamp::parse(&text).is_ok(), "{text}");
        }
    }

    #[test]
    fn other_texts_are_refused() {
        assert!(Timestamp::parse("2026-01-31").is_ok());
        for text in [
            "",
            "yesterday",
            "2026-1-31",
            "2026-02-29",
            "2026-13-01",
            "2026-00-10",
            "+026-01-01",
            "2026-01-31T24:00:00Z",
            "2026-01-31T12:00:00",
            "2026-01-31T12:00:00+01:00",
            "2026-01-31T12:00Z",
            "2026-01-31Z",
        ] {
            assert_eq!(Timestamp::parse(text), Err(TimestampError), "{text}");
        }
    }
}
