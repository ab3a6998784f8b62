//! Which pictures teach and which ones test.

use super::text::read_text;
use super::{Dataset, DatasetError};
use landline::formats::list::model_at;
use landline::formats::{Found, Names, TextFile};
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

/// Applies the first of the customary lists that is in one of the folders. One that names none of the pictures is of
/// queries without poses and splits nothing.
pub(super) fn apply_lists_beside(
    folders: &[&Path],
    dataset: &mut Dataset,
) -> Result<(), DatasetError> {
    let found = folders
        .iter()
        .flat_map(|folder| LISTS.iter().map(|list| folder.join(list)))
        .find(|path| path.is_file());
    let Some(path) = found else { return Ok(()) };
    let listed = listed_names(&read_text(&path)?);
    let known = KnownNames::new(dataset);
    if listed.iter().all(|name| known.of_image(name).is_none()) {
        dataset.notes.push(format!(
            "{} names none of the pictures: it splits nothing",
            path.display()
        ));
        return Ok(());
    }
    apply_names(&path, &listed, dataset)?;
    dataset
        .notes
        .push(format!("test pictures from {}", path.display()));
    Ok(())
}

/// Pictures that a list names test, all others teach. A line is a name, or a query (`name MODEL width height ...`); how
/// names may be written is said in [`super::names`].
///
/// # Errors
/// When a name is of no picture of the data set, or of several.
pub(super) fn apply_list(path: &Path, dataset: &mut Dataset) -> Result<(), DatasetError> {
    let listed = listed_names(&read_text(path)?);
    apply_names(path, &listed, dataset)
}

fn listed_names(file: &TextFile) -> Vec<String> {
    file.lines()
        .map(|line| match model_at(&line.fields()) {
            Some(at) => line.split_at(at).0.to_owned(),
            None => line.text.to_owned(),
        })
        .collect()
}

fn apply_names(path: &Path, listed: &[String], dataset: &mut Dataset) -> Result<(), DatasetError> {
    let tests = KnownNames::new(dataset).positions(path, listed)?;
    if tests.is_empty() {
        return Err(DatasetError::missing(
            path,
            "none of the pictures that it names can be used",
        ));
    }
    for (position, image) in dataset.images.iter_mut().enumerate() {
        image.split = if tests.contains(&position) {
            Split::Test
        } else {
            Split::Train
        };
    }
    Ok(())
}

/// Names of a data set's pictures, and of those that it had to drop.
pub(super) struct KnownNames {
    images: Names,
    dropped: Names,
}

impl KnownNames {
    pub(super) fn new(dataset: &Dataset) -> Self {
        Self {
            images: Names::new(dataset.images.iter().map(|i| i.name.as_str())),
            dropped: Names::new(dataset.dropped.iter().map(|d| d.name.as_str())),
        }
    }

    /// The picture that a name means, if it can be used.
    fn of_image(&self, name: &str) -> Option<usize> {
        self.images.find(name).one()
    }

    /// Positions of the pictures that a list means; dropped ones have none.
    ///
    /// # Errors
    /// When a name is of no picture, used or dropped, or of several: a picture that should test would teach.
    pub(super) fn positions(
        &self,
        path: &Path,
        listed: &[String],
    ) -> Result<HashSet<usize>, DatasetError> {
        const NUM_EXAMPLES: usize = 5;
        let mut positions = HashSet::new();
        let mut wrong = Vec::new();
        for name in listed {
            match self.images.find(name) {
                Found::One(position) => drop(positions.insert(position)),
                Found::Several(n) => {
                    wrong.push(format!("{name} (fits {n} pictures; write its folder)"))
                }
                Found::Nothing if self.dropped.find(name) == Found::Nothing => {
                    wrong.push(name.clone());
                }
                Found::Nothing => {}
            }
        }
        if wrong.is_empty() {
            return Ok(positions);
        }
        let more = if wrong.len() > NUM_EXAMPLES {
            ", ..."
        } else {
            ""
        };
        let shown: Vec<&str> = wrong
            .iter()
            .map(String::as_str)
            .take(NUM_EXAMPLES)
            .collect();
        Err(DatasetError::missing(
            path,
            format!(
                "{} of the {} pictures that it names are not in the data set: {}{more}; correct the names, or give another \
                 split (--test-list, --train, --test)",
                wrong.len(),
                listed.len(),
                shown.join(", ")
            ),
        ))
    }
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
