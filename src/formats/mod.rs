//! Files of other tools that say where pictures were taken and by which camera: pose lists, COLMAP models, matrices.
//!
//! * **In and out**: bytes or text of a file; names, poses and cameras, one by one as the file has them. Which pictures there are,
//!   and what to do about one that is not, is the caller's matter: the native tool has folders, a page has what was dropped on it
//!   ([`known::known_poses`]).
//! * **Spaces and units**: everything comes out in our conventions, `cam_from_world`, OpenCV axes, corner-based pixels; lengths are
//!   the file's.
//! * **Errors**: a [`FormatError`] names file, place and what was expected; a pose that is none drops its picture with a
//!   [`PoseProblem`].

mod camera;
pub mod colmap;
pub mod known;
pub mod list;
mod matrix;
mod names;
mod rigid;
mod text;

pub use camera::{CameraRecordError, MAX_FIT_ERROR_PX, colmap_model, expressed};
pub use matrix::{matrix, of_color_camera};
pub use names::{Found, Names, plain};
pub use rigid::{
    PoseDirection, PoseProblem, QuaternionOrder, block_and_translation, rigid_from_matrix,
    rigid_from_quaternion,
};
pub use text::{LFS_START, Line, TextFile};

/// A file that is not what it should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}{place}: {what}", if place.is_empty() { "" } else { ", " })]
pub struct FormatError {
    /// The file.
    pub file: String,
    /// Line or byte; empty where the whole file is meant.
    pub place: String,
    /// What was found and what was expected.
    pub what: String,
}

impl FormatError {
    /// A place in a file; empty for the whole of it.
    pub fn at(file: &str, place: impl ToString, what: impl ToString) -> Self {
        Self {
            file: file.to_owned(),
            place: place.to_string(),
            what: what.to_string(),
        }
    }

    fn whole(file: &str, what: impl ToString) -> Self {
        Self::at(file, "", what)
    }
}
