//! Data sets of other tools, turned into one type: pictures with cameras and poses in our conventions.
//!
//! Every reader ends here: corner-based pixels, `cam_from_world`, OpenCV axes, the file's own length unit. What a reader
//! could not use is not skipped in silence: it is in [`Dataset::dropped`] with the reason, and the import table prints it.

mod ace;
mod args;
mod cameras;
mod colmap;
mod colmap_write;
mod finish;
mod indoor6;
mod limap;
mod open;
mod pictures;
mod pose_list;
mod segment_scale;
mod seven_scenes;
mod split;
mod table;
mod text;
mod transforms;
mod tum;
mod world;

pub use args::{DataArgs, Format, OneOnly, PoseCamera, Up, parse_camera, parse_vector, units};
pub use colmap_write::{MODEL_FILES, WrittenImage, WrittenModel, WrittenPoint};
pub use open::{has_poses, open};
pub use split::{IndexRange, Split};
pub use world::{check_scale, gravity_from_up};

use landline::formats::FormatError;
use landline::geometry::{CamFromWorld, Camera, CameraAxes};
use landline::scene_file::Units;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// One picture of a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct DatasetImage {
    /// As the data set calls it; unique.
    pub name: String,
    /// Where the picture lies.
    pub path: PathBuf,
    /// Of the picture as stored, after its EXIF rotation.
    pub camera: Camera,
    /// From the data set; a query list has none.
    pub cam_from_world: Option<CamFromWorld>,
    /// What the data set says this picture is for.
    pub split: Split,
}

/// Something of the data set that is not used, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dropped {
    /// A picture's name, or what else the entry is.
    pub name: String,
    /// One of few fixed texts, so that the table can count them.
    pub reason: String,
}

/// A point of a structure-from-motion model with the pixels that see it.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelPoint {
    /// In the data set's world.
    pub point_in_world: nalgebra::Vector3<f64>,
    /// Index of the picture and corner-based pixel in it.
    pub observations: Vec<(usize, landline::geometry::Pixel)>,
}

/// A 3D segment of a line map with the image segments that see it.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelLine {
    /// One end.
    pub start_in_world: nalgebra::Vector3<f64>,
    /// The other end.
    pub end_in_world: nalgebra::Vector3<f64>,
    /// Index of the picture and of the segment in its list.
    pub observations: Vec<(usize, usize)>,
}

/// A picture that EXIF turns, whose camera took its size from the picture: whether its pose is of the stored or of the
/// upright pixels the data does not say. The data set has it as of upright ones; this is the other reading.
#[derive(Debug, Clone, PartialEq)]
pub struct Undecided {
    /// Index of the picture.
    pub image: usize,
    /// Of the upright picture, if the file means the stored one.
    pub camera: Camera,
    /// The same of the pose.
    pub cam_from_world: Option<CamFromWorld>,
}

/// Pictures with cameras and poses, and what came with them.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// The format that was read.
    pub format: &'static str,
    /// Files that were read, for the table.
    pub sources: Vec<PathBuf>,
    /// Sorted by name.
    pub images: Vec<DatasetImage>,
    /// What is not used.
    pub dropped: Vec<Dropped>,
    /// Remarks for the table: guesses, choices, corrections.
    pub notes: Vec<String>,
    /// Points of a model, when it has some.
    pub points: Vec<ModelPoint>,
    /// Lines of a line map, when one was given.
    pub lines: Vec<ModelLine>,
    /// Segments per picture that came with a line map, corner-based: start x, y, end x, y.
    pub segments: Option<Vec<Vec<[f64; 4]>>>,
    /// Metres where the format defines them or the user said so.
    pub units: Units,
    /// Direction of gravity in the world, a unit vector, if the format or the user says it.
    pub gravity: Option<nalgebra::Vector3<f64>>,
    /// Whether the pictures' segments are to say it.
    pub is_up_asked: bool,
    /// Where the axes of the camera point in the file.
    pub camera_axes: CameraAxes,
    /// Poses are used as they are, even where the pictures contradict them.
    pub trust_poses: bool,
    /// Turned pictures that can be read in two ways.
    pub undecided: Vec<Undecided>,
    /// Cameras of the stored pixels of turned pictures, by name, until the pictures are fitted.
    stored_cameras: HashMap<String, Camera>,
}

