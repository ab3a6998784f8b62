//! From a film to a scene: which frames it is made of, where they were taken, what they show in space, what locates there.
//!
//! * **In and out**: frames go through [`KeyframeChoice`]; the [`View`](crate::reconstruction::View)s that were kept ([`Film`]) become a
//!   [`FilmMap`] ([`map_film`]) and that a scene file ([`FilmMap::scene`]). With poses that are known the parts serve alone:
//!   [`point_tracks`], [`line_tracks`], [`landmark_networks`], [`add_landmarks`].
//! * **Spaces and units**: those of `reconstruction`; a film without poses has a world of its own in arbitrary units.
//! * **Invariants**: no files, no networks that are trained, no clock; threads only with `parallel`. The same keyframes give
//!   the same scene.
//! * **Cost**: see `reconstruction`. Features are held once. Long work tells an
//!   [`Observer`](crate::reconstruction::Observer), which may stop it; keyframes stay usable then.

mod film;
mod given;
mod keyframes;
mod labels;
mod recorder;
mod scene;
mod tracks;

pub use film::{FilmError, FilmMap, FilmParams, MIN_PICTURES, map_film};
pub use given::{Adjusted, PoseSource};
pub use keyframes::{Advice, Exposure, KeyframeChoice, KeyframeParams, NotKept, Verdict};
pub use labels::{
    LABEL_FORMAT, LABEL_VERSION, LabelHeader, LabelSource, LabelSourceError, LabelTensor,
    LabelledPicture,
};
pub use recorder::{DistanceError, Film, FrameCamera, FrameInfo, KnownDistance};
pub use scene::{
    Networks, Origin, SceneError, SceneRequest, add_landmarks, landmark_networks, scene_of,
};
pub use tracks::{TrackError, TrackParams, TrackStats, check_poses, line_tracks, point_tracks};
