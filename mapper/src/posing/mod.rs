//! From pictures or a video without poses to a COLMAP model: features, matches, structure from motion, one folder.

mod page;
mod plots;

use crate::dataset::{DatasetImage, MODEL_FILES};
use crate::extract::{ExtractError, Extraction};
use crate::files;
use crate::metres::{Metres, MetresError};
use crate::progress::{Progress, StageBars};
use crate::unposed::{self, Found, UnposedError};
use crate::working::Shrink;
use landline::geometry::Camera;
use landline::reconstruction::motion::{
    CameraGroup, Component, LeftOut, MIN_APART_LN, Motion, MotionError, MotionParams, Picture,
    match_pictures, reconstruct_motion,
};
use pollster::block_on;
use std::fmt::Write as _;
use std::hash::{Hash as _, Hasher as _};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Why pictures could not be posed.
#[derive(Debug, thiserror::Error)]
pub enum PosingError {
    /// There are no pictures to pose.
    #[error(transparent)]
    Unposed(#[from] UnposedError),
    /// A picture or the cache cannot be read.
    #[error(transparent)]
    Extract(#[from] ExtractError),
    /// Nothing can be reconstructed.
    #[error(transparent)]
    Motion(MotionError),
    /// The given focal length is not that of the pictures. What they say meanwhile is nearer and no answer yet.
    #[error(
        "the focal length that was given, {given_px:.0} pixels, is too {} for these pictures: leave it out, they tell it by \
         themselves; or give the camera's own, of the pictures as they are (a crop or a zoom has another)",
        if *is_longer { "long" } else { "short" }
    )]
    Focal {
        /// As given.
        given_px: f64,
        /// Whether it is longer than what the pictures say.
        is_longer: bool,
    },
    /// What is said about lengths does not fit.
    #[error(transparent)]
    Metres(#[from] MetresError),
    /// What is said about the camera cannot be.
    #[error("{0}")]
    Camera(String),
    /// The model cannot be written.
    #[error("the model: {0}")]
    Write(#[from] std::io::Error),
}

impl From<MotionError> for PosingError {
    fn from(error: MotionError) -> Self {
        match error {
            MotionError::Focal {
                given_px, seen_px, ..
            } => Self::Focal {
                given_px,
                is_longer: given_px > seen_px,
            },
            other => Self::Motion(other),
        }
    }
}

/// What is known beforehand.
#[derive(Debug, Clone, PartialEq)]
pub struct PosingRequest {
    /// Folder of pictures, or a video.
    pub pictures: PathBuf,
    /// Focal length of all pictures, in pixels.
    pub focal_px: Option<f64>,
    /// The camera of all pictures.
    pub camera: Option<Camera>,
    /// The pictures are not in the order in which they were taken.
    pub is_unordered: bool,
    /// Frames of a video that are taken for each second of it.
    pub frames_per_second: f64,
    /// How long one unit of length is.
    pub metres: Option<Metres>,
}

/// A written model.
#[derive(Debug, Clone, PartialEq)]
pub struct Posed {
    /// Where the pictures are: of a video, its frames.
    pub pictures: PathBuf,
    /// What came out, for people.
    pub summary: String,
    /// A page with the camera's way, the points, and what was left out.
    pub report: PathBuf,
}

/// Widths of the picture that a focal length may have.
const FOCALS: std::ops::RangeInclusive<f64> = 0.1..=20.0;

const REPORT_FILE: &str = "report.html";

/// All that [`pose_pictures`] puts into its folder.
pub const POSED_FILES: [&str; 7] = {
    let [a, b, c, d, e, f] = MODEL_FILES;
    [a, b, c, d, e, f, REPORT_FILE]
};

/// Poses pictures and writes the largest piece as a COLMAP model into `out`, with a report; frames of a video lie beside it.
///
/// # Errors
/// When there are too few pictures, they cannot be read, nothing can be reconstructed, or the disk refuses.
pub fn pose_pictures(
    request: &PosingRequest,
    extraction: &Extraction,
    out: &Path,
    progress: Progress,
) -> Result<Posed, PosingError> {
    let start = Instant::now();
    let folder = frames(request, out)?;
    let found = unposed::find_pictures(&folder)?;
    let unread = found.unread();
    let Found { images, unreadable } = found;
    for image in &images {
        check_camera(request, image.camera.width, image.camera.height)?;
    }
    let names: Vec<&str> = images.iter().map(|i| i.name.as_str()).collect();
    if let Some(metres) = &request.metres {
        metres.check(&names)?;
    }
    let (mut groups, group_of) = unposed::group_cameras(&images, |w, h| {
        let known = request.camera.map(CameraGroup::given);
        known.or_else(|| request.focal_px.map(|f| unposed::with_focal(w, h, f)))
    });
    let chosen: Vec<&DatasetImage> = images.iter().collect();
    let mut features = extraction.all(&chosen, progress)?;
    let shrinks: Vec<Shrink> = images
        .iter()
        .map(|image| Shrink::of(&image.camera, extraction.options().max_side))
        .collect();
    for (features, shrink) in features.iter_mut().zip(&shrinks) {
        shrink.features(features);
    }
    for (i, group) in groups.iter_mut().enumerate() {
        if let Some(first) = first_of(&group_of, i) {
            group.camera = shrinks[first].camera(&group.camera);
        }
    }
    let pictures: Vec<Picture<'_>> = features
        .iter()
        .zip(&group_of)
        .map(|(features, camera)| Picture {
            features,
            camera: *camera,
        })
        .collect();
    let after_features = Instant::now();
    let mut params = MotionParams::default();
    params.candidates.is_video = !request.is_unordered;
    let mut bars = StageBars::new(progress);
    let matches = block_on(match_pictures(&pictures, &groups, &params, &mut bars))?;
    let mut motion = block_on(reconstruct_motion(
        &pictures, &groups, &matches, &params, &mut bars,
    ))?;
    drop(bars);
    for (features, shrink) in features.iter_mut().zip(&shrinks) {
        shrink.features_back(features);
    }
    into_sensor_pixels(&mut motion, &shrinks, &group_of);
    let mut summary = String::new();
    for text in &unread {
        line(&mut summary, format_args!("not read         {text}"));
    }
    let doubts = doubts(&motion, &names, !request.is_unordered);
    describe(&motion, &names, &doubts, &mut summary);
    if let (Some(metres), Some(largest)) = (&request.metres, motion.components.first_mut()) {
        let said = metres.apply(largest, &names)?;
        line(&mut summary, format_args!("{said}"));
    }
    line(
        &mut summary,
        format_args!(
            "time             features {:.1} s, matching and poses {:.1} s",
            (after_features - start).as_secs_f64(),
            after_features.elapsed().as_secs_f64()
        ),
    );
    // Reprojection errors do not show a stretch in the wrong place.
    line(
        &mut summary,
        format_args!(
            "check            experimental: look at the points and the camera's way before you rely on them"
        ),
    );
    let report = out.join(REPORT_FILE);
    if let [best, ..] = motion.components.as_slice() {
        unposed::written(best, &images, &features, &motion.camera_of).write(out)?;
        let page = page::page(&page::Subject {
            names: &names,
            features: &features,
            unreadable: &unreadable,
            motion: &motion,
            doubts: &doubts,
            unit: if request.metres.is_some() { "m" } else { "" },
        })?;
        files::write_bytes(&report, page.as_bytes())?;
    }
    Ok(Posed {
        pictures: folder,
        summary,
        report,
    })
}

/// Takes what was found in shrunk pictures into pixels of these as they are; `group_of` is the group of each that was asked for.
fn into_sensor_pixels(motion: &mut Motion, shrinks: &[Shrink], group_of: &[usize]) {
    for component in &mut motion.components {
        for (i, camera) in component.cameras.iter_mut().enumerate() {
            if let Some(first) = first_of(&motion.camera_of, i) {
                *camera = shrinks[first].camera_back(camera);
            }
        }
        for point in &mut component.points {
            let first = point.observations.first().map_or(0, |o| o.view as usize);
            point.mean_error_px *= shrinks[first].sensor_px() as f32;
        }
        let registered = component.cam_from_world.iter().position(Option::is_some);
        component.rms_px *= registered.map_or(1.0, |first| shrinks[first].sensor_px());
    }
    for (i, votes) in motion.focal_votes_px.iter_mut().enumerate() {
        if let Some(first) = first_of(group_of, i) {
            let factor = shrinks[first].sensor_px();
            votes.iter_mut().for_each(|px| *px *= factor);
        }
    }
}

/// The first picture of a camera group.
fn first_of(group_of: &[usize], group: usize) -> Option<usize> {
    group_of.iter().position(|g| *g == group)
}

/// The folder of pictures; of a video, its frames, which are used again when they are there.
fn frames(request: &PosingRequest, out: &Path) -> Result<PathBuf, PosingError> {
    if !request.pictures.is_file() {
        return Ok(request.pictures.clone());
    }
    let rate = request.frames_per_second;
    if !(rate > 0.0 && rate <= 60.0) {
        return Err(PosingError::Camera(format!(
            "--frames-per-second is {rate}: expected a number above 0, at most 60"
        )));
    }
    let folder = folder_of_frames(&request.pictures, rate, out)?;
    if !folder.is_dir() {
        unposed::extract_frames(&request.pictures, &folder, rate)?;
    }
    Ok(folder)
}

/// Where a video's frames lie. Those of another video, or of the same one filmed anew, are others.
fn folder_of_frames(video: &Path, rate: f64, out: &Path) -> Result<PathBuf, UnposedError> {
    let identity = std::fs::metadata(video).and_then(|m| Ok((m.len(), m.modified()?)));
    let identity = identity.map_err(|source| UnposedError::Io {
        path: video.to_owned(),
        source,
    })?;
    let mut hash = std::hash::DefaultHasher::new();
    (video, identity).hash(&mut hash);
    let mut name = out.as_os_str().to_owned();
    name.push(format!(".frames-{rate}-{:08x}", hash.finish() as u32));
    Ok(PathBuf::from(name))
}

/// Refuses focal lengths that no camera has.
///
/// # Errors
/// [`PosingError::Camera`].
pub fn check_focal(focal_px: f64, width: u32, height: u32) -> Result<(), PosingError> {
    let side = f64::from(width.max(height));
    if FOCALS.contains(&(focal_px / side)) {
        return Ok(());
    }
    Err(PosingError::Camera(format!(
        "--focal is {focal_px}: for pictures of {width} x {height} expected {} to {} pixels",
        FOCALS.start() * side,
        FOCALS.end() * side
    )))
}

fn check_camera(request: &PosingRequest, width: u32, height: u32) -> Result<(), PosingError> {
    if let Some(focal) = request.focal_px {
        check_focal(focal, width, height)?;
    }
    if let Some(camera) = &request.camera
        && (camera.width, camera.height) != (width, height)
    {
        return Err(PosingError::Camera(format!(
            "--camera is for pictures of {} x {}, but there is one of {width} x {height}",
            camera.width, camera.height
        )));
    }
    Ok(())
}

/// What came out, a line each.
fn describe(motion: &Motion, names: &[&str], doubts: &[String], out: &mut String) {
    let counts = &motion.num_pairs;
    line(
        out,
        format_args!(
            "pairs            {} matched, {} verified: {} general, {} planar, {} turned only; {} loops rejected",
            counts.matched,
            counts.verified,
            counts.general,
            counts.planar,
            counts.turned,
            motion.rejected_loops.len()
        ),
    );
    for (i, component) in motion.components.iter().enumerate() {
        line(
            out,
            format_args!(
                "{}          {} of {} pictures, {} points, reprojection {:.2} px (rms)",
                if i == 0 { "written" } else { "another" },
                component.num_registered(),
                names.len(),
                component.points.len(),
                component.rms_px
            ),
        );
    }
    for doubt in doubts {
        line(out, format_args!("{doubt}"));
    }
    if let [largest, rest @ ..] = motion.components.as_slice() {
        for camera in &largest.cameras {
            let (f, _) = camera.focal_px();
            line(out, format_args!("focal length     {f:.1} px"));
        }
        if !rest.is_empty() {
            line(
                out,
                format_args!(
                    "The pictures fall into {} pieces that could not be joined: film the way from one to the other.",
                    rest.len() + 1
                ),
            );
            // The camera of a piece's first picture, and its focal length.
            let focal = |c: &Component| {
                let first = c.cam_from_world.iter().position(Option::is_some)?;
                let group = motion.camera_of[first];
                Some((group, c.cameras[group].focal_px().0))
            };
            let zoom = focal(largest).and_then(|(group, px)| {
                let of_group = rest.iter().filter_map(focal).filter(|(g, _)| *g == group);
                let differs = |other: &f64| (other / px).ln().abs() > MIN_APART_LN;
                let other = of_group.map(|(_, other)| other).find(differs)?;
                Some((px, other))
            });
            if let Some((px, other)) = zoom {
                line(
                    out,
                    format_args!(
                        "Their focal lengths differ ({px:.0} and {other:.0} px): film without zoom, with one lens."
                    ),
                );
            }
        }
    }
    for reason in [
        LeftOut::NothingInCommon,
        LeftOut::OnlyTurned,
        LeftOut::TooFewPoints,
        LeftOut::NoPose,
    ] {
        let of_reason: Vec<&str> = motion
            .left_out
            .iter()
            .filter(|(_, r)| *r == reason)
            .map(|(i, _)| names[*i])
            .collect();
        if let [first, ..] = of_reason.as_slice() {
            line(
                out,
                format_args!(
                    "left out         {} pictures ({first} ...): {}",
                    of_reason.len(),
                    reason.message()
                ),
            );
        }
    }
}

/// Sentences about places of the written model that may be wrong: where it hangs together by little, and where a film's camera jumps.
fn doubts(motion: &Motion, names: &[&str], is_film: bool) -> Vec<String> {
    let Some(largest) = motion.components.first() else {
        return Vec::new();
    };
    let link = largest.weak_link();
    let link = link.map(|link| link.message(names[link.before], names[link.after]));
    let jump = largest.jump().filter(|_| is_film);
    let jump = jump.map(|jump| jump.message(names[jump.before], names[jump.after]));
    link.into_iter().chain(jump).collect()
}

fn line(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a string cannot fail.
    writeln!(out, "{text}").unwrap_or_default();
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    #[test]
    fn the_frames_of_another_film_are_never_taken_for_those_of_the_last() -> io::Result<()> {
        let root = std::env::temp_dir().join(format!("landline-films-{}", std::process::id()));
        std::fs::create_dir_all(&root)?;
        let out = root.join("room");
        let of = |name: &str, rate: f64| {
            folder_of_frames(&root.join(name), rate, &out).expect("the film is there")
        };
        std::fs::write(root.join("a.mp4"), b"a film")?;
        std::fs::write(root.join("b.mp4"), b"a film")?;
        let first = of("a.mp4", 2.0);
        assert!(first.display().to_string().contains("room.frames-2-"));
        assert_eq!(of("a.mp4", 2.0), first, "the same film");
        assert_ne!(of("b.mp4", 2.0), first, "another file");
        assert_ne!(of("a.mp4", 4.0), first, "more frames of it");
        std::fs::write(root.join("a.mp4"), b"filmed anew")?;
        assert_ne!(of("a.mp4", 2.0), first, "filmed anew under the same name");
        assert!(folder_of_frames(&root.join("none.mp4"), 2.0, &out).is_err());
        std::fs::remove_dir_all(&root)
    }

    #[test]
    fn a_wrong_focal_length_is_refused_without_another_that_would_be_refused_too() {
        for (given_px, seen_px, word) in [(900.0, 584.0, "too long"), (300.0, 431.0, "too short")] {
            let error = PosingError::from(MotionError::Focal {
                group: 0,
                given_px,
                seen_px,
            });
            let text = error.to_string();
            assert!(
                text.contains(word) && text.contains("leave it out"),
                "{text}"
            );
            assert!(!text.contains(&seen_px.to_string()), "{text}");
        }
    }
}
