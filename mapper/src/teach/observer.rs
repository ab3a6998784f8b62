//! What happens while a place is taught, for who wants to know.

use super::Turned;
use crate::labels::VariantStats;
use crate::progress::Progress;
#[cfg(feature = "train")]
use crate::train::run::Trained;
use landline::landmarks::LandmarkTable;
use landline::mapping::TrackStats;
use landline::reconstruction::{NoVertical, Vertical};
use landline::scene_file::{HeldOut, Units};

/// Something that happened.
#[derive(Debug)]
pub enum Event<'a> {
    /// All pictures have features.
    Features {
        /// So many.
        pictures: usize,
        /// It took.
        seconds: f64,
    },
    /// How poses of pictures that EXIF turns are read.
    Turned(&'a Turned),
    /// Segments were asked which way is up.
    Up(&'a Result<Vertical, NoVertical>),
    /// Points and lines are triangulated.
    Labels {
        /// About them.
        stats: &'a TrackStats,
        /// It took.
        seconds: f64,
    },
    /// Changed copies of the pictures have labels.
    Variants(&'a VariantStats),
    /// Networks that are landmarks were measured on pictures that they do not know.
    Untrained {
        /// How well they do.
        held_out: &'a HeldOut,
        /// Of its lengths.
        units: Units,
    },
    /// Networks are trained.
    #[cfg(feature = "train")]
    Trained {
        /// What training found.
        trained: &'a Trained,
        /// Of its lengths.
        units: Units,
    },
    /// The landmarks that are looked at again are chosen.
    Landmarks(&'a LandmarkTable),
}

/// Is told what happens.
pub trait Observer {
    /// Where bars of progress go.
    fn progress(&self) -> Progress {
        Progress::Hidden
    }

    /// Something happened.
    fn happened(&mut self, event: &Event<'_>);
}

/// Does not want to know.
impl Observer for () {
    fn happened(&mut self, _: &Event<'_>) {}
}
