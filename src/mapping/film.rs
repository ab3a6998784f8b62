//! From the keyframes of a film to a map: poses, points, lines, and from the map to a scene.

use super::given::{PoseSource, settled};
use super::labels::{LabelSource, LabelSourceError};
use super::scene::{Origin, SceneError, SceneRequest, add_landmarks, landmark_networks, scene_of};
use super::tracks::{TrackError, TrackParams, TrackStats, check_poses, line_tracks, point_tracks};
use crate::geometry::{CamFromWorld, Camera, Units};
use crate::math::stats::median_in_place;
use crate::reconstruction::motion::{
    CameraGroup, Component, Jump, LeftOut, MotionError, MotionParams, Picture, RefineParams,
    WeakLink, match_pictures, reconstruct_motion,
};
use crate::reconstruction::{
    LineTrack, Observer, PointTrack, PosedView, Reconstruction, Stage, View, Watch,
};
use crate::scene_file::SceneFile;
use nalgebra::Vector3;

/// Every setting of the way from keyframes to a map.
#[derive(Debug, Clone, PartialEq)]
pub struct FilmParams {
    /// Poses.
    pub motion: MotionParams,
    /// How far given poses are believed where the pictures contradict them; without it they are taken as they are.
    pub given: Option<RefineParams>,
    /// Points and lines.
    pub tracks: TrackParams,
}

impl Default for FilmParams {
    fn default() -> Self {
        Self {
            motion: MotionParams::default(),
            given: Some(RefineParams::default()),
            tracks: TrackParams::default(),
        }
    }
}

/// Why there is no map.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// Fewer keyframes than a map needs.
    #[error(
        "too few pictures ({found}): a map needs {MIN_PICTURES} at least that overlap, better thirty and more"
    )]
    TooFew {
        /// So many are there.
        found: usize,
    },
    /// Some keyframes have poses and some have none.
    #[error(
        "{posed} of {all} pictures have a pose: give all of them poses and intrinsics, or none"
    )]
    SomePoses {
        /// With a pose.
        posed: usize,
        /// In all.
        all: usize,
    },
    /// The camera did not move from its spot.
    #[error(
        "the camera only turned on the spot, which shows no depth: walk sideways while you film"
    )]
    OnlyTurned,
    /// What was placed shows no depth.
    #[error(
        "the pictures do not show the same things from different places ({0}): walk sideways while you film, and keep half of \
         what you saw in view; turning on the spot shows no depth"
    )]
    NoDepth(String),
    /// No poses.
    #[error(transparent)]
    Motion(MotionError),
    /// No points.
    #[error(transparent)]
    Tracks(TrackError),
    /// No scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// No label file.
    #[error("labels: {0}")]
    Labels(#[from] LabelSourceError),
    /// The observer stopped it.
    #[error("stopped")]
    Stopped,
}

impl From<MotionError> for FilmError {
    fn from(error: MotionError) -> Self {
        match error {
            MotionError::Stopped => Self::Stopped,
            other => Self::Motion(other),
        }
    }
}

impl From<TrackError> for FilmError {
    fn from(error: TrackError) -> Self {
        match error {
            TrackError::Stopped => Self::Stopped,
            TrackError::NoOverlap { what, .. } => Self::NoDepth(what),
            other => Self::Tracks(other),
        }
    }
}

/// Fewer keyframes make no map.
pub const MIN_PICTURES: usize = 3;

/// The map of a film. Observations name positions in [`Self::posed`].
#[derive(Debug, Clone, PartialEq)]
pub struct FilmMap {
    /// One for each keyframe, in their order: of one camera, but for stretches with another zoom.
    pub cameras: Vec<Camera>,
    /// Where the poses came from.
    pub source: PoseSource,
    /// One for each keyframe, in their order.
    pub cam_from_world: Vec<Option<CamFromWorld>>,
    /// Keyframes that have a pose, ascending.
    pub posed: Vec<usize>,
    /// Keyframes that have none, and why.
    pub left_out: Vec<(usize, LeftOut)>,
    /// Pieces that the film fell into; the largest is this map. 1 where poses were given.
    pub num_components: usize,
    /// Where the poses hang together by few points, in keyframes; `None` where they were given.
    pub weak_link: Option<WeakLink>,
    /// Where the camera jumps, in keyframes; `None` where poses were given.
    pub jump: Option<Jump>,
    /// In space.
    pub points: Vec<PointTrack>,
    /// In space.
    pub lines: Vec<LineTrack>,
    /// What is known of the points.
    pub stats: TrackStats,
    /// Of the world's lengths.
    pub units: Units,
    /// Direction of gravity in the world, a unit vector, if known.
    pub gravity: Option<Vector3<f64>>,
}