impl Dataset {
    /// One without pictures, to be filled.
    pub fn empty(format: &'static str) -> Self {
        Self {
            format,
            sources: Vec::new(),
            images: Vec::new(),
            dropped: Vec::new(),
            notes: Vec::new(),
            points: Vec::new(),
            lines: Vec::new(),
            segments: None,
            units: Units::Arbitrary,
            gravity: None,
            is_up_asked: false,
            camera_axes: CameraAxes::OPENCV,
            trust_poses: false,
            undecided: Vec::new(),
            stored_cameras: HashMap::new(),
        }
    }

    fn drop_image(&mut self, name: impl Into<String>, reason: impl Into<String>) {
        self.dropped.push(Dropped {
            name: name.into(),
            reason: reason.into(),
        });
    }

    /// A remark that many pictures share.
    fn note_once(&mut self, note: Option<String>) {
        if let Some(note) = note.filter(|n| !self.notes.contains(n)) {
            self.notes.push(note);
        }
    }

    fn note_stored(&mut self, name: &str, camera: Option<Camera>) {
        self.stored_cameras
            .extend(camera.map(|camera| (name.to_owned(), camera)));
    }

    /// Positions of the pictures of a split.
    pub fn of_split(&self, split: Split) -> Vec<usize> {
        (0..self.images.len())
            .filter(|i| self.images[*i].split == split)
            .collect()
    }
}

/// Why a data set cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The operating system refused.
    #[error("cannot read {path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file does not parse.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Nothing that a reader knows.
    #[error(
        "{path} is no data set that this tool knows: {what}. It reads COLMAP models, transforms.json, 7-Scenes and \
         Indoor-6 folders, TUM RGB-D folders, pose lists (name qw qx qy qz tx ty tz [f]) and hloc query lists; \
         `--format` forces one. `landline map` and `landline poses` take a folder of pictures or a video without poses too"
    )]
    UnknownFormat {
        /// What was given.
        path: PathBuf,
        /// What was looked for.
        what: String,
    },
    /// Pictures without poses, for something that needs these.
    #[error(
        "{path} has no poses ({what}), and here they are needed: `landline poses {path} --out DIR` finds them; then give DIR \
         in its place, with `--pictures {pictures}`. `landline map` finds them by itself"
    )]
    NoPoses {
        /// Folder or video.
        path: PathBuf,
        /// What is there.
        what: String,
        /// Where its pictures are once it has poses.
        pictures: PathBuf,
    },
    /// A picture in place of a data set.
    #[error("{0} is a picture: give the folder that holds the pictures")]
    OnePicture(PathBuf),
    /// The format needs something that is not there.
    #[error("{path}: {what}")]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
        /// What is missing and how to give it.
        what: String,
    },
    /// A value of the command line that means nothing for this data set.
    #[error("{path}: {option} is {value}: {reason}")]
    Option {
        /// The data set.
        path: PathBuf,
        /// As it is written on the command line.
        option: &'static str,
        /// What was given.
        value: String,
        /// What it should be.
        reason: &'static str,
    },
    /// Nothing left to work with.
    #[error("{path}: no usable picture: {what}")]
    NoPictures {
        /// The data set.
        path: PathBuf,
        /// Counts of the reasons.
        what: String,
    },
    /// `--train` or `--test` does not fit.
    #[error("{0}")]
    Split(String),
}

impl DatasetError {
    fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    fn parse(path: &Path, place: impl ToString, what: impl ToString) -> Self {
        FormatError::at(&path.display().to_string(), place, what).into()
    }

    fn missing(path: &Path, what: impl ToString) -> Self {
        Self::Missing {
            path: path.to_owned(),
            what: what.to_string(),
        }
    }
}
