//! From pictures with poses and features to points and lines in space.

use crate::features::FeatureSet;
use crate::reconstruction::{
    ConventionCheck, LineParams, LineTrack, MatchParams, Misreading, PIECE, PairParams,
    PointParams, PointTrack, PosedView, Reconstruction, Stage, Watch, build_line_tracks,
    build_point_tracks, check_convention, choose_pairs, line_pairs, match_pairs, probe_depth,
};

/// Every setting of the stage.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrackParams {
    /// Which pictures are matched.
    pub pairs: PairParams,
    /// What counts as a match.
    pub matches: MatchParams,
    /// What makes a point track.
    pub points: PointParams,
    /// What makes a line track.
    pub lines: LineParams,
    /// Poses are used even where the matches contradict them.
    pub trust_poses: bool,
}

/// Why there are no tracks.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackError {
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
    /// The poses are not those of the pictures, for a reason that is none of the usual ones.
    #[error(
        "the poses contradict the pictures: {agree:.0} % of the matches between neighbours agree with them, and no usual mistake \
         explains the others. Check that poses, intrinsics and pictures belong together"
    )]
    PosesContradicted {
        /// Per cent.
        agree: f64,
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
    /// The observer stopped it.
    #[error("stopped")]
    Stopped,
}

/// Share of the keypoints that get a target where poses and intrinsics are right and pictures overlap: 0.55 to 0.95 in real rooms.
const USUALLY_LABELLED: f64 = 0.2;

/// What happened, for the report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrackStats {
    /// Typical distance of what the pictures see.
    pub depth: f64,
    /// Pairs of pictures that look at the same things.
    pub pairs: Vec<(usize, usize)>,
    /// Median share of the matches between neighbours that agree with the poses, none of which the poses had a say in; `None` where
    /// too few pictures follow each other.
    pub agreement: Option<f64>,
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

impl TrackStats {
    /// Fills in what the tracks say.
    pub fn count(&mut self, map: &Reconstruction) {
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

/// Refuses poses that are too few, or are not what they are said to be. Says how well they agree with the pictures.
///
/// # Errors
/// [`TrackError::TooFewPictures`], [`TrackError::PoseConvention`], [`TrackError::PosesContradicted`].
pub fn check_poses(
    views: &[PosedView<'_>],
    params: &TrackParams,
) -> Result<Option<f64>, TrackError> {
    if views.len() < 2 {
        return Err(TrackError::TooFewPictures(views.len()));
    }
    let Some(check) = check_convention(views, 40, params.matches.min_cosine) else {
        return Ok(None);
    };
    let as_given = 100.0 * check.as_given;
    if params.trust_poses {
        return Ok(Some(check.as_given));
    }
    if let Some(misreading) = check.misreading() {
        return Err(TrackError::PoseConvention {
            as_given,
            other: 100.0 * check.best_other.1,
            misreading,
        });
    }
    if check.is_refused() {
        return Err(TrackError::PosesContradicted { agree: as_given });
    }
    Ok(Some(check.as_given))
}

/// Triangulated points; fills in depth, pairs and matches.
///
/// # Errors
/// [`TrackError::NoOverlap`], [`TrackError::Stopped`].
pub async fn point_tracks(
    views: &[PosedView<'_>],
    params: &TrackParams,
    stats: &mut TrackStats,
    watch: &mut Watch<'_>,
) -> Result<Vec<PointTrack>, TrackError> {
    let no_overlap = |what: String| TrackError::NoOverlap {
        num_pictures: views.len(),
        what,
    };
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
    let mut matches = Vec::new();
    for (piece, done) in pairs.chunks(PIECE).zip((PIECE..).step_by(PIECE)) {
        matches.extend(match_pairs(views, piece, &params.matches));
        let done = done.min(pairs.len());
        let told = watch.tell(Stage::PosedMatch, done, pairs.len()).await;
        told.ok_or(TrackError::Stopped)?;
    }
    let tracks = build_point_tracks(views, &matches, &params.points, watch)
        .await
        .ok_or(TrackError::Stopped)?;
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

/// Triangulated lines; `stats` knows depth and pairs.
///
/// # Errors
/// [`TrackError::Stopped`].
pub async fn line_tracks(
    views: &[PosedView<'_>],
    params: &TrackParams,
    stats: &TrackStats,
    watch: &mut Watch<'_>,
) -> Result<Vec<LineTrack>, TrackError> {
    let chosen = line_pairs(views, &stats.pairs, params.lines.partners);
    build_line_tracks(views, &chosen, stats.depth, &params.lines, watch)
        .await
        .ok_or(TrackError::Stopped)
}

impl std::fmt::Display for TrackStats {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "Labels")?;
        writeln!(f, "  typical depth      {:.2}", self.depth)?;
        writeln!(f, "  pairs              {}", self.pairs.len())?;
        writeln!(f, "  matches            {}", self.num_matches)?;
        if let Some(share) = self.agreement {
            let percent = 100.0 * share;
            writeln!(
                f,
                "  poses              {percent:.0} % of the matches between neighbours agree with them"
            )?;
            if share < ConventionCheck::USUAL {
                writeln!(
                    f,
                    "  warning: with right poses and intrinsics more than {:.0} % do as a rule; something about them is off",
                    100.0 * ConventionCheck::USUAL
                )?;
            }
        }
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
        if self.labelled_keypoints < USUALLY_LABELLED * self.keypoints {
            writeln!(
                f,
                "  warning: as a rule more than {:.0} % are; poses or intrinsics are off, or the pictures share little",
                100.0 * USUALLY_LABELLED
            )?;
        }
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
