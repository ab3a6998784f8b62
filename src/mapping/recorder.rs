//! The keyframes of a film with what is known of them beforehand.

use super::film::{FilmError, FilmMap, FilmParams, map_film};
use super::keyframes::{Exposure, KeyframeChoice, KeyframeParams, Verdict};
use super::scene::{Origin, SceneRequest};
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera, Pixel, Units};
use crate::math::order::sort_by;
use crate::math::stats::median_in_place;
use crate::reconstruction::motion::CameraGroup;
use crate::reconstruction::{Observer, View};
use crate::scene_file::SceneFile;
use nalgebra::Vector3;

/// How well the camera of a frame is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FrameCamera {
    /// Only the size of the frame.
    Unknown,
    /// To a few percent, as EXIF says it: refined.
    About(Camera),
    /// Taken as it is.
    Exact(Camera),
}

impl FrameCamera {
    /// The same for the frame as changed so.
    #[must_use]
    pub fn map(self, change: impl FnOnce(Camera) -> Camera) -> Self {
        match self {
            Self::Unknown => Self::Unknown,
            Self::About(camera) => Self::About(change(camera)),
            Self::Exact(camera) => Self::Exact(change(camera)),
        }
    }
}

/// What is known of a frame besides its picture.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInfo {
    /// As the caller calls it.
    pub name: String,
    /// Of the frame.
    pub camera: FrameCamera,
    /// Where it was taken, if that is known; in metres.
    pub cam_from_world: Option<CamFromWorld>,
    /// Downwards in camera axes, if that is known.
    pub gravity_in_cam: Option<Vector3<f64>>,
    /// It was a keyframe before: similarity and blur are no reasons against it.
    pub is_chosen: bool,
}

/// A distance that somebody knows: between what two pixels of keyframes show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownDistance {
    /// Keyframe and pixel of both ends.
    pub ends: [(usize, Pixel); 2],
    /// Their distance.
    pub metres: f64,
}

/// Why a distance says nothing.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum DistanceError {
    /// There is no map yet.
    #[error("there is no map yet: build it first")]
    NoMap,
    /// Not a distance.
    #[error("the distance is {0}: expected metres, 0.001 to 100000")]
    Metres(f64),
    /// Not a keyframe of the map.
    #[error("keyframe {0} has no place in the map: choose a picture that was placed")]
    NoPlace(usize),
    /// Nothing in space is known there.
    #[error(
        "nothing is known in space near pixel ({x:.0}, {y:.0}) of keyframe {keyframe}: choose a corner with texture"
    )]
    NothingNear {
        /// Which one.
        keyframe: usize,
        /// Of the pixel.
        x: f64,
        /// Of the pixel.
        y: f64,
    },
    /// Both ends are the same place.
    #[error("both ends are the same place")]
    Same,
}

/// A film that is being recorded, and its map once that is made.
#[derive(Debug, Default)]
pub struct Film {
    choice: KeyframeChoice,
    views: Vec<View>,
    infos: Vec<FrameInfo>,
    map: Option<FilmMap>,
}

impl Film {
    /// Without any frame.
    pub fn new(params: KeyframeParams) -> Self {
        Self {
            choice: KeyframeChoice::new(params),
            ..Self::default()
        }
    }

    /// Keyframes so far.
    pub fn num_keyframes(&self) -> usize {
        self.views.len()
    }

    /// The map, once it is made, until another keyframe comes.
    pub fn map(&self) -> Option<&FilmMap> {
        self.map.as_ref()
    }

    /// See [`KeyframeChoice::look`].
    pub fn look(
        &mut self,
        size: (u32, u32),
        exposure: Exposure,
        is_chosen: bool,
    ) -> Option<Verdict> {
        let kept = self.views.len();
        self.choice.look(size, exposure, kept, is_chosen)
    }

