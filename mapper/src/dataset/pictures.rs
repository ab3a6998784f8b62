//! Where the pictures of a data set are.

use super::{Dataset, DatasetError};
use crate::picture::{self, is_hidden};
use landline::formats::{Found, LFS_START, Names, plain};
use std::cell::OnceCell;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Folders beside the poses that hold pictures by custom; scaled copies of gaussian splatting tools come last.
const FOLDERS: [&str; 11] = [
    "",
    "rgb",
    "images",
    "pictures",
    "input",
    "../images",
    "../../images",
    "../../input",
    "images_2",
    "images_4",
    "images_8",
];

/// More files than this are no folder of pictures, but somebody's disk.
const MAX_FILES: usize = 500_000;
/// How deep folders are searched for a name that is not where the list says.
const MAX_DEPTH: usize = 6;

/// Why a picture that is nowhere is dropped.
pub(super) const MISSING: &str = "picture is missing";

/// Where pictures of a data set may lie.
pub(super) struct Pictures {
    folders: Vec<PathBuf>,
    /// All pictures below each of the folders, listed when a name is not simply there.
    all: OnceCell<Vec<(Names, Vec<PathBuf>)>>,
}

/// A picture that was found.
pub(super) struct FoundPicture {
    /// As the data set calls it, with forward slashes and its ending.
    pub(super) name: String,
    /// The file.
    pub(super) path: PathBuf,
    /// Width and height, upright.
    pub(super) size: (u32, u32),
    /// Width and height of the pixels as stored, where EXIF turns them.
    pub(super) stored: Option<(u32, u32)>,
}

impl Pictures {
    pub(super) fn new(root: &Path, given: Option<&Path>) -> Result<Self, DatasetError> {
        let folders = match given {
            Some(folder) => {
                std::fs::metadata(folder).map_err(DatasetError::io(folder))?;
                vec![folder.to_owned()]
            }
            None => FOLDERS
                .iter()
                .map(|f| root.join(f))
                .filter(|f| f.is_dir())
                .collect(),
        };
        Ok(Self {
            folders,
            all: OnceCell::new(),
        })
    }

    /// Where was looked, for people.
    pub(super) fn folders(&self) -> String {
        let shown: Vec<String> = self
            .folders
            .iter()
            .map(|f| f.display().to_string())
            .collect();
        shown.join(", ")
    }

    /// The file of a picture and its upright size. What cannot be found or read is noted as dropped.
    pub(super) fn find(&self, name: &str, dataset: &mut Dataset) -> Option<FoundPicture> {
        let name = plain(name);
        let at = self.folders.iter().map(|f| f.join(&name));
        let (name, path) = match at.into_iter().find(|p| p.is_file()) {
            Some(path) => (name, path),
            None => match self.search(&name) {
                Ok(path) => (found_name(&name, path), path.to_owned()),
                Err(reason) => {
                    dataset.drop_image(name, reason);
                    return None;
                }
            },
        };
        match picture::size(&path) {
            Ok(size) => Some(FoundPicture {
                name,
                path,
                size: size.upright,
                stored: (size.quarter_turns != 0).then_some(size.stored),
            }),
            Err(e) => {
                let reason = if is_lfs_pointer(&path) {
                    "picture is a Git LFS pointer; run `git lfs pull`".to_owned()
                } else {
                    format!("picture cannot be read: {}", e.short())
                };
                dataset.drop_image(name, reason);
                None
            }
        }
    }
}

impl Pictures {
    /// A picture that is not simply there: in a folder below, with another ending, or with a path of another machine.
    fn search(&self, name: &str) -> Result<&Path, &'static str> {
        let all = self
            .all
            .get_or_init(|| self.folders.iter().map(|f| list_pictures(f)).collect());
        let mut reason = MISSING;
        // The root, which comes first and holds all others, says least.
        let (root, inner) = all.split_at(usize::from(all.len() > 1));
        for (names, paths) in inner.iter().chain(root) {
            match names.find(name) {
                Found::One(position) => {
                    if let Some(path) = paths.get(position) {
                        return Ok(path);
                    }
                }
                Found::Several(_) => reason = "several pictures fit the name; write its folder",
                Found::Nothing => {}
            }
        }
        Err(reason)
    }
}

/// What a picture is called that lies elsewhere, or ends differently, than its list says: as the list says, as far as the
/// file agrees, with the file's ending.
fn found_name(written: &str, path: &Path) -> String {
    let path = plain(&path.to_string_lossy());
    let written: Vec<&str> = written.split('/').collect();
    let own: Vec<&str> = path.split('/').collect();
    // The last part is the file; before it, as many folders as are equal.
    let equal = written
        .iter()
        .rev()
        .zip(own.iter().rev())
        .skip(1)
        .take_while(|(a, b)| a == b)
        .count();
    own[own.len().saturating_sub(1 + equal)..].join("/")
}

/// Pictures below a folder, by the endings that are read, with names relative to it.
fn list_pictures(folder: &Path) -> (Names, Vec<PathBuf>) {
    let mut names = Vec::new();
    let mut paths: Vec<PathBuf> = Vec::new();
    let mut open = vec![(folder.to_owned(), 0)];
    while let Some((at, depth)) = open.pop() {
        let Ok(entries) = std::fs::read_dir(&at) else {
            continue;
        };
        for entry in entries.flatten() {
            let path = entry.path();
            if is_hidden(&path) || paths.len() >= MAX_FILES {
                continue;
            }
            // Links to folders may lead in circles; those are not followed.
            if entry.file_type().is_ok_and(|t| t.is_dir()) {
                if depth < MAX_DEPTH {
                    open.push((path, depth + 1));
                }
            } else if picture::has_known_ending(&path) {
                let relative = path.strip_prefix(folder).unwrap_or(&path);
                names.push(relative.to_string_lossy().into_owned());
                paths.push(path);
            }
        }
    }
    (Names::new(names.iter().map(String::as_str)), paths)
}

/// Whether a pointer of Git LFS stands where a file was not fetched.
fn is_lfs_pointer(path: &Path) -> bool {
    let mut start = [0; LFS_START.len()];
    std::fs::File::open(path).is_ok_and(|mut file| file.read_exact(&mut start).is_ok())
        && start == *LFS_START
}

/// Files of a folder, sorted, without hidden ones.
pub(super) fn list_files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(DatasetError::io(folder))? {
        let path = entry.map_err(DatasetError::io(folder))?.path();
        if path.is_file() && !is_hidden(&path) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}
