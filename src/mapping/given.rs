//! Poses that came with the keyframes. Where pictures agree with them they are taken as they are, else they are priors of an
//! adjustment, whose outcome is taken if the pictures agree clearly better with it.

use super::film::{FilmError, FilmParams, pictures};
use super::tracks::check_poses;
use crate::geometry::CamFromWorld;
use crate::reconstruction::motion::{
    CameraGroup, Refined, Refinement, candidate_pairs, disagreement, match_candidates,
};
use crate::reconstruction::{Observer, PosedView, View};

/// Where the poses of a map came from.
#[derive(Debug, Clone, PartialEq)]
pub enum PoseSource {
    /// From the pictures alone.
    Pictures,
    /// They were given, and taken as they are.
    Given {
        /// Median distance of matches from where the poses put them; `None` where nobody looked or too little matches.
        epipolar_px: Option<f64>,
    },
    /// They were given, and an adjustment did not help.
    Kept(Adjusted),
    /// They were given, and adjusted.
    Adjusted(Adjusted),
}

/// What an adjustment of given poses did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Adjusted {
    /// Median distance of matches from where the given poses put them.
    pub before_px: f64,
    /// From where the adjusted ones put them.
    pub after_px: f64,
    /// Median distance that cameras moved, metres.
    pub moved: f64,
    /// Median angle that they turned.
    pub turned_rad: f64,
}

impl From<&Refined> for Adjusted {
    fn from(refined: &Refined) -> Self {
        Self {
            before_px: refined.before.epipolar_px,
            after_px: refined.after.epipolar_px,
            moved: refined.moved,
            turned_rad: refined.turned_rad,
        }
    }
}

impl std::fmt::Display for Adjusted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "matches lie {:.2} -> {:.2} px from where they put them, cameras moved {:.1} cm and {:.2} degrees (median)",
            self.before_px,
            self.after_px,
            100.0 * self.moved,
            self.turned_rad.to_degrees()
        )
    }
}

impl std::fmt::Display for PoseSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Pictures => f.write_str("found from the pictures alone"),
            Self::Given { epipolar_px: None } => f.write_str("as given"),
            Self::Given {
                epipolar_px: Some(px),
            } => write!(
                f,
                "as given: matches lie {px:.2} px from where they put them"
            ),
            Self::Kept(tried) => write!(f, "as given, for adjusting them did not help: {tried}"),
            Self::Adjusted(done) => write!(f, "given ones, adjusted: {done}"),
        }
    }
}

/// The poses of views that all have one.
pub(super) async fn settled(
    views: &[View],
    group: &CameraGroup,
    params: &FilmParams,
    observer: &mut dyn Observer,
) -> Result<(Vec<Option<CamFromWorld>>, PoseSource), FilmError> {
    let given: Vec<Option<CamFromWorld>> = views.iter().map(|v| v.cam_from_world).collect();
    let Some(believed) = &params.given else {
        return Ok((given, PoseSource::Given { epipolar_px: None }));
    };
    let (pictures, groups) = (pictures(views), std::slice::from_ref(group));
    let features: Vec<_> = pictures.iter().map(|p| p.features).collect();
    let motion = &params.motion;
    let pairs = candidate_pairs(&features, &motion.candidates);
    let off = disagreement(&pictures, groups, &given, &pairs, motion, observer).await?;
    if !off.is_some_and(|off| off.is_large()) {
        let epipolar_px = off.map(|off| off.epipolar_px);
        return Ok((given, PoseSource::Given { epipolar_px }));
    }
    // Poses of another convention are not bent but named.
    let seen: Vec<PosedView<'_>> = views
        .iter()
        .zip(given.iter().flatten())
        .map(|(view, pose)| PosedView::new(group.camera, *pose, &view.features))
        .collect();
    check_poses(&seen, &params.tracks)?;
    let matches = match_candidates(&pictures, groups, &pairs, motion, observer).await?;
    let refinement = Refinement::new(&pictures, groups, &given, &matches, motion, observer).await?;
    let refined = refinement.adjust(believed, observer).await?;
    let what = Adjusted::from(&refined);
    if refined.is_better() {
        Ok((refined.cam_from_world, PoseSource::Adjusted(what)))
    } else {
        Ok((given, PoseSource::Kept(what)))
    }
}