    /// Takes a frame that [`Self::look`] had nothing against, or says why not. Features, size and camera are those of its working
    /// image, and so are the pixels of the map: what agrees and what does not is a matter of pixels as features know them.
    pub fn add(&mut self, size: (u32, u32), features: FeatureSet, info: FrameInfo) -> Verdict {
        let kept: Vec<&FeatureSet> = self.views.iter().map(|v| &v.features).collect();
        let verdict = self.choice.choose(&features, &kept, info.is_chosen);
        if verdict.not_kept.is_none() {
            self.map = None;
            self.views.push(View {
                name: info.name.clone(),
                camera: CameraGroup::unknown(size.0, size.1).camera,
                cam_from_world: info.cam_from_world,
                features,
            });
            self.infos.push(info);
        }
        verdict
    }

    /// The camera as its frames tell it: exact if all of them say so, about right if all say something.
    fn group(&self) -> CameraGroup {
        let camera = self.views.first().map(|v| v.camera);
        let (width, height) = camera.map_or((1, 1), |c| (c.width, c.height));
        let known: Vec<(Camera, bool)> = self
            .infos
            .iter()
            .filter_map(|info| match info.camera {
                FrameCamera::Unknown => None,
                FrameCamera::About(camera) => Some((camera, false)),
                FrameCamera::Exact(camera) => Some((camera, true)),
            })
            .collect();
        let middle = |of: fn(&Camera) -> f64| {
            median_in_place(&mut known.iter().map(|(c, _)| of(c)).collect::<Vec<f64>>())
        };
        let (Some(first), true) = (known.first(), known.len() == self.infos.len()) else {
            return CameraGroup::unknown(width, height);
        };
        // Of a camera that focuses anew the typical focal length.
        let focal = middle(|c| c.focal_px().0).unwrap_or(first.0.focal_px().0);
        let factor = focal / first.0.focal_px().0;
        let camera = scaled_focal(&first.0, factor);
        if known.iter().all(|(_, is_exact)| *is_exact) {
            CameraGroup::given(camera)
        } else {
            CameraGroup {
                refines: true,
                sigma_ln: 0.05,
                ..CameraGroup::given(camera)
            }
        }
    }

    /// Makes the map. The keyframes stay, whatever happens.
    ///
    /// # Errors
    /// See [`map_film`].
    pub async fn build(
        &mut self,
        params: &FilmParams,
        observer: &mut dyn Observer,
    ) -> Result<&FilmMap, FilmError> {
        self.map = None;
        if self.choice.only_turns() && self.views.iter().all(|v| v.cam_from_world.is_none()) {
            return Err(FilmError::OnlyTurned);
        }
        let mut map = map_film(&self.views, &self.group(), params, observer).await?;
        map.gravity = self.gravity(&map);
        Ok(self.map.insert(map))
    }

    /// Mean of what the placed keyframes say of gravity, in the world.
    fn gravity(&self, map: &FilmMap) -> Option<Vector3<f64>> {
        let said = self.infos.iter().zip(&map.cam_from_world);
        let sum: Vector3<f64> = said
            .filter_map(|(info, pose)| {
                let in_cam = info.gravity_in_cam?.try_normalize(1e-6)?;
                Some(pose.as_ref()?.rotation.transpose() * in_cam)
            })
            .sum();
        sum.try_normalize(1e-3)
    }

    /// The scene of the map. The map stays, whatever happens.
    ///
    /// # Errors
    /// [`FilmError::TooFew`] without a map, else see [`FilmMap::scene`].
    pub async fn scene(
        &mut self,
        origin: &Origin,
        request: &SceneRequest,
        observer: &mut dyn Observer,
    ) -> Result<SceneFile, FilmError> {
        let Some(map) = &self.map else {
            return Err(FilmError::TooFew { found: 0 });
        };
        map.scene(&mut self.views, origin, request, observer).await
    }

    /// The label file of the map, which `landline train` takes. Pictures without a name are called by their number.
    ///
    /// # Errors
    /// [`FilmError::TooFew`] without a map, [`FilmError::Labels`] when the file cannot be written.
    pub fn labels(&mut self, origin: &Origin) -> Result<Vec<u8>, FilmError> {
        let Some(map) = &self.map else {
            return Err(FilmError::TooFew { found: 0 });
        };
        for (i, view) in self.views.iter_mut().enumerate() {
            if view.name.is_empty() {
                view.name = format!("{i:05}");
            }
        }
        Ok(map.labels(&mut self.views, origin)?)
    }

