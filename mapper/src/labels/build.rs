//! Labels without outside tools: from pictures with poses and features to tracks and targets.

use super::{Imported, LabelledImage, Labels, LineTrack, Observation, PointTrack, SegmentTarget};
use crate::dataset::DatasetImage;
use crate::feature_cache::ImageFeatures;
use crate::progress::Progress;
use crate::tracks::{
    Bundle, LineParams, MAX_DISTANCE_PX, MatchParams, Misreading, PairParams, PointParams,
    SegmentTrack, Track, View, build_line_tracks, build_point_tracks, check_convention,
    choose_pairs, line_pairs, line_residuals, line_tracks_from_map, match_pairs, mean_descriptor,
    mean_segment_descriptor, point_tracks_from_model, probe_depth,
};
use landline::geometry::CamFromWorld;
use landline::math::stats::median_in_place;

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

/// Builds labels for posed pictures; `features` in the same order.
///
/// # Errors
/// With fewer than two pictures, or when nothing can be triangulated.
pub fn build(
    images: &[&DatasetImage],
    features: Vec<ImageFeatures>,
    extractor: &str,
    params: &LabelParams,
    progress: &Progress,
) -> Result<(Labels, LabelStats), LabelError> {
    let imported = Imported::default();
    build_from(images, features, extractor, &imported, params, progress)
}

/// [`build`] with points or lines that came with the data set in place of triangulated ones.
///
/// # Errors
/// As [`build`], and when imported points do not fit the keypoints.
pub fn build_from(
    images: &[&DatasetImage],
    features: Vec<ImageFeatures>,
    extractor: &str,
    imported: &Imported,
    params: &LabelParams,
    progress: &Progress,
) -> Result<(Labels, LabelStats), LabelError> {
    let posed: Vec<(&DatasetImage, CamFromWorld, ImageFeatures)> = images
        .iter()
        .zip(features)
        .filter_map(|(image, f)| image.cam_from_world.map(|pose| (*image, pose, f)))
        .collect();
    if posed.len() < 2 {
        return Err(LabelError::TooFewPictures(posed.len()));
    }
    let views: Vec<View> = posed
        .iter()
        .map(|(image, pose, f)| View::new(image.camera, *pose, f))
        .collect();
    if let Some(check) = check_convention(&views, 40, params.matches.min_cosine)
        && let Some(misreading) = check.misreading()
    {
        return Err(LabelError::PoseConvention {
            as_given: 100.0 * check.as_given,
            other: 100.0 * check.best_other.1,
            misreading,
        });
    }
    let mut stats = LabelStats::default();
    let tracks = point_tracks(&views, imported, params, progress, &mut stats)?;
    let line_tracks = line_tracks(&views, imported, params, progress, &stats);

    let bundle = Bundle { views: &views };
    stats.num_points = tracks.len();
    let mut point_targets: Vec<Vec<Option<u32>>> =
        views.iter().map(|v| vec![None; v.planar.len()]).collect();
    let mut points = Vec::with_capacity(tracks.len());
    let mut num_observations = 0usize;
    let mut error_sum = 0.0;
    for (t, track) in tracks.iter().enumerate() {
        let mut sum = 0.0;
        for &(view, keypoint) in &track.observations {
            point_targets[view as usize][keypoint as usize] = Some(t as u32);
            sum += bundle.error_px((view, keypoint), &track.point_in_world);
        }
        num_observations += track.observations.len();
        error_sum += sum;
        points.push(PointTrack {
            point_in_world: track.point_in_world,
            observations: track
                .observations
                .iter()
                .map(|&(image, feature)| Observation { image, feature })
                .collect(),
            descriptor: mean_descriptor(&views, &track.observations)
                .as_slice()
                .to_vec(),
            mean_error_px: (sum / track.observations.len() as f64) as f32,
        });
    }
    stats.mean_track_length = num_observations as f64 / tracks.len() as f64;
    stats.mean_error_px = error_sum / num_observations as f64;
    stats.labelled_keypoints = num_observations as f64 / views.len() as f64;
    stats.keypoints =
        views.iter().map(|v| v.planar.len()).sum::<usize>() as f64 / views.len() as f64;

    let mut segment_targets: Vec<Vec<Option<SegmentTarget>>> = views
        .iter()
        .map(|v| vec![None; v.segment_ends.len()])
        .collect();
    let mut lines = Vec::with_capacity(line_tracks.len());
    let mut num_seen = 0usize;
    let mut line_error_sum = 0.0;
    for (t, track) in line_tracks.iter().enumerate() {
        let (error, reversed) = line_residuals(&views, track);
        for (&(view, segment), reversed) in track.observations.iter().zip(reversed) {
            segment_targets[view as usize][segment as usize] = Some(SegmentTarget {
                track: t as u32,
                reversed,
            });
        }
        num_seen += track.observations.len();
        line_error_sum += error * track.observations.len() as f64;
        lines.push(LineTrack {
            start_in_world: track.start_in_world,
            end_in_world: track.end_in_world,
            observations: track
                .observations
                .iter()
                .map(|&(image, feature)| Observation { image, feature })
                .collect(),
            descriptor: mean_segment_descriptor(&views, &track.observations)
                .as_slice()
                .to_vec(),
            mean_error_px: error as f32,
        });
    }
    stats.num_lines = lines.len();
    stats.labelled_segments = num_seen as f64 / views.len() as f64;
    stats.segments =
        views.iter().map(|v| v.segment_ends.len()).sum::<usize>() as f64 / views.len() as f64;
    stats.mean_line_error_px = line_error_sum / num_seen.max(1) as f64;

    let mut labels = Labels {
        lines,
        extractor: extractor.to_owned(),
        points,
        ..Labels::default()
    };
    for ((image, cam_from_world, f), (point_targets, segment_targets)) in posed
        .into_iter()
        .zip(point_targets.into_iter().zip(segment_targets))
    {
        labels.descriptor_len = f.descriptor_len;
        labels.samples_per_segment = labels.samples_per_segment.max(f.samples_per_segment());
        labels.images.push(LabelledImage {
            name: image.name.clone(),
            camera: image.camera,
            cam_from_world,
            pixels: f.pixels,
            scores: f.scores,
            descriptors_nd: f.descriptors_nd,
            point_targets,
            segments: f.segments,
            segment_descriptors_nsd: f.segment_descriptors_nsd,
            segment_targets,
        });
    }
    Ok((labels, stats))
}

/// Point tracks, imported or triangulated; fills in depth and pairs.
fn point_tracks(
    views: &[View],
    imported: &Imported,
    params: &LabelParams,
    progress: &Progress,
    stats: &mut LabelStats,
) -> Result<Vec<Track>, LabelError> {
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
    views: &[View],
    imported: &Imported,
    params: &LabelParams,
    progress: &Progress,
    stats: &LabelStats,
) -> Vec<SegmentTrack> {
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
fn depth_of(views: &[View], tracks: &[Track]) -> Option<f64> {
    let mut depths: Vec<f64> = tracks
        .iter()
        .flat_map(|t| t.observations.iter().map(move |(v, _)| (t, *v)))
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