struct Posed {
    cameras: Vec<Camera>,
    source: PoseSource,
    cam_from_world: Vec<Option<CamFromWorld>>,
    left_out: Vec<(usize, LeftOut)>,
    num_components: usize,
    weak_link: Option<WeakLink>,
    jump: Option<Jump>,
    units: Units,
}

/// Poses, points and lines of keyframes of one camera. Views that all have a pose keep it, or one near it where the pictures say
/// so; those of views without are found.
///
/// # Errors
/// [`FilmError`]: too few pictures, nothing that can be reconstructed, or the observer stopped it.
pub async fn map_film(
    views: &[View],
    group: &CameraGroup,
    params: &FilmParams,
    observer: &mut dyn Observer,
) -> Result<FilmMap, FilmError> {
    if views.len() < MIN_PICTURES {
        return Err(FilmError::TooFew { found: views.len() });
    }
    let num_posed = views.iter().filter(|v| v.cam_from_world.is_some()).count();
    let posed = if num_posed == views.len() {
        let (cam_from_world, source) = settled(views, group, params, observer).await?;
        Posed {
            cameras: vec![group.camera; views.len()],
            source,
            cam_from_world,
            left_out: Vec::new(),
            num_components: 1,
            weak_link: None,
            jump: None,
            units: Units::Metres,
        }
    } else if num_posed == 0 {
        poses(views, group, &params.motion, observer).await?
    } else {
        return Err(FilmError::SomePoses {
            posed: num_posed,
            all: views.len(),
        });
    };
    let seen: Vec<PosedView<'_>> = (views.iter().zip(&posed.cameras).zip(&posed.cam_from_world))
        .filter_map(|((view, camera), pose)| {
            Some(PosedView::new(*camera, (*pose)?, &view.features))
        })
        .collect();
    let mut stats = TrackStats {
        agreement: check_poses(&seen, &params.tracks)?,
        ..TrackStats::default()
    };
    let mut watch = Watch::new(observer);
    let points = point_tracks(&seen, &params.tracks, &mut stats, &mut watch).await?;
    let lines = line_tracks(&seen, &params.tracks, &stats, &mut watch).await?;
    let is_posed = |i: &usize| posed.cam_from_world[*i].is_some();
    Ok(FilmMap {
        cameras: posed.cameras,
        source: posed.source,
        posed: (0..views.len()).filter(is_posed).collect(),
        cam_from_world: posed.cam_from_world,
        left_out: posed.left_out,
        num_components: posed.num_components,
        weak_link: posed.weak_link,
        jump: posed.jump,
        points,
        lines,
        stats,
        units: posed.units,
        gravity: None,
    })
}

/// All of one camera.
pub(super) fn pictures(views: &[View]) -> Vec<Picture<'_>> {
    views
        .iter()
        .map(|view| Picture {
            features: &view.features,
            camera: 0,
        })
        .collect()
}

/// Structure from motion; the largest piece.
async fn poses(
    views: &[View],
    group: &CameraGroup,
    params: &MotionParams,
    observer: &mut dyn Observer,
) -> Result<Posed, FilmError> {
    let pictures = pictures(views);
    let groups = std::slice::from_ref(group);
    let matches = match_pictures(&pictures, groups, params, observer).await?;
    let motion = reconstruct_motion(&pictures, groups, &matches, params, observer).await?;
    let num_components = motion.components.len();
    let weak_link = motion.components.first().and_then(Component::weak_link);
    let jump = motion.components.first().and_then(Component::jump);
    let left_out = motion.without_pose();
    let largest = motion.components.into_iter().next();
    let largest = largest.filter(|c| c.num_registered() >= MIN_PICTURES);
    let Some(largest) = largest else {
        return Err(FilmError::TooFew { found: 0 });
    };
    let camera_of = motion.camera_of.iter();
    let cameras = camera_of.map(|g| largest.cameras[*g]).collect();
    Ok(Posed {
        cameras,
        source: PoseSource::Pictures,
        cam_from_world: largest.cam_from_world,
        left_out,
        num_components,
        weak_link,
        jump,
        units: Units::Arbitrary,
    })
}

