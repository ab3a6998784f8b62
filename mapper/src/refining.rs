//! Better poses for a data set that has some: adjustment with the given poses as priors, kept only where everything that can be
//! measured says that it is better.

use crate::dataset::{Dataset, DatasetImage, Split};
use crate::eval::held_range;
use crate::extract::{ExtractError, Extraction};
use crate::progress::{Progress, StageBars};
use crate::teach::{Measured, SceneRequest, TeachError, labels, measure_landmarks};
use crate::units::Ruler;
use crate::working::{self, Shrink};
use landline::geometry::{CamFromWorld, CameraModel};
use landline::mapping::TrackStats;
use landline::reconstruction::motion::{
    CameraGroup, MotionError, MotionParams, Picture, RefineParams, Refined, Refinement,
    candidate_pairs, disagreement, match_candidates,
};
use pollster::block_on;

/// When given poses are refined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RefinePoses {
    /// Where pictures and poses disagree, and only if tracks, labels and pictures kept back say that it helps.
    Auto,
    /// In any case.
    On,
    /// In none.
    Off,
}

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RefiningRequest {
    /// When poses are refined.
    pub when: RefinePoses,
    /// Whether focal length and one radial term are refined with them.
    pub camera: bool,
    /// The pictures are not in the order in which they were taken.
    pub is_unordered: bool,
}

/// Why poses could not be refined.
#[derive(Debug, thiserror::Error)]
pub enum RefiningError {
    /// A picture or the cache cannot be read.
    #[error(transparent)]
    Extract(#[from] ExtractError),
    /// The pictures say nothing about the poses.
    #[error("poses cannot be refined: {0}; --refine-poses off takes them as they are")]
    Motion(#[from] MotionError),
    /// Nothing can be taught from the poses, refined or not.
    #[error(transparent)]
    Teach(#[from] TeachError),
    /// The data set has a model that would no longer fit.
    #[error(
        "--refine-poses on moves the cameras, and the {0} that came with the poses would stay: leave them away, or use off"
    )]
    HasModel(&'static str),
    /// The camera has a model that is not refined.
    #[error("--refine-camera refines SIMPLE_PINHOLE and SIMPLE_RADIAL, the pictures have {0}")]
    Camera(&'static str),
}

/// Up to so many pictures the adjustment is dense, and quick.
const MOST_PICTURES: usize = 500;
/// Refines the poses of the training pictures where that is asked for and helps. What it did, in one line.
///
/// # Errors
/// [`RefiningError`]; with [`RefinePoses::Auto`] only what teaching would say too.
pub fn refine(
    dataset: &mut Dataset,
    extraction: &Extraction,
    request: RefiningRequest,
    scene: &SceneRequest,
    model_points: bool,
    progress: Progress,
) -> Result<Option<String>, RefiningError> {
    let is_auto = request.when == RefinePoses::Auto;
    if request.when == RefinePoses::Off {
        return Ok(None);
    }
    let model = match () {
        () if model_points => Some("points"),
        () if !dataset.lines.is_empty() => Some("lines"),
        () => None,
    };
    let positions: Vec<usize> = dataset
        .of_split(Split::Train)
        .into_iter()
        .filter(|i| dataset.images[*i].cam_from_world.is_some())
        .collect();
    match model {
        Some(what) if !is_auto => return Err(RefiningError::HasModel(what)),
        Some(what) => return Ok(Some(format!("left as they are, for {what} came with them"))),
        None => {}
    }
    if is_auto && positions.len() > MOST_PICTURES {
        return Ok(Some(format!(
            "left as they are: {} pictures, adjusted by default up to {MOST_PICTURES} (--refine-poses on does it)",
            positions.len()
        )));
    }
    let max_side = extraction.options().max_side;
    let small = working::shrunk(dataset, max_side);
    let as_seen = small.as_ref().unwrap_or(dataset);
    let chosen: Vec<&DatasetImage> = positions.iter().map(|i| &as_seen.images[*i]).collect();
    let (groups, group_of) = groups(&chosen, request.camera)?;
    let given: Vec<Option<CamFromWorld>> = chosen.iter().map(|i| i.cam_from_world).collect();
    let mut features = extraction.all(&chosen, progress)?;
    for (features, i) in features.iter_mut().zip(&positions) {
        Shrink::of(&dataset.images[*i].camera, max_side).features(features);
    }
    let pictures: Vec<Picture<'_>> = features
        .iter()
        .zip(&group_of)
        .map(|(features, camera)| Picture {
            features,
            camera: *camera,
        })
        .collect();
    let mut params = MotionParams::default();
    params.candidates.is_video = !request.is_unordered;
    let views: Vec<_> = features.iter().collect();
    let pairs = candidate_pairs(&views, &params.candidates);
    let seen = Seen {
        pictures: &pictures,
        groups: &groups,
        params: &params,
    };
    let mut bars = StageBars::new(progress);
    let with = |refined: &Refined| {
        let mut changed = dataset.clone();
        for (k, i) in positions.iter().enumerate() {
            let image = &mut changed.images[*i];
            if let Some(pose) = refined.cam_from_world[k] {
                image.cam_from_world = Some(pose);
            }
            let shrink = Shrink::of(&image.camera, max_side);
            image.camera = shrink.camera_back(&refined.cameras[group_of[k]]);
        }
        changed
    };
    if is_auto {
        let off = disagreement(&pictures, &groups, &given, &pairs, &params, &mut bars);
        let off = block_on(off).ok().flatten();
        match off {
            None => {
                return Ok(Some(
                    "left as they are: too few matches to judge them".to_owned(),
                ));
            }
            Some(off) if !off.is_large() => {
                return Ok(Some(format!(
                    "left as they are: matches lie {:.2} px from where they put them",
                    off.epipolar_px
                )));
            }
            Some(_) => {}
        }
    }
    let mut compared = None;
    if is_auto {
        // Pictures kept back judge by the poses that were given: what bends them too would agree with itself.
        let mut taught = given.clone();
        taught[held_range(given.len(), scene.hold_out_every)].fill(None);
        let trial = matched(&seen, &pairs, &taught, &mut bars)?;
        let trial = block_on(trial.adjust(&RefineParams::default(), &mut bars))?;
        let what = told(&trial, Ruler::of(dataset.units));
        if !trial.is_better() {
            return Ok(Some(format!(
                "left as they are: adjusting gained nothing ({what})"
            )));
        }
        let before = judged(dataset, extraction, scene)?;
        let after = judged(&with(&trial), extraction, scene)?;
        let both = format!("{} -> {}", before.told(dataset), after.told(dataset));
        if !after.is_better_than(&before) {
            return Ok(Some(format!("left as they are: {what}; {both}")));
        }
        compared = Some(both);
    }
    let refinement = matched(&seen, &pairs, &given, &mut bars)?;
    let refined = block_on(refinement.adjust(&RefineParams::default(), &mut bars))?;
    drop(bars);
    let what = told(&refined, Ruler::of(dataset.units));
    let changed = with(&refined);
    *dataset = changed;
    Ok(Some(match compared {
        Some(both) => format!("refined: {what}; {both}"),
        None => format!("refined: {what}"),
    }))
}

/// The pictures that are adjusted.
#[derive(Clone, Copy)]
struct Seen<'a> {
    pictures: &'a [Picture<'a>],
    groups: &'a [CameraGroup],
    params: &'a MotionParams,
}

/// Matches these pairs of pictures and verifies them.
fn matched<'a>(
    seen: &Seen<'a>,
    pairs: &[(usize, usize)],
    given: &'a [Option<CamFromWorld>],
    bars: &mut StageBars,
) -> Result<Refinement<'a>, MotionError> {
    let Seen {
        pictures,
        groups,
        params,
    } = *seen;
    block_on(async {
        let matches = match_candidates(pictures, groups, pairs, params, bars).await?;
        Refinement::new(pictures, groups, given, &matches, params, bars).await
    })
}

