//! The protocol of the paper [plmap2025] on its two data sets: which pictures teach and test, our figures beside the published
//! ones, times, and what single parts contribute.
//!
//! * **In**: a data set's folder with a folder for each scene; **out**: tables in Markdown, one result file a scene.
//! * **Invariants**: a result is used again only where pictures, poses, extractor and options are the same.

mod measure;
mod published;
mod tables;

pub use measure::{Measured, measure, resumed};
pub use tables::tables;

use crate::dataset::{DataArgs, Dataset, DatasetError, Format, Split, open};
use landline::geometry::Units;
use published::Scene;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The data sets that the paper reports on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DataSet {
    /// 7-Scenes as shipped: `SCENE/seq-01/frame-000000.{color.png,pose.txt}`, `TrainSplit.txt`, `TestSplit.txt`.
    SevenScenes,
    /// Indoor-6: `SCENE/images/NAME.{color.jpg,pose.txt,intrinsics.txt}`, `train_test_val.pkl`.
    Indoor6,
}

/// Whose poses teach and are compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Poses {
    /// Structure from motion; the paper does not report on these.
    Sfm,
    /// As the data set ships them: what the published figures are on.
    Shipped,
}

impl Poses {
    /// For file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sfm => "sfm",
            Self::Shipped => "shipped",
        }
    }
}

/// Why a scene cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// No such scene.
    #[error("{set:?} has no scene {found}; it has {known}")]
    Unknown {
        /// The data set.
        set: DataSet,
        /// What was asked for.
        found: String,
        /// What there is.
        known: String,
    },
    /// Nothing to work on.
    #[error("{root} has none of the scenes' folders {known}")]
    NoScene {
        /// The data set's folder.
        root: PathBuf,
        /// What was looked for.
        known: String,
    },
    /// The scene's folder.
    #[error(transparent)]
    Data(#[from] DatasetError),
    /// The split of the data set is missing.
    #[error(
        "{root}: {num_train} pictures teach and {num_test} test; the protocol needs the data set's own split ({file})"
    )]
    Split {
        /// The scene's folder.
        root: PathBuf,
        /// Pictures that teach.
        num_train: usize,
        /// Pictures that test.
        num_test: usize,
        /// What says which.
        file: &'static str,
    },
    /// Lists of poses.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

impl DataSet {
    fn scenes(self) -> &'static [Scene] {
        match self {
            Self::SevenScenes => published::SEVEN_SCENES,
            Self::Indoor6 => published::INDOOR6,
        }
    }

    fn known(self) -> String {
        let names: Vec<&str> = self.scenes().iter().map(|s| s.folder).collect();
        names.join(", ")
    }

    /// The scenes to work on, in the paper's order: the named ones, or those whose folders are there.
    ///
    /// # Errors
    /// When a name is none of the data set's, or no folder is there.
    pub fn chosen(self, root: &Path, names: &[String]) -> Result<Vec<&'static str>, PaperError> {
        let scenes = self.scenes();
        if let Some(found) = names
            .iter()
            .find(|n| scenes.iter().all(|s| s.folder != **n))
        {
            return Err(PaperError::Unknown {
                set: self,
                found: found.clone(),
                known: self.known(),
            });
        }
        let is_wanted = |s: &&Scene| {
            if names.is_empty() {
                root.join(s.folder).is_dir()
            } else {
                names.iter().any(|n| n == s.folder)
            }
        };
        let chosen: Vec<&str> = scenes.iter().filter(is_wanted).map(|s| s.folder).collect();
        if chosen.is_empty() {
            return Err(PaperError::NoScene {
                root: root.to_owned(),
                known: self.known(),
            });
        }
        Ok(chosen)
    }

    /// Opens a scene with its own split; `list` has poses in place of the shipped ones.
    ///
    /// # Errors
    /// When it cannot be read, or does not say which pictures test.
    pub fn open(
        self,
        root: &Path,
        scene: &str,
        list: Option<&Path>,
    ) -> Result<Dataset, PaperError> {
        let (format, file) = match self {
            Self::SevenScenes => (Format::SevenScenes, "TestSplit.txt"),
            Self::Indoor6 => (Format::Indoor6, "train_test_val.pkl"),
        };
        let folder = root.join(scene);
        let dataset = open(&DataArgs {
            format: list.is_none().then_some(format),
            poses: list.map(Path::to_owned),
            units: list.is_some().then_some(Units::Metres),
            ..DataArgs::of(folder.clone())
        })?;
        let count = |split| dataset.of_split(split).len();
        let (num_train, num_test) = (count(Split::Train), count(Split::Test));
        if num_train < 2 || num_test == 0 {
            return Err(PaperError::Split {
                root: folder,
                num_train,
                num_test,
                file,
            });
        }
        Ok(dataset)
    }
}

/// One list of the poses that `SCENE_train.txt` and `SCENE_test.txt` of a folder hold, as the published structure-from-motion poses
/// of 7-Scenes come; `None` where the folder has none of this scene.
///
/// # Errors
/// When a file cannot be read or written.
pub fn joined_poses(folder: &Path, scene: &str, to: &Path) -> Result<Option<PathBuf>, PaperError> {
    let mut text = String::new();
    for part in ["train", "test"] {
        let path = folder.join(format!("{scene}_{part}.txt"));
        if !path.is_file() {
            return Ok(None);
        }
        let read =
            std::fs::read_to_string(&path).map_err(|source| PaperError::Io { path, source })?;
        text.push_str(read.trim_end());
        text.push('\n');
    }
    let io = |source| PaperError::Io {
        path: to.to_owned(),
        source,
    };
    let to = std::path::absolute(to).map_err(io)?;
    crate::files::write_bytes(&to, text.as_bytes()).map_err(io)?;
    Ok(Some(to))
}
