//! A map from pictures: views with features, matches, points and lines in space with what sees them.
//!
//! * **In and out**: [`View`]s go in; [`PointTrack`]s and [`LineTrack`]s whose [`Observation`]s point back into them come
//!   out, together a [`Reconstruction`].
//! * **Spaces and units**: pixels of a view are those of its features. Inside, every keypoint and segment end is kept as
//!   (x / z, y / z) in camera space ([`PosedView`]), and errors are multiplied by the focal length, so that they read as pixels
//!   for every camera model. World coordinates are those of the poses.
//! * **Method**: pairs by view overlap ([`choose_pairs`]), mutual nearest neighbours under the epipolar geometry
//!   ([`match_pairs`]), robust triangulation with completion and merging ([`build_point_tracks`], [`build_line_tracks`]).
//! * **Invariants**: no files, no networks, no clock; threads only where the feature `parallel` is on, and results do not depend
//!   on their number. Geometry is f64 without fused operations; descriptors are compared in f32 by the matrix kernels of
//!   `nn`, whose last digit differs between instruction sets.
//! * **Cost**: matching grows with pairs x keypoints^2 x descriptor; nothing holds a second copy of the descriptors.

pub mod bundle;
mod convention;
mod cover;
mod five_point;
mod focal;
mod lines;
mod matching;
pub mod motion;
mod pairs;
mod planes;
mod points;
mod relative;
mod robust;
mod track;
mod triangulate;
mod two_view;
mod vertical;
mod view;
mod watch;

pub use convention::{ConventionCheck, Misreading, agreement, check_convention};
pub use cover::cover;
pub use focal::{FOCAL_PRIOR, FOCAL_RANGE, FocalVote, vote_focal};
pub use lines::{KnownLine, LineParams, assign_segments, build_line_tracks, line_pairs};
pub use matching::{
    Match, MatchParams, MutualMatcher, epipolar_distance, essential, match_pairs, mutual_neighbours,
};
pub use pairs::{PairParams, choose_pairs, probe_depth};
pub use points::{PointParams, build_point_tracks};
pub use track::{
    LineTrack, Observation, PointTrack, Reconstruction, SegmentTarget, ViewTargets, describe_lines,
    describe_points,
};
pub use triangulate::{Bundle, Ray};
pub use two_view::{TwoView, TwoViewKind, TwoViewParams, Uncalibrated, two_view, uncalibrated};
pub use vertical::{NoVertical, Vertical, vertical};
pub use view::{PosedView, View, planar_from_pixel};
pub(crate) use watch::PIECE;
pub use watch::{Observer, Pause, Stage, Watch};