    /// Sets the direction of gravity in the world, a vector of any length above zero.
    pub fn set_gravity(&mut self, gravity: Vector3<f64>) {
        if let Some(map) = &mut self.map {
            map.gravity = gravity.try_normalize(1e-9).or(map.gravity);
        }
    }

    /// Makes the map's lengths metres by a distance that somebody knows. The factor that they grew by.
    ///
    /// # Errors
    /// See [`DistanceError`]; nothing has changed then.
    pub fn set_distance(&mut self, known: &KnownDistance) -> Result<f64, DistanceError> {
        if !DISTANCES_M.contains(&known.metres) {
            return Err(DistanceError::Metres(known.metres));
        }
        let map = self.map.as_ref().ok_or(DistanceError::NoMap)?;
        let [a, b] = known.ends.map(|(k, pixel)| self.place(map, k, pixel));
        let ((a, away_a), (b, away_b)) = (a?, b?);
        let now = (a - b).norm();
        if !(now > LEAST_APART * away_a.max(away_b)) {
            return Err(DistanceError::Same);
        }
        let factor = known.metres / now;
        if let Some(map) = &mut self.map {
            map.rescale(factor);
            map.units = Units::Metres;
        }
        Ok(factor)
    }

    /// Where in space the thing at a pixel is, on its ray, as deep as the points seen nearest to it; and how far from the camera.
    fn place(
        &self,
        map: &FilmMap,
        keyframe: usize,
        pixel: Pixel,
    ) -> Result<(Vector3<f64>, f64), DistanceError> {
        let no_place = DistanceError::NoPlace(keyframe);
        let position = map.posed.binary_search(&keyframe).map_err(|_| no_place)?;
        let pose = map.cam_from_world.get(keyframe).copied().flatten();
        let (Some(pose), Some(view)) = (pose, self.views.get(keyframe)) else {
            return Err(no_place);
        };
        let camera = &map.cameras[keyframe];
        let side = f64::from(camera.width.max(camera.height));
        let mut near: Vec<(f64, f64)> = Vec::new();
        for point in &map.points {
            for o in &point.observations {
                if o.view as usize != position {
                    continue;
                }
                let Some(keypoint) = view.features.keypoints.get(o.feature as usize) else {
                    continue;
                };
                let (dx, dy) = (keypoint.pixel.x - pixel.x, keypoint.pixel.y - pixel.y);
                let distance = (dx * dx + dy * dy).sqrt();
                if distance < NEAR_SHARE * side {
                    near.push((distance, pose.transform_point(&point.point_in_world).z));
                }
            }
        }
        sort_by(&mut near, |x, y| x.0.total_cmp(&y.0));
        near.truncate(3);
        let depth = median_in_place(&mut near.iter().map(|n| n.1).collect::<Vec<f64>>());
        let bearing = camera.bearing_from_pixel(pixel).filter(|b| b.z > 1e-6);
        let (Some(depth), Some(bearing)) = (depth, bearing) else {
            return Err(DistanceError::NothingNear {
                keyframe,
                x: pixel.x,
                y: pixel.y,
            });
        };
        let seen = bearing * (depth / bearing.z);
        Ok((pose.inverse().transform_point(&seen), seen.norm()))
    }
}

/// Distances that somebody may have measured in a place, metres: what is beyond is a slip of the finger.
const DISTANCES_M: std::ops::RangeInclusive<f64> = 1e-3..=1e5;

/// Ends that are nearer to each other than this share of the farther one's depth are one place: a pixel is more.
const LEAST_APART: f64 = 1e-3;

/// Points farther from a pixel than this share of the longer side say nothing of its depth.
const NEAR_SHARE: f64 = 0.05;

fn scaled_focal(camera: &Camera, factor: f64) -> Camera {
    let (fx, fy) = camera.focal_px();
    let c = camera.principal_point();
    Camera {
        model: crate::geometry::CameraModel::Pinhole {
            fx: fx * factor,
            fy: fy * factor,
            cx: c.x,
            cy: c.y,
        },
        ..*camera
    }
}