impl FilmMap {
    /// The camera of most keyframes that have a pose.
    pub fn main_camera(&self) -> Camera {
        let of_posed = |camera: &Camera| {
            let same = self.posed.iter().filter(|i| self.cameras[**i] == *camera);
            same.count()
        };
        let most = self.posed.iter().map(|i| self.cameras[*i]);
        most.max_by_key(of_posed).unwrap_or(self.cameras[0])
    }

    /// The scene of this map, whose views are the keyframes that it was made of: their features are borrowed meanwhile, and
    /// are back whatever happens.
    ///
    /// # Errors
    /// [`FilmError::Scene`] when too little was seen, [`FilmError::Stopped`].
    pub async fn scene(
        &self,
        views: &mut [View],
        origin: &Origin,
        request: &SceneRequest,
        observer: &mut dyn Observer,
    ) -> Result<SceneFile, FilmError> {
        let mut watch = Watch::new(observer);
        let told = watch.tell(Stage::Landmarks, 0, 2).await;
        told.ok_or(FilmError::Stopped)?;
        let map = self.lend(views);
        let made = make_scene(&map, origin, request, &mut watch).await;
        self.give_back(map, views);
        made
    }

    /// The label file of this map, which `landline train` takes; as [`Self::scene`] of the views that it was made of.
    ///
    /// # Errors
    /// [`LabelSourceError`] when the file cannot be written.
    pub fn labels(&self, views: &mut [View], origin: &Origin) -> Result<Vec<u8>, LabelSourceError> {
        let map = self.lend(views);
        let source = LabelSource {
            origin,
            map: &map,
            variants: Vec::new(),
        };
        let made = source.to_bytes();
        self.give_back(map, views);
        made
    }

    /// The map with its views, whose features are the caller's.
    fn lend(&self, views: &mut [View]) -> Reconstruction {
        Reconstruction {
            views: self.posed.iter().map(|i| self.taken(*i, views)).collect(),
            points: self.points.clone(),
            lines: self.lines.clone(),
            units: self.units,
            gravity: self.gravity,
        }
    }

    fn give_back(&self, mut map: Reconstruction, views: &mut [View]) {
        for (i, view) in self.posed.iter().zip(&mut map.views) {
            views[*i].features = std::mem::take(&mut view.features);
        }
    }

    /// A view with its pose; the caller's keeps all but the features.
    fn taken(&self, i: usize, views: &mut [View]) -> View {
        View {
            name: views[i].name.clone(),
            camera: self.cameras[i],
            cam_from_world: self.cam_from_world[i],
            features: std::mem::take(&mut views[i].features),
        }
    }

    /// Mean reprojection error of the points, the median over them.
    pub fn median_error_px(&self) -> f64 {
        let mut errors: Vec<f64> = self
            .points
            .iter()
            .map(|p| f64::from(p.mean_error_px))
            .collect();
        median_in_place(&mut errors).unwrap_or(f64::NAN)
    }

    /// Makes all lengths longer by a factor.
    pub fn rescale(&mut self, factor: f64) {
        for pose in self.cam_from_world.iter_mut().flatten() {
            pose.translation *= factor;
        }
        for point in &mut self.points {
            point.point_in_world *= factor;
        }
        for line in &mut self.lines {
            line.start_in_world *= factor;
            line.end_in_world *= factor;
        }
        self.stats.depth *= factor;
    }
}

async fn make_scene(
    map: &Reconstruction,
    origin: &Origin,
    request: &SceneRequest,
    watch: &mut Watch<'_>,
) -> Result<SceneFile, FilmError> {
    let networks = landmark_networks(map, request, &(0..0)).map_err(SceneError::from)?;
    let mut scene = scene_of(networks, map, origin, request);
    let told = watch.tell(Stage::Landmarks, 1, 2).await;
    told.ok_or(FilmError::Stopped)?;
    add_landmarks(&mut scene, map, request.max_bytes, request.precision)?;
    let told = watch.tell(Stage::Landmarks, 2, 2).await;
    told.ok_or(FilmError::Stopped)?;
    Ok(scene)
}