/// One group for each camera of the pictures, and the group of each picture.
fn groups(
    images: &[&DatasetImage],
    refines: bool,
) -> Result<(Vec<CameraGroup>, Vec<usize>), RefiningError> {
    let mut groups: Vec<CameraGroup> = Vec::new();
    let mut of_image = Vec::new();
    for image in images {
        let known = groups.iter().position(|g| g.camera == image.camera);
        if known.is_none() {
            let mut group = CameraGroup::given(image.camera);
            let is_simple = matches!(
                image.camera.model,
                CameraModel::SimplePinhole { .. } | CameraModel::SimpleRadial { .. }
            );
            if refines && !is_simple {
                return Err(RefiningError::Camera(image.camera.model.name()));
            }
            group.refines = refines;
            groups.push(group);
        }
        of_image.push(known.unwrap_or(groups.len() - 1));
    }
    Ok((groups, of_image))
}

fn told(refined: &Refined, ruler: Ruler) -> String {
    format!(
        "matches lie {:.2} -> {:.2} px from their lines, cameras moved {} and {:.2} deg (median)",
        refined.before.epipolar_px,
        refined.after.epipolar_px,
        ruler.text(refined.moved),
        refined.turned_rad.to_degrees()
    )
}

/// What poses are worth.
struct Judged {
    stats: TrackStats,
    measured: Option<Measured>,
}

fn judged(
    dataset: &Dataset,
    extraction: &Extraction,
    scene: &SceneRequest,
) -> Result<Judged, TeachError> {
    let (made, stats) = labels(dataset, extraction, false, &mut ())?;
    let measured = measure_landmarks(&made, scene, &mut ())?;
    Ok(Judged { stats, measured })
}

impl Judged {
    /// Longer tracks, more labels, and pictures kept back that are located at least as well.
    fn is_better_than(&self, other: &Self) -> bool {
        let located = match (&self.measured, &other.measured) {
            (Some(own), Some(others)) => {
                let (own, others) = (&own.held_out, &others.held_out);
                own.num_not_located <= others.num_not_located
                    && match (own.median_position, others.median_position) {
                        (Some(own), Some(others)) => own <= others,
                        (_, None) => true,
                        (None, Some(_)) => false,
                    }
            }
            // Nothing is kept back.
            _ => true,
        };
        located
            && self.stats.mean_track_length >= other.stats.mean_track_length
            && self.stats.labelled_keypoints >= other.stats.labelled_keypoints
    }

    fn told(&self, dataset: &Dataset) -> String {
        let held = self.measured.and_then(|m| m.held_out.median_position);
        let held = held.map_or(String::new(), |m| {
            format!(", kept back {}", Ruler::of(dataset.units).text(m))
        });
        format!(
            "tracks {:.1} views, {:.0} labels a picture{held}",
            self.stats.mean_track_length, self.stats.labelled_keypoints
        )
    }
}
