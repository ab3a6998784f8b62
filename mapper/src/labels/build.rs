//! Labels without outside tools: from pictures with poses and features to tracks and targets.

use super::{
    Imported, Labels, MAX_DISTANCE_PX, Origin, line_tracks_from_map, point_tracks_from_model,
};
use crate::dataset::DatasetImage;
use crate::progress::Progress;
use landline::features::FeatureSet;
use landline::math::stats::median_in_place;
use landline::reconstruction::{
    LineParams, LineTrack, MatchParams, Misreading, PairParams, PointParams, PointTrack, PosedView,
    Reconstruction, View, build_line_tracks, build_point_tracks, check_convention, choose_pairs,
    line_pairs, match_pairs, probe_depth,
};

/// Every setting of the stage.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LabelParams {
    /// Which pictures are matched.
    pub pairs: PairParams,
    /// What counts as a match.
    pub matches: MatchParams,
    /// What makes a point track.
    pub points: PointParams,
    /// What makes a line track.
    pub lines: LineParams,
}

/// Why labels could not be made.
#[derive(Debug, thiserror::Error)]
pub enum LabelError {
    /// Fewer than two posed pictures.
    #[error(
        "labels need at least two training pictures with poses, there are {0}; one picture shows no depth"
    )]
    TooFewPictures(usize),
    /// The poses are of another convention than they were read as.
    #[error(
        "the poses contradict the pictures: {as_given:.0} % of the matches agree with them as given, {other:.0} % if they \
         are {misreading}"
    )]
    PoseConvention {
        /// Per cent.
        as_given: f64,
        /// Per cent.
        other: f64,
        /// What they seem to be.
        misreading: Misreading,
    },
    /// Nothing can be triangulated.
    #[error(
        "no two training pictures see the same things from different places: of {num_pictures} pictures, {what}. \
         Check that the poses belong to these pictures and that the camera moved"
    )]
    NoOverlap {
        /// Training pictures.
        num_pictures: usize,
        /// How far it came.
        what: String,
    },
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

