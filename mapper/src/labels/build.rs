//! Labels without outside tools: from pictures with poses and features to tracks and targets.

use super::{
    Imported, Labels, MAX_DISTANCE_PX, Origin, advice, line_tracks_from_map,
    point_tracks_from_model,
};
use crate::dataset::{DatasetImage, ModelPoint};
use crate::progress::{Progress, StageBars};
use landline::features::FeatureSet;
use landline::mapping::{
    TrackError, TrackParams, TrackStats, check_poses, line_tracks, point_tracks,
};
use landline::math::stats::median_in_place;
use landline::reconstruction::{PointTrack, PosedView, Reconstruction, View, Watch, choose_pairs};
use pollster::block_on;

/// Why labels could not be made.
#[derive(Debug, thiserror::Error)]
pub enum LabelError {
    /// Poses or pictures do not serve.
    #[error("{error}{advice}", error = .0, advice = advice::of(.0))]
    Tracks(TrackError),
    /// Points of a model were asked for.
    #[error(
        "the data set has no 3D points of its own ({0}); only COLMAP models do. Leave --points-from away to triangulate"
    )]
    NoModelPoints(&'static str),
    /// The model's points are not where the keypoints are.
    #[error(
        "none of the model's {num_points} points was seen within {max_px} px of two keypoints; do model and pictures belong \
         together?"
    )]
    ModelFitsNot {
        /// Points of the model.
        num_points: usize,
        /// Largest distance.
        max_px: f64,
    },
}

impl From<TrackError> for LabelError {
    fn from(error: TrackError) -> Self {
        Self::Tracks(error)
    }
}

/// Builds labels for posed pictures; `features` in the same order. What the world's lengths and directions mean is for the caller
/// to say.
///
/// # Errors
/// With fewer than two pictures, or when nothing can be triangulated.
pub fn build(
    images: &[&DatasetImage],
    features: Vec<FeatureSet>,
    origin: Origin,
    params: &TrackParams,
    progress: Progress,
) -> Result<(Labels, TrackStats), LabelError> {
    let imported = Imported::default();
    build_from(images, features, origin, &imported, params, progress)
}

/// [`build`] with points or lines that came with the data set in place of triangulated ones.
///
/// # Errors
/// As [`build`], and when imported points do not fit the keypoints.
pub fn build_from(
    images: &[&DatasetImage],
    features: Vec<FeatureSet>,
    origin: Origin,
    imported: &Imported,
    params: &TrackParams,
    progress: Progress,
) -> Result<(Labels, TrackStats), LabelError> {
    let views: Vec<View> = images
        .iter()
        .zip(features)
        .filter(|(image, _)| image.cam_from_world.is_some())
        .map(|(image, features)| View {
            name: image.name.clone(),
            camera: image.camera,
            cam_from_world: image.cam_from_world,
            features,
        })
        .collect();
    let posed: Vec<PosedView<'_>> = views.iter().filter_map(View::posed).collect();
    let mut stats = TrackStats {
        agreement: check_poses(&posed, params)?,
        ..TrackStats::default()
    };
    let mut bars = StageBars::new(progress);
    let mut watch = Watch::new(&mut bars);
    let points = match &imported.points {
        Some(points) => model_tracks(&posed, points, params, &mut stats)?,
        None => block_on(point_tracks(&posed, params, &mut stats, &mut watch))?,
    };
    let lines = match &imported.lines {
        Some(lines) => line_tracks_from_map(&posed, lines),
        None => block_on(line_tracks(&posed, params, &stats, &mut watch))?,
    };
    drop(bars);
    drop(posed);
    let map = Reconstruction {
        views,
        points,
        lines,
        ..Reconstruction::default()
    };
    stats.count(&map);
    let labels = Labels {
        origin,
        map,
        variants: Vec::new(),
    };
    Ok((labels, stats))
}

/// Point tracks of a data set's own model; fills in depth and pairs.
fn model_tracks(
    views: &[PosedView<'_>],
    points: &[ModelPoint],
    params: &TrackParams,
    stats: &mut TrackStats,
) -> Result<Vec<PointTrack>, LabelError> {
    let tracks = point_tracks_from_model(views, points, &params.points);
    stats.depth = depth_of(views, &tracks).ok_or(LabelError::ModelFitsNot {
        num_points: points.len(),
        max_px: MAX_DISTANCE_PX,
    })?;
    stats.pairs = choose_pairs(views, stats.depth, &params.pairs);
    Ok(tracks)
}

/// Median depth of tracks in the views that see them.
fn depth_of(views: &[PosedView<'_>], tracks: &[PointTrack]) -> Option<f64> {
    let mut depths: Vec<f64> = tracks
        .iter()
        .flat_map(|t| t.observations.iter().map(move |o| (t, o.view)))
        .filter_map(|(t, v)| {
            let view = views.get(v as usize)?;
            Some(view.cam_from_world.transform_point(&t.point_in_world).z)
        })
        .collect();
    median_in_place(&mut depths)
}
