//! Which pictures teach and which ones test.

use super::{Dataset, DatasetError};
use std::str::FromStr;

/// What a picture is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Split {
    /// Teaches the scene.
    Train,
    /// Tests the scene.
    Test,
    /// Held out by the user's ranges.
    Unused,
}

/// Positions in the sorted list of pictures, both ends included; several are separated by commas: `0-99,160-`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IndexRange(Vec<(usize, Option<usize>)>);

impl FromStr for IndexRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |s: &str| {
            s.trim().parse::<usize>().map_err(|_| {
                format!("`{s}` is not a position; write ranges like 0-799 or 0-99,160-")
            })
        };
        let parts = text
            .split(',')
            .map(|part| match part.split_once('-') {
                None => number(part).map(|n| (n, Some(n))),
                Some((from, "")) => Ok((number(from)?, None)),
                Some((from, to)) => {
                    let (from, to) = (number(from)?, number(to)?);
                    if to < from {
                        return Err(format!("`{part}` runs backwards"));
                    }
                    Ok((from, Some(to)))
                }
            })
            .collect::<Result<_, _>>()?;
        Ok(Self(parts))
    }
}

impl IndexRange {
    /// Whether a position is in one of the ranges.
    pub fn contains(&self, position: usize) -> bool {
        self.0
            .iter()
            .any(|(from, to)| *from <= position && to.is_none_or(|to| position <= to))
    }
}

/// Overwrites the data set's own split. With only one of the two given, all other pictures are of the other kind.
pub(super) fn apply(
    dataset: &mut Dataset,
    train: Option<&IndexRange>,
    test: Option<&IndexRange>,
) -> Result<(), DatasetError> {
    if train.is_none() && test.is_none() {
        return Ok(());
    }
    for (position, image) in dataset.images.iter_mut().enumerate() {
        let in_train = train.map(|r| r.contains(position));
        let in_test = test.map(|r| r.contains(position));
        image.split = match (in_train, in_test) {
            (Some(true), Some(true)) => {
                return Err(DatasetError::Split(format!(
                    "picture {position} ({}) is in --train and in --test; a picture that teaches cannot test",
                    image.name
                )));
            }
            (Some(true), _) | (None, Some(false)) => Split::Train,
            (_, Some(true)) | (Some(false), None) => Split::Test,
            _ => Split::Unused,
        };
    }
    for (name, range, split) in [
        ("--train", train, Split::Train),
        ("--test", test, Split::Test),
    ] {
        if range.is_some() && dataset.of_split(split).is_empty() {
            return Err(DatasetError::Split(format!(
                "{name} selects none of the {} pictures (positions 0 to {})",
                dataset.images.len(),
                dataset.images.len().saturating_sub(1)
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_parse_and_refuse() {
        let range: IndexRange = "0-2,7,9-".parse().expect("well formed");
        let chosen: Vec<usize> = (0..12).filter(|i| range.contains(*i)).collect();
        assert_eq!(chosen, [0, 1, 2, 7, 9, 10, 11]);
        assert!("5-3".parse::<IndexRange>().is_err());
        assert!("a-3".parse::<IndexRange>().is_err());
    }
}