/// What happened, for the report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LabelStats {
    /// Typical distance of what the pictures see.
    pub depth: f64,
    /// Pairs of pictures that look at the same things.
    pub pairs: Vec<(usize, usize)>,
    /// Matches that agree with the poses.
    pub num_matches: usize,
    /// Point tracks.
    pub num_points: usize,
    /// Mean number of observations a point track.
    pub mean_track_length: f64,
    /// Mean number of keypoints with a target in a picture.
    pub labelled_keypoints: f64,
    /// Mean number of keypoints in a picture.
    pub keypoints: f64,
    /// Mean reprojection error over all observations.
    pub mean_error_px: f64,
    /// Line tracks.
    pub num_lines: usize,
    /// Mean number of segments with a target in a picture.
    pub labelled_segments: f64,
    /// Mean number of segments in a picture.
    pub segments: f64,
    /// Mean distance of observed ends to the projected line, over all observations.
    pub mean_line_error_px: f64,
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
    params: &LabelParams,
    progress: &Progress,
) -> Result<(Labels, LabelStats), LabelError> {
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
    params: &LabelParams,
    progress: &Progress,
) -> Result<(Labels, LabelStats), LabelError> {
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
    if posed.len() < 2 {
        return Err(LabelError::TooFewPictures(posed.len()));
    }
    if let Some(check) = check_convention(&posed, 40, params.matches.min_cosine)
        && let Some(misreading) = check.misreading()
    {
        return Err(LabelError::PoseConvention {
            as_given: 100.0 * check.as_given,
            other: 100.0 * check.best_other.1,
            misreading,
        });
    }
    let mut stats = LabelStats::default();
    let points = point_tracks(&posed, imported, params, progress, &mut stats)?;
    let lines = line_tracks(&posed, imported, params, progress, &stats);
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

impl LabelStats {
    /// Fills in what the tracks say.
    fn count(&mut self, map: &Reconstruction) {
        let num_views = map.views.len().max(1) as f64;
        let per_view = |of: fn(&FeatureSet) -> usize| {
            map.views.iter().map(|v| of(&v.features)).sum::<usize>() as f64 / num_views
        };
        let points = map.points.iter();
        let (seen, error) = seen(points.map(|p| (p.observations.len(), p.mean_error_px)));
        self.num_points = map.points.len();
        self.mean_track_length = seen / map.points.len().max(1) as f64;
        self.mean_error_px = error;
        self.labelled_keypoints = seen / num_views;
        self.keypoints = per_view(|f| f.keypoints.len());
        let lines = map.lines.iter();
        let (seen, error) = self::seen(lines.map(|l| (l.observations.len(), l.mean_error_px)));
        self.num_lines = map.lines.len();
        self.mean_line_error_px = error;
        self.labelled_segments = seen / num_views;
        self.segments = per_view(|f| f.segments.len());
    }
}

/// Observations of all tracks, and their mean error.
fn seen(tracks: impl Iterator<Item = (usize, f32)>) -> (f64, f64) {
    let (mut num, mut sum) = (0.0, 0.0);
    for (n, mean) in tracks {
        num += n as f64;
        sum += n as f64 * f64::from(mean);
    }
    (num, sum / f64::max(num, 1.0))
}

/// Point tracks, imported or triangulated; fills in depth and pairs.
fn point_tracks(
    views: &[PosedView<'_>],
    imported: &Imported,
    params: &LabelParams,
    progress: &Progress,
    stats: &mut LabelStats,
) -> Result<Vec<PointTrack>, LabelError> {
    let no_overlap = |what: String| LabelError::NoOverlap {
        num_pictures: views.len(),
        what,
    };
    if let Some(points) = &imported.points {
        let tracks = point_tracks_from_model(views, points, &params.points);
        stats.depth = depth_of(views, &tracks).ok_or(LabelError::ModelFitsNot {
            num_points: points.len(),
            max_px: MAX_DISTANCE_PX,
        })?;
        stats.pairs = choose_pairs(views, stats.depth, &params.pairs);
        return Ok(tracks);
    }
    stats.depth = probe_depth(views, 60, &params.matches).ok_or_else(|| {
        no_overlap(
            "neighbouring ones have fewer than 20 matches that agree with the poses".to_owned(),
        )
    })?;
    stats.pairs = choose_pairs(views, stats.depth, &params.pairs);
    let pairs = &stats.pairs;
    if pairs.is_empty() {
        return Err(no_overlap(format!(
            "none share {:.0} % of their view at the typical depth {:.2}",
            100.0 * params.pairs.min_overlap,
            stats.depth
        )));
    }
    let bar = progress.bar("matching", pairs.len());
    let matches = match_pairs(views, pairs, &params.matches, &|| bar.inc(1));
    bar.finish();
    let spinner = progress.spinner("triangulating points");
    let tracks = build_point_tracks(views, &matches, &params.points);
    spinner.finish();
    if tracks.is_empty() {
        return Err(no_overlap(format!(
            "{} matches of {} pairs give no point",
            matches.len(),
            pairs.len()
        )));
    }
    stats.num_matches = matches.len();
    Ok(tracks)
}

/// Line tracks, imported or triangulated.
fn line_tracks(
    views: &[PosedView<'_>],
    imported: &Imported,
    params: &LabelParams,
    progress: &Progress,
    stats: &LabelStats,
) -> Vec<LineTrack> {
    if let Some(lines) = &imported.lines {
        return line_tracks_from_map(views, lines);
    }
    let chosen = line_pairs(views, &stats.pairs, params.lines.partners);
    let bar = progress.bar("matching segments", chosen.len());
    let tracks = build_line_tracks(views, &chosen, stats.depth, &params.lines, &|| bar.inc(1));
    bar.finish();
    tracks
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

impl std::fmt::Display for LabelStats {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "Labels")?;
        writeln!(f, "  typical depth      {:.2}", self.depth)?;
        writeln!(f, "  pairs              {}", self.pairs.len())?;
        writeln!(f, "  matches            {}", self.num_matches)?;
        writeln!(
            f,
            "  3D points          {}, seen {:.1} times, {:.2} px mean error",
            self.num_points, self.mean_track_length, self.mean_error_px
        )?;
        writeln!(
            f,
            "  keypoints          {:.0} of {:.0} labelled in a picture",
            self.labelled_keypoints, self.keypoints
        )?;
        writeln!(
            f,
            "  3D lines           {}, {:.2} px mean error",
            self.num_lines, self.mean_line_error_px
        )?;
        writeln!(
            f,
            "  segments           {:.0} of {:.0} labelled in a picture",
            self.labelled_segments, self.segments
        )
    }
}
