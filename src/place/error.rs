//! What can be wrong with a place.

use crate::relocalizer::CreateError;
use crate::scene_file::SceneFileError;
use crate::session::SessionError;

/// Why a place, or a part of it, was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlaceError {
    /// The manifest is no JSON, or not of the form.
    #[error("the manifest cannot be read: {reason}")]
    Json {
        /// From the parser.
        reason: String,
    },
    /// JSON of something else.
    #[error("this is no place: `landline` is {found:?}, expected \"place\"")]
    Kind {
        /// What it says it is.
        found: String,
    },
    /// A version that this program does not know.
    #[error(
        "the place has format version {found}, this program reads versions up to {supported}; use a matching version of Landline"
    )]
    Version {
        /// Version of the file.
        found: u32,
        /// Newest version that is read.
        supported: u32,
    },
    /// A value that has no meaning.
    #[error("{what} is {found:?}: {reason}")]
    Value {
        /// Which.
        what: String,
        /// What it is.
        found: String,
        /// What is wrong.
        reason: &'static str,
    },
    /// More or fewer rooms than a place may have.
    #[error("the place has {found} rooms; it may have 1 to {limit}")]
    Rooms {
        /// How many.
        found: usize,
        /// Most.
        limit: usize,
    },
    /// Two rooms of one name.
    #[error("two rooms are called {id:?}")]
    DuplicateRoom {
        /// Their name.
        id: String,
    },
    /// A room that does not exist was asked for.
    #[error("there is no room {id:?}")]
    NoRoom {
        /// The name.
        id: String,
    },
    /// A neighbour that does not exist.
    #[error("room {room:?} has the neighbour {neighbour:?}, which is no room of the place")]
    NoNeighbour {
        /// The room.
        room: String,
        /// What it names.
        neighbour: String,
    },
    /// A room beside itself.
    #[error("room {room:?} is its own neighbour")]
    OwnNeighbour {
        /// The room.
        room: String,
    },
    /// A file is not the one that the manifest means.
    #[error(
        "{url} has {found_bytes} bytes and SHA-256 {found_sha256}; the place was built with {bytes} bytes and {sha256}: it is damaged, or was taught anew without `landline place add`"
    )]
    WrongFile {
        /// The file.
        url: String,
        /// Bytes that the manifest says.
        bytes: u64,
        /// Hash that the manifest says.
        sha256: String,
        /// Bytes found.
        found_bytes: u64,
        /// Hash found.
        found_sha256: String,
    },
    /// Rooms that one front end cannot serve.
    #[error(
        "room {room:?} was taught with {what} {found}, the place has {expected}: teach it anew"
    )]
    Differs {
        /// The room.
        room: String,
        /// `extractor`, `a working side of`, `sampler`.
        what: &'static str,
        /// Of the room.
        found: String,
        /// Of the place.
        expected: String,
    },
    /// A scene from which no index can be made.
    #[error("room {room:?} has no landmarks to know it by: teach it with `landline map`")]
    NoLandmarks {
        /// The room.
        room: String,
    },
    /// The index is of other rooms.
    #[error("the index knows the rooms {found:?}, the manifest {expected:?}: build the place anew")]
    IndexRooms {
        /// Of the index.
        found: Vec<String>,
        /// Of the manifest.
        expected: Vec<String>,
    },
    /// The index' file is damaged or of another kind.
    #[error("index: {0}")]
    Index(#[source] SceneFileError),
    /// A room's scene is refused.
    #[error("room {room:?}: {source}")]
    Scene {
        /// The room.
        room: String,
        /// What is wrong.
        source: CreateError,
    },
    /// The extractor is refused, or an option has no meaning.
    #[error(transparent)]
    Create(#[from] CreateError),
    /// A frame is refused.
    #[error(transparent)]
    Session(#[from] SessionError),
}

impl PlaceError {
    pub(super) fn value(
        what: impl Into<String>,
        found: impl ToString,
        reason: &'static str,
    ) -> Self {
        Self::Value {
            what: what.into(),
            found: found.to_string(),
            reason,
        }
    }
}
