//! Which pictures teach and which ones test.

use super::text::TextFile;
use super::{Dataset, DatasetError};
use std::collections::HashSet;
use std::path::Path;
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

/// Lists of test pictures that lie beside a structure-from-motion model by custom (hloc, PL2Map).
const LISTS: [&str; 3] = [
    "list_test.txt",
    "query_list_with_intrinsics.txt",
    "queries_with_intrinsics.txt",
];

/// Applies the first of the customary lists that is in one of the folders.
pub(super) fn apply_lists_beside(
    folders: &[&Path],
    dataset: &mut Dataset,
) -> Result<(), DatasetError> {
    let found = folders
        .iter()
        .flat_map(|folder| LISTS.iter().map(|list| folder.join(list)))
        .find(|path| path.is_file());
    match found {
        Some(path) => {
            apply_list(&path, dataset)?;
            dataset
                .notes
                .push(format!("test pictures from {}", path.display()));
            Ok(())
        }
        None => Ok(()),
    }
}

/// Pictures that a list names test, all others teach. A line is a name, or a query (`name MODEL width height ...`); names
/// may lack their folders.
pub(super) fn apply_list(path: &Path, dataset: &mut Dataset) -> Result<(), DatasetError> {
    let file = TextFile::read(path)?;
    let names: HashSet<&str> = file
        .lines()
        .flat_map(|line| [Some(line.text), line.text.split_whitespace().next()])
        .flatten()
        .collect();
    let mut num_tests = 0;
    for image in &mut dataset.images {
        let basename = image.name.rsplit('/').next().unwrap_or(&image.name);
        let is_listed = names.contains(image.name.as_str()) || names.contains(basename);
        num_tests += usize::from(is_listed);
        image.split = if is_listed { Split::Test } else { Split::Train };
    }
    if num_tests == 0 {
        return Err(DatasetError::missing(
            path,
            "none of the pictures that it names is in the data set",
        ));
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
