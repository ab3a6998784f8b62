//! Names of pictures, which every list writes a little differently: with or without folder and ending, with the separators
//! of another system, with a path of another machine. Which picture a name means is decided here for all readers.

use std::collections::HashMap;

/// A name with forward slashes, without `./` and byte order mark.
pub fn plain(name: &str) -> String {
    let name = name.trim_matches(|c: char| c.is_whitespace() || c == '\u{feff}');
    let parts: Vec<&str> = name
        .split(['/', '\\'])
        .enumerate()
        .filter(|(i, part)| *part != "." && (*i == 0 || !part.is_empty()))
        .map(|(_, part)| part)
        .collect();
    parts.join("/")
}

/// What equal names have in common: [`plain`], one space for a run of them, and the ending in lower case.
fn key(name: &str) -> String {
    let plain = plain(name).split_whitespace().collect::<Vec<_>>().join(" ");
    match split_ending(&plain) {
        (stem, Some(ending)) => format!("{stem}.{}", ending.to_ascii_lowercase()),
        (_, None) => plain,
    }
}

/// Splits the ending off, where there is one: up to five letters or digits after the last dot, not all digits.
fn split_ending(name: &str) -> (&str, Option<&str>) {
    match name.rsplit_once('.') {
        Some((stem, ending))
            if !stem.is_empty()
                && (1..=5).contains(&ending.len())
                && ending.chars().all(|c| c.is_ascii_alphanumeric())
                && ending.chars().any(|c| c.is_ascii_alphabetic()) =>
        {
            (stem, Some(ending))
        }
        _ => (name, None),
    }
}

/// The name and what is left of it folder by folder: `a/b/c`, `b/c`, `c`.
fn suffixes(name: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(name), |n| n.split_once('/').map(|(_, rest)| rest))
}

/// What a name means among known ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// This one, by its position.
    One(usize),
    /// Nothing.
    Nothing,
    /// So many; no way to choose.
    Several(usize),
}

impl Found {
    /// Its position, if it is one.
    pub fn one(self) -> Option<usize> {
        match self {
            Self::One(position) => Some(position),
            _ => None,
        }
    }
}

/// Known names, to be found by how a list writes them.
#[derive(Debug)]
pub struct Names {
    names: Vec<String>,
    /// Whole names and names without ending, by key.
    whole: HashMap<String, Vec<usize>>,
    /// The same for what is left without the outer folders.
    ends: HashMap<String, Vec<usize>>,
}

impl Names {
    /// Names in the order whose positions [`Names::find`] tells.
    pub fn new<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        let names: Vec<String> = names.into_iter().map(plain).collect();
        let (mut whole, mut ends) = (
            HashMap::<_, Vec<usize>>::new(),
            HashMap::<_, Vec<usize>>::new(),
        );
        for (position, name) in names.iter().enumerate() {
            let key = key(name);
            let (stem, ending) = split_ending(&key);
            for form in [Some(key.as_str()), ending.map(|_| stem)]
                .into_iter()
                .flatten()
            {
                whole.entry(form.to_owned()).or_default().push(position);
                for suffix in suffixes(form).skip(1) {
                    ends.entry(suffix.to_owned()).or_default().push(position);
                }
            }
        }
        Self { names, whole, ends }
    }

    /// Which of the known names is meant. The whole name counts first; then one that lacks its outer folders; then one
    /// that has more folders than the known name, as paths of another machine do.
    pub fn find(&self, name: &str) -> Found {
        let wanted = key(name);
        let choose = |positions: Option<&Vec<usize>>| match positions.map_or(&[][..], Vec::as_slice)
        {
            [] => Found::Nothing,
            [one] => Found::One(*one),
            // Names that differ only in what the key leaves out.
            several => several
                .iter()
                .find(|p| self.names[**p] == plain(name))
                .map_or(Found::Several(several.len()), |p| Found::One(*p)),
        };
        let found = choose(self.whole.get(&wanted));
        if found != Found::Nothing {
            return found;
        }
        let found = choose(self.ends.get(&wanted));
        if found != Found::Nothing {
            return found;
        }
        suffixes(&wanted)
            .skip(1)
            .map(|suffix| choose(self.whole.get(suffix)))
            .find(|found| *found != Found::Nothing)
            .unwrap_or(Found::Nothing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_found_however_a_list_writes_it() {
        let names = Names::new([
            "images/küche/IMG  001 (1).JPG",
            "images/a/0001.png",
            "images/b/0001.png",
            "frame.12",
            "x/frame-000003.color.png",
        ]);
        for written in [
            "images/küche/IMG  001 (1).JPG",
            "./images/küche/IMG 001 (1).jpg",
            "\u{feff}images\\küche\\IMG  001 (1)",
            "IMG 001 (1).jpg",
            "/home/maker/data/images/küche/IMG  001 (1).JPG",
            "C:\\data\\images\\küche\\IMG  001 (1).jpg",
        ] {
            assert_eq!(names.find(written), Found::One(0), "{written}");
        }
        assert_eq!(names.find("a/0001"), Found::One(1));
        assert_eq!(names.find("b//0001.PNG"), Found::One(2));
        assert_eq!(names.find("0001.png"), Found::Several(2));
        assert_eq!(names.find("c/0001.png"), Found::Nothing);
        assert_eq!(names.find("frame.12"), Found::One(3));
        assert_eq!(names.find("x/frame-000003.color"), Found::One(4));
        assert_eq!(names.find("frame-000004.color.png"), Found::Nothing);
        assert_eq!(names.find(""), Found::Nothing);
    }

    #[test]
    fn names_that_differ_only_in_spaces_are_told_apart_when_written_whole() {
        let names = Names::new(["a  b.png", "a b.png"]);
        assert_eq!(names.find("a b.png"), Found::One(1));
        assert_eq!(names.find("a  b.png"), Found::One(0));
        assert_eq!(names.find("a   b.png"), Found::Several(2));
    }
}
