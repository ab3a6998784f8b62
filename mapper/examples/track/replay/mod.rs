//! Plays recorded pictures as a camera's video, with a relocalizer beside it that takes as long as one does in a browser.
//!
//! * **In and out**: pictures with true poses, in order; figures of what would stand on the screen at every frame.
//! * **Method**: every frame is located once by itself. Then time is simulated: the relocalizer takes the newest frame whenever
//!   it is idle and its answer arrives a latency later, which runs evenly from the shortest to the longest. *Before* shows the
//!   last answer over the newest frame, *after* the pose of [`Follower`].
//! * **Spaces and units**: overlay errors are distances in pixels of the frame between world points drawn by the shown pose and by
//!   the true one, median over the points of a frame.

mod figures;
mod soak;
mod video;

pub(crate) use figures::{Figures, Shown, quantile};
pub(crate) use soak::soak;
pub(crate) use video::{Picture, Video, rendered};

use anyhow::{Context, Result};
use landline::geometry::{CamFromWorld, Camera};
use landline::image::{FrameView, PixelFormat};
use landline::pose::{LineCorrespondence, PointCorrespondence};
use landline::relocalizer::{Query, Relocalizer};
use landline::session::{Answer, FollowOptions, FollowReport, Follower};
use nalgebra::{Matrix6, Vector3};
use std::time::Instant;

/// What the relocalizer says about one frame.
#[derive(Debug, Clone)]
pub(crate) struct Located {
    cam_from_world: CamFromWorld,
    covariance: Matrix6<f64>,
    camera: Camera,
    points: Vec<PointCorrespondence>,
    lines: Vec<LineCorrespondence>,
}

impl Located {
    /// The pose.
    pub(crate) fn pose(&self) -> CamFromWorld {
        self.cam_from_world
    }

    fn answer(&self, frame: u64) -> Answer {
        Answer {
            frame,
            camera: self.camera,
            cam_from_world: self.cam_from_world,
            covariance: self.covariance,
        }
    }
}

/// How the relocalizer is simulated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Simulation {
    /// Pictures a second.
    pub(crate) fps: f64,
    /// Shortest and longest time from a frame to its answer.
    pub(crate) latency_ms: (f64, f64),
    /// No answers arrive after this time.
    pub(crate) answers_until_ms: f64,
}

impl Picture {
    /// As the core takes it.
    pub(crate) fn view(&self) -> FrameView<'_> {
        let (width, height) = (self.camera.width, self.camera.height);
        FrameView::tight(&self.rgb, width, height, PixelFormat::Rgb8)
    }
}

/// Locates every frame by itself.
///
/// # Errors
/// When a frame is refused.
pub(crate) fn locate_all(
    relocalizer: &mut Relocalizer,
    video: &Video,
    mut done: impl FnMut(),
) -> Result<Vec<Option<Located>>> {
    let start = Instant::now();
    let mut clock = || start.elapsed().as_secs_f64() * 1e3;
    let mut all = Vec::with_capacity(video.pictures.len());
    for (i, picture) in video.pictures.iter().enumerate() {
        let query = Query::with_camera(picture.camera);
        let report = relocalizer
            .locate(&picture.view(), &query, &mut clock)
            .with_context(|| format!("locating frame {i}"))?;
        all.push(report.outcome.located().map(|l| Located {
            cam_from_world: l.cam_from_world,
            covariance: l.estimate.covariance,
            camera: report.camera,
            points: agreeing(relocalizer.points()),
            lines: agreeing(relocalizer.lines()),
        }));
        done();
    }
    Ok(all)
}

fn agreeing<T>(all: impl Iterator<Item = (T, bool)>) -> Vec<T> {
    all.filter(|(_, agrees)| *agrees).map(|(c, _)| c).collect()
}

/// Hands an answer to a follower.
fn hand_over(follower: &mut Follower, located: &Located, frame: u64) {
    let (points, lines) = (
        located.points.iter().copied(),
        located.lines.iter().copied(),
    );
    follower.localized(&located.answer(frame), points, lines);
}

/// What both ways show at every frame from the first answer on.
#[derive(Debug, Clone, Default)]
pub(crate) struct Replay {
    /// The last answer over the newest frame.
    pub(crate) before: Vec<Shown>,
    /// The follower's pose.
    pub(crate) after: Vec<Shown>,
    /// Reports of the follower.
    pub(crate) reports: Vec<FollowReport>,
    /// The follower's time for each frame.
    pub(crate) frame_ms: Vec<f64>,
    /// The follower's time for each answer.
    pub(crate) answer_ms: Vec<f64>,
    /// Of the last answer that was taken: its frame.
    pub(crate) last_answer: Option<usize>,
}

/// Simulates.
///
/// # Errors
/// When a frame is refused.
pub(crate) fn replay(
    video: &Video,
    located: &[Option<Located>],
    simulation: &Simulation,
    options: FollowOptions,
) -> Result<Replay> {
    let mut follower = Follower::new(options);
    let mut out = Replay::default();
    let (shortest, longest) = simulation.latency_ms;
    let mut under_way: Option<(usize, f64)> = None;
    let mut num_asked = 0_usize;
    let mut last: Option<CamFromWorld> = None;
    for (i, picture) in video.pictures.iter().enumerate() {
        let now_ms = i as f64 * 1e3 / simulation.fps;
        if let Some((frame, at)) = under_way
            && at <= now_ms
        {
            under_way = None;
            let start = Instant::now();
            match &located[frame] {
                Some(answer) => {
                    hand_over(&mut follower, answer, frame as u64);
                    last = Some(answer.cam_from_world);
                    out.last_answer = Some(frame);
                }
                None => follower.not_located(frame as u64),
            }
            out.answer_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        let start = Instant::now();
        let report = follower
            .frame(&picture.view(), now_ms, None)
            .with_context(|| format!("following frame {i}"))?;
        out.frame_ms.push(start.elapsed().as_secs_f64() * 1e3);
        if under_way.is_none() && now_ms <= simulation.answers_until_ms {
            // Even steps that do not repeat with the frames.
            let share = (num_asked as f64 * 0.618_034).fract();
            num_asked += 1;
            follower.hold(report.frame);
            under_way = Some((i, now_ms + shortest + share * (longest - shortest)));
        }
        if out.last_answer.is_some() {
            let shown = |pose: Option<CamFromWorld>| Shown::at(i, pose, video, located);
            out.before.push(shown(last));
            out.after.push(shown(report.pose.map(|p| p.cam_from_world)));
        }
        out.reports.push(report);
    }
    Ok(out)
}

/// Each frame with its own answer, as if it came at once.
pub(crate) fn at_once(video: &Video, located: &[Option<Located>]) -> Vec<Shown> {
    let all = located.iter().enumerate();
    all.map(|(i, l)| Shown::at(i, l.as_ref().map(|l| l.cam_from_world), video, located))
        .collect()
}

/// World points that an application might mark in a frame: what the room has behind a grid of pixels, else where the scene puts
/// the points that agree in the frame.
fn marks<'a>(frame: usize, video: &'a Video, located: &'a [Option<Located>]) -> Vec<Vector3<f64>> {
    let picture = &video.pictures[frame];
    if !picture.marks.is_empty() {
        return picture.marks.clone();
    }
    let answer = located[frame].as_ref();
    answer.map_or_else(Vec::new, |l| {
        l.points.iter().map(|p| p.point_in_world).collect()
    })
}
