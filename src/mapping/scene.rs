//! From a map to a scene file whose networks are the map's landmarks, with the table that is looked at again.

use crate::geometry::{Camera, SceneScale};
use crate::landmarks::LandmarkError;
use crate::landmarks::anchors::{line_anchors, point_anchors};
use crate::landmarks::from_map::{Budget, table};
use crate::math::order::sort_by_key;
use crate::models::landmarks::untrained;
use crate::models::{
    ExtractorKind, LineBranchConfig, ModelError, PointBranchConfig, Preset, RegressorConfig,
};
use crate::nn::Weights;
use crate::reconstruction::{Reconstruction, View};
use crate::scene_file::{
    ExtractorFile, MAX_OTHER_CAMERAS, Precision, SceneFile, SceneFileError, SceneInfo, Timestamp,
    TrainingSummary,
};
use std::cmp::Reverse;
use std::ops::Range;

/// Why a map makes no scene.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The map's landmarks make no network.
    #[error("networks of the map's landmarks: {0}")]
    Model(#[from] ModelError),
    /// The map's landmarks make no table, or do not fit.
    #[error("landmarks: {0}")]
    Landmarks(#[from] LandmarkError),
    /// The scene cannot be written as a file.
    #[error(transparent)]
    File(#[from] SceneFileError),
}

/// What made the features of labels, and of which pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Origin {
    /// The extractor.
    pub extractor: ExtractorKind,
    /// SHA-256 of the checkpoint that its weights came from.
    pub extractor_sha256: String,
    /// Longest side of the working image that the features were taken from, pixels.
    pub working_max_side: u32,
    /// Which pictures, in words.
    pub source: String,
}

/// XFeat's features of no checkpoint that there is, for labels that are put together by hand.
impl Default for Origin {
    fn default() -> Self {
        Self {
            extractor: ExtractorKind::Xfeat,
            extractor_sha256: String::new(),
            working_max_side: 640,
            source: String::new(),
        }
    }
}

impl Origin {
    /// Features of an extractor.
    pub fn of_extractor(extractor: &ExtractorFile, working_max_side: u32) -> Self {
        Self {
            extractor: extractor.kind,
            extractor_sha256: extractor.source_sha256.clone(),
            working_max_side,
            source: String::new(),
        }
    }

    /// Whether the features are of the extractor with this checkpoint.
    pub fn is_of(&self, extractor: ExtractorKind, sha256: &str) -> bool {
        self.extractor == extractor && self.extractor_sha256 == sha256
    }
}

/// What a scene holds and says, whoever makes its networks.
#[derive(Debug, Clone)]
pub struct SceneRequest {
    /// Most landmarks of the point branch; those of the preset when `None`.
    pub anchors: Option<usize>,
    /// Whether there is a line branch.
    pub lines: bool,
    /// One picture in so many is kept back, in one stretch, to measure the networks on; 0 keeps none. For callers that measure.
    pub hold_out_every: usize,
    /// Licence of the map.
    pub licence: String,
    /// When it is made, where that is known.
    pub created: Option<Timestamp>,
    /// Most bytes of the file; `None` for what serves.
    pub max_bytes: Option<usize>,
    /// How weights are stored.
    pub precision: Precision,
}

/// Networks with what a scene file says of how they came about.
#[derive(Debug, Clone)]
pub struct Networks {
    /// The preset that they are sized by.
    pub preset: Preset,
    /// Their configuration.
    pub config: RegressorConfig,
    /// From their coordinates to the world.
    pub scale: SceneScale,
    /// Their tensors.
    pub weights: Weights,
    /// Pictures that they know.
    pub num_images: usize,
    /// Steps of training.
    pub num_steps: u64,
    /// Time of training.
    pub seconds: f64,
}

/// Cameras whose focal lengths and principal points differ by no more than this share of the longer side are one.
const ALIKE: f64 = 0.01;

/// Bytes of a scene, and of its landmarks at least, when nobody says.
const USUAL_BYTES: usize = 400_000;
const USUAL_TABLE: usize = 140_000;

/// Networks that are the map's landmarks and know nothing of the `held` pictures.
///
/// # Errors
/// [`ModelError`] without any landmark.
pub fn landmark_networks(
    map: &Reconstruction,
    request: &SceneRequest,
    held: &Range<usize>,
) -> Result<Networks, ModelError> {
    let channels = map.descriptor_channels();
    let scale = SceneScale::of(map.points.iter().map(|p| p.point_in_world));
    let [usual_points, usual_lines] = usual_anchors(channels);
    let points = point_anchors(map, held, &scale, request.anchors.unwrap_or(usual_points));
    let lines = match request.lines {
        true => line_anchors(map, held, &scale, usual_lines),
        false => Vec::new(),
    };
    let (config, weights) = untrained(channels, &points, &lines)?;
    Ok(Networks {
        preset: Preset::Compact,
        config,
        scale,
        weights,
        num_images: map.views.len() - held.len(),
        num_steps: 0,
        seconds: 0.0,
    })
}

/// Landmarks of both branches of preset `compact`.
fn usual_anchors(channels: usize) -> [usize; 2] {
    match RegressorConfig::preset(Preset::Compact, channels) {
        RegressorConfig::Branches {
            point: PointBranchConfig::Anchored(point),
            line: Some(LineBranchConfig::Anchored(line)),
        } => [point.num_anchors, line.num_anchors],
        other => unreachable!("compact chooses among landmarks: {other:?}"),
    }
}

/// The scene of some networks, without held-out accuracy and landmarks.
pub fn scene_of(
    networks: Networks,
    map: &Reconstruction,
    origin: &Origin,
    request: &SceneRequest,
) -> SceneFile {
    let mut cameras = cameras_of(&map.views).into_iter();
    let info = SceneInfo {
        preset: Some(networks.preset),
        scale: networks.scale,
        units: map.units,
        gravity: map.gravity,
        working_max_side: origin.working_max_side,
        camera: cameras.next(),
        other_cameras: cameras.take(MAX_OTHER_CAMERAS).collect(),
        training: Some(TrainingSummary {
            num_images: networks.num_images as u64,
            num_steps: networks.num_steps,
            seconds: networks.seconds.round(),
            held_out: None,
            source: origin.source.clone(),
        }),
        licence: request.licence.clone(),
        created: request.created.clone(),
        ..SceneInfo::new(origin.extractor, origin.extractor_sha256.clone())
    };
    SceneFile {
        info,
        config: networks.config,
        weights: networks.weights,
        landmarks: None,
    }
}

/// The cameras of views that differ beyond what one camera does from picture to picture; that of most views first.
fn cameras_of(views: &[View]) -> Vec<Camera> {
    let mut cameras: Vec<(Camera, usize)> = Vec::new();
    for view in views {
        match cameras.iter_mut().find(|(c, _)| is_alike(c, &view.camera)) {
            Some((_, count)) => *count += 1,
            None => cameras.push((view.camera, 1)),
        }
    }
    sort_by_key(&mut cameras, |(_, count)| Reverse(*count));
    cameras.into_iter().map(|(camera, _)| camera).collect()
}

/// Whether two cameras take pictures of one shape with nearly the same focal length and principal point.
fn is_alike(a: &Camera, b: &Camera) -> bool {
    let Some(b) = b.for_size(a.width, a.height) else {
        return false;
    };
    let ((ax, ay), (bx, by)) = (a.focal_px(), b.focal_px());
    let center_off = a.principal_point().distance(b.principal_point());
    let off_px = (ax - bx).abs().max((ay - by).abs()).max(center_off);
    off_px <= ALIKE * f64::from(a.width.max(a.height))
}

/// Gives a scene the landmarks of its map that are looked at again, as many as the size allows.
///
/// # Errors
/// [`SceneError::Landmarks`] when the map has none, or the size is too small.
pub fn add_landmarks(
    scene: &mut SceneFile,
    map: &Reconstruction,
    max_bytes: Option<usize>,
    precision: Precision,
) -> Result<(), SceneError> {
    scene.landmarks = None;
    let networks = scene.to_bytes(precision)?.len();
    let usual = USUAL_BYTES.max(networks + USUAL_TABLE);
    let budget = Budget {
        max_bytes: max_bytes.unwrap_or(usual),
        networks,
    };
    scene.landmarks = Some(table(map, budget)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::FeatureSet;

    #[test]
    fn cameras_that_differ_are_told_apart_and_the_commonest_comes_first() {
        let view = |width: u32, height: u32, focal: f64| View {
            name: String::new(),
            camera: Camera::centered(width, height, focal),
            cam_from_world: None,
            features: FeatureSet::default(),
        };
        // The same camera at another size, and with its focus pulled a little; then two others.
        let views = [
            view(640, 480, 700.0),
            view(640, 480, 500.0),
            view(1280, 960, 1002.0),
            view(640, 480, 503.0),
            view(640, 360, 500.0),
            view(640, 360, 501.0),
        ];
        let found = cameras_of(&views);
        let expected = [(640, 480, 500.0), (640, 360, 500.0), (640, 480, 700.0)];
        let expected = expected.map(|(w, h, f)| Camera::centered(w, h, f));
        assert_eq!(found, expected);
        assert_eq!(cameras_of(&[]), []);
    }
}
