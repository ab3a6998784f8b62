//! Pictures of a folder: which can be read, and which are of formats that no decoder here knows.

use super::has_known_ending;
use crate::files;
use std::io;
use std::path::{Path, PathBuf};

/// Endings of formats that are pictures to people and are not decoded here, with their names.
const UNDECODED: [(&str, &str); 6] = [
    ("heic", "HEIC"),
    ("heif", "HEIC"),
    ("hif", "HEIC"),
    ("avif", "AVIF"),
    ("jxl", "JPEG XL"),
    ("dng", "raw (DNG)"),
];

/// The format of a file by its ending, where that is one that is not decoded here.
pub fn undecoded_ending(path: &Path) -> Option<&'static str> {
    let ending = path.extension()?.to_string_lossy().to_ascii_lowercase();
    let found = UNDECODED.iter().find(|(known, _)| *known == ending);
    found.map(|(_, format)| *format)
}

/// Whether a file is called like a picture, be it one that is read here or not.
pub fn is_called_picture(path: &Path) -> bool {
    has_known_ending(path) || undecoded_ending(path).is_some()
}

/// Whether a path is a video, by its ending.
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    let known = ["mp4", "mov", "m4v", "mkv", "webm", "avi", "3gp"];
    path.is_file() && known.iter().any(|e| extension == *e)
}

/// What a folder holds, not below it, in the order of the names.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Listed {
    /// Called like pictures that can be read.
    pub pictures: Vec<PathBuf>,
    /// Called like pictures that cannot, with their format.
    pub undecoded: Vec<(PathBuf, &'static str)>,
    /// Folders that are not hidden.
    pub folders: Vec<PathBuf>,
}

impl Listed {
    /// Whether nothing in it is called like a picture.
    pub fn is_empty(&self) -> bool {
        self.pictures.is_empty() && self.undecoded.is_empty()
    }

    /// What else is there where no picture can be used, for a sentence: pictures that are not decoded, or lie in folders
    /// below.
    pub fn instead(&self) -> String {
        if let [(first, format), rest @ ..] = self.undecoded.as_slice() {
            let name = first.file_name().unwrap_or_default().to_string_lossy();
            return format!(
                "{} that cannot be decoded ({name}): {}",
                counted(rest.len() + 1, "picture"),
                super::not_decoded(format)
            );
        }
        let below = self.folders.iter().find_map(|folder| {
            let inside = listed(folder).ok()?.pictures.len();
            (inside > 0).then_some((folder, inside))
        });
        match below {
            Some((folder, inside)) => format!(
                "{} in its folder {}: give that one",
                counted(inside, "picture"),
                folder.display()
            ),
            None => "no pictures in it".to_owned(),
        }
    }
}

/// `1 picture`, `2 pictures`.
pub fn counted(num: usize, what: &str) -> String {
    format!("{num} {what}{}", if num == 1 { "" } else { "s" })
}

/// `.DS_Store` and the like.
pub fn is_hidden(path: &Path) -> bool {
    path.file_name()
        .is_none_or(|name| name.to_string_lossy().starts_with('.') || name == "Thumbs.db")
}

/// Lists a folder; hidden files count for nothing.
///
/// # Errors
/// Of the operating system, with the path in the text.
pub fn listed(folder: &Path) -> io::Result<Listed> {
    let mut found = Listed::default();
    for path in files::entries(folder)? {
        if is_hidden(&path) {
            continue;
        }
        if path.is_dir() {
            found.folders.push(path);
        } else if has_known_ending(&path) {
            found.pictures.push(path);
        } else if let Some(format) = undecoded_ending(&path) {
            found.undecoded.push((path, format));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endings_of_telephones_are_pictures_that_are_not_decoded() {
        let of = |name: &str| undecoded_ending(Path::new(name));
        assert_eq!(of("a/IMG_1.HEIC"), Some("HEIC"));
        assert_eq!(of("b.avif"), Some("AVIF"));
        assert_eq!(
            (of("b.jpg"), of("heic"), of("notes.txt")),
            (None, None, None)
        );
        assert_eq!(
            (counted(1, "picture"), counted(2, "picture")),
            ("1 picture".into(), "2 pictures".into())
        );
    }
}
