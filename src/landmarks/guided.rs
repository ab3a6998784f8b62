//! Guided matching: with a pose that is roughly right, landmarks are looked for where they should be.
//!
//! Each round projects the landmarks that the pose shows, pairs them with the keypoints in a window by descriptor (best for the
//! landmark and for the keypoint), does the same for lines ([`super::lines`]), and refines the pose from both; windows and
//! thresholds shrink. What is found again in the end, of what should be seen, tells right poses from wrong ones.

use super::Landmarks;
use super::code::{CODE_BITS, similarity};
use super::grid::PixelGrid;
use super::intrinsics::{CameraCheck, SolvedCamera};
use super::lines::{LineMatcher, LineWindow};
use super::recall::Votes;
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera, Pixel};
use crate::math::elementary::logistic;
use crate::pose::{
    self, LineCorrespondence, PointCorrespondence, PoseError, PoseOptions, PoseOutcome, PoseScratch,
};

/// One round of a look, for a working image of 640 pixels; lengths in its pixels.
#[derive(Debug, Clone, Copy)]
struct Round {
    window: f64,
    line_window: f64,
    max_point_error: f64,
    max_line_error: f64,
}

const ROUNDS: [Round; 3] = [
    Round {
        window: 24.0,
        line_window: 12.0,
        max_point_error: 10.0,
        max_line_error: 10.0,
    },
    Round {
        window: 12.0,
        line_window: 8.0,
        max_point_error: 6.0,
        max_line_error: 6.0,
    },
    Round {
        window: 6.0,
        line_window: 5.0,
        max_point_error: 4.0,
        max_line_error: 5.0,
    },
];

/// Similarities below this are no match.
pub(super) const LEAST_SIMILARITY: f32 = 0.35;
/// From similarity to the probability of being right: slope and middle of the logistic.
const POINT_BELIEF: (f64, f64) = (12.0, 0.42);
/// Standard deviation of a keypoint in pixels: they are whole pixels.
const SIGMA_PX: f64 = 0.7;
/// The same of matches in wide windows, which are right less often.
const WIDE_SIGMA_PX: f64 = 1.4;
/// A landmark within this many pixels of its keypoint is found again.
const FOUND_PX: f32 = 3.0;
/// Landmarks nearer to the border than this need not be found.
const BORDER_PX: f64 = 8.0;
/// Fewer matches are not refined.
const MIN_MATCHES: usize = 6;

/// What is taken into a look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LookOptions {
    /// Match points.
    pub points: bool,
    /// Match lines.
    pub lines: bool,
}

impl Default for LookOptions {
    fn default() -> Self {
        Self {
            points: true,
            lines: true,
        }
    }
}

/// How much of what should be seen was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FoundAgain {
    /// Points that the pose shows.
    pub visible_points: u32,
    /// Of them those with a keypoint of like descriptor where they should be.
    pub found_points: u32,
    /// Lines that the pose shows.
    pub visible_lines: u32,
    /// Of them those with a segment where they should be.
    pub found_lines: u32,
}

impl FoundAgain {
    /// Share of the visible landmarks that were found, 0 to 1.
    pub fn share(&self) -> f64 {
        let visible = self.visible_points + self.visible_lines;
        f64::from(self.found_points + self.found_lines) / f64::from(visible.max(1))
    }
}

/// A landmark where the pose puts it.
#[derive(Debug, Clone, Copy)]
struct Visible {
    landmark: u32,
    pixel: Pixel,
}

#[derive(Debug, Clone, Copy)]
struct Best {
    similarity: f32,
    /// Index in the list of visible landmarks, or of keypoints.
    of: u32,
}

/// Index of nothing.
pub(super) const NO_MATCH: u32 = u32::MAX;

const NONE: Best = Best {
    similarity: LEAST_SIMILARITY,
    of: NO_MATCH,
};

/// Probability that a match of this similarity is right.
pub(super) fn belief(similarity: f32) -> f32 {
    let (slope, middle) = POINT_BELIEF;
    logistic(slope * (f64::from(similarity) - middle)) as f32
}

/// Pixels of a camera's picture to one of 640.
fn unit(camera: &Camera) -> f64 {
    (f64::from(camera.width.max(camera.height)) / 640.0).max(0.25)
}

/// The solver's options in a round.
fn round_options(options: &PoseOptions, round: &Round, unit: f64) -> PoseOptions {
    PoseOptions {
        max_point_error_px: round.max_point_error * unit,
        max_line_error_px: round.max_line_error * unit,
        sigma_px: SIGMA_PX * unit,
        ..*options
    }
}

/// Buffers of the guided matcher, and the correspondences of its last look.
#[derive(Debug, Default)]
pub struct SecondLook {
    grid: PixelGrid,
    queries: Vec<[f32; CODE_BITS]>,
    visible: Vec<Visible>,
    best_of_landmark: Vec<Best>,
    best_of_keypoint: Vec<Best>,
    lines: LineMatcher,
    check: CameraCheck,
    votes: Votes,
    points_found: Vec<PointCorrespondence>,
    points_aside: Vec<PointCorrespondence>,
    lines_found: Vec<LineCorrespondence>,
    is_loaded: bool,
}

impl SecondLook {
    /// Takes over the features of a frame, in pixels of a picture of this size. `false` when they have no descriptors of the
    /// landmarks' kind; nothing can be looked for then.
    pub fn load(&mut self, landmarks: &Landmarks, features: &FeatureSet, size: (u32, u32)) -> bool {
        let channels = landmarks.descriptor_channels();
        let num = features.keypoints.len();
        self.is_loaded = features.descriptor_channels == channels
            && features.descriptors_nd.len() == num * channels;
        if !self.is_loaded {
            return false;
        }
        self.grid.load(&features.keypoints, size);
        self.queries.clear();
        self.queries.resize(num, [0.0; CODE_BITS]);
        for (query, row) in self
            .queries
            .iter_mut()
            .zip(features.descriptors_nd.chunks_exact(channels))
        {
            landmarks.point_code.query(row, query);
        }
        self.lines.load(landmarks, features);
        true
    }

    /// A first pose from the landmarks of those clusters of views for which the keypoints vote.
    ///
    /// # Errors
    /// [`PoseError`] as [`pose::estimate`].
    pub fn recall(
        &mut self,
        landmarks: &Landmarks,
        features: &FeatureSet,
        camera: &Camera,
        options: &PoseOptions,
        scratch: &mut PoseScratch,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<PoseOutcome, PoseError> {
        self.votes
            .correspond(landmarks, features, &self.queries, &mut self.points_found);
        pose::estimate(&self.points_found, &[], camera, options, scratch, clock)
    }

    /// Looks again from a pose: `start` with this camera, whose focal length is refined as the options say. `None` where too
    /// little is found. The scratch holds the inliers of the last round afterwards.
    ///
    /// # Errors
    /// [`PoseError`] as [`pose::refine`].
    #[expect(
        clippy::too_many_arguments,
        reason = "the frame, the scene and the solver with its scratch"
    )]
    pub fn look(
        &mut self,
        landmarks: &Landmarks,
        features: &FeatureSet,
        camera: &Camera,
        start: &CamFromWorld,
        take: LookOptions,
        options: &PoseOptions,
        scratch: &mut PoseScratch,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Option<(PoseOutcome, FoundAgain)>, PoseError> {
        if !self.is_loaded {
            return Ok(None);
        }
        let unit = unit(camera);
        let (mut camera, mut cam_from_world) = (*camera, *start);
        let mut last = None;
        for round in &ROUNDS {
            self.match_points(
                landmarks,
                features,
                &camera,
                &cam_from_world,
                round.window * unit,
                take.points,
            );
            let window = LineWindow {
                distance: round.line_window * unit,
                wanted: take.lines,
            };
            self.lines.find(
                landmarks,
                features,
                &camera,
                &cam_from_world,
                window,
                &mut self.lines_found,
            );
            if self.points_found.len() + self.lines_found.len() < MIN_MATCHES {
                return Ok(None);
            }
            let options = round_options(options, round, unit);
            let outcome = pose::refine(
                &self.points_found,
                &self.lines_found,
                &camera,
                &cam_from_world,
                &options,
                scratch,
                clock,
            )?;
            let Some(estimate) = &outcome.estimate else {
                return Ok(None);
            };
            camera = estimate.camera;
            cam_from_world = estimate.cam_from_world;
            last = Some(outcome);
        }
        let found = self.found_again(scratch, &camera, unit);
        Ok(last.map(|outcome| (outcome, found)))
    }

    /// The camera that the matches of the last look ask for, which gave this camera and pose; `None` where the camera fits or they
    /// leave it open. `is_doubted` where the camera is one that was solved here already: small changes count then.
    pub fn other_camera(
        &mut self,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        is_doubted: bool,
    ) -> Option<SolvedCamera> {
        let sigma_px = SIGMA_PX * unit(camera);
        let points = &self.points_found;
        self.check
            .solve(points, camera, cam_from_world, sigma_px, is_doubted)
    }

    /// How well matches, which gave this camera and pose, tell the focal length beside the pose: standard deviation of ln f, large
    /// before a flat wall. `None` where they are too few.
    pub fn focal_sigma_ln(
        &mut self,
        points: &[PointCorrespondence],
        camera: &Camera,
        cam_from_world: &CamFromWorld,
    ) -> Option<f64> {
        let sigma_px = SIGMA_PX * unit(camera);
        self.check
            .focal_sigma_ln(points, camera, cam_from_world, sigma_px)
    }

    /// The same from matches in the windows of the first round: those of the last one draw towards a wrong projection, and may hide
    /// that it is wrong. The matches of the last look stay.
    pub fn other_camera_in_wide_windows(
        &mut self,
        landmarks: &Landmarks,
        features: &FeatureSet,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
    ) -> Option<SolvedCamera> {
        core::mem::swap(&mut self.points_found, &mut self.points_aside);
        let window = ROUNDS[0].window * unit(camera);
        self.match_points(landmarks, features, camera, cam_from_world, window, true);
        core::mem::swap(&mut self.points_found, &mut self.points_aside);
        let sigma_px = WIDE_SIGMA_PX * unit(camera);
        let points = &self.points_aside;
        self.check
            .solve(points, camera, cam_from_world, sigma_px, false)
    }

    /// Points of the last round of the last look.
    pub fn points(&self) -> &[PointCorrespondence] {
        &self.points_found
    }

    /// Lines of the last round of the last look.
    pub fn lines(&self) -> &[LineCorrespondence] {
        &self.lines_found
    }

    /// What the last round saw and found.
    fn found_again(&self, scratch: &PoseScratch, camera: &Camera, unit: f64) -> FoundAgain {
        let border = BORDER_PX * unit;
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let is_inside = |v: &&Visible| {
            let p = v.pixel;
            p.x > border && p.y > border && p.x < width - border && p.y < height - border
        };
        let limit = FOUND_PX * unit as f32;
        let errors = scratch.point_errors_px();
        FoundAgain {
            visible_points: self.visible.iter().filter(is_inside).count() as u32,
            found_points: errors.iter().filter(|e| **e < limit).count() as u32,
            visible_lines: self.lines.num_visible(),
            found_lines: scratch.inliers().lines.len() as u32,
        }
    }

    /// Pairs the landmarks that the pose shows with keypoints in the window around them.
    fn match_points(
        &mut self,
        landmarks: &Landmarks,
        features: &FeatureSet,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        window: f64,
        wanted: bool,
    ) {
        self.visible.clear();
        self.points_found.clear();
        if !wanted {
            return;
        }
        let center = cam_from_world.center_in_world();
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        for (i, landmark) in landmarks.points.iter().enumerate() {
            let x = &landmark.point_in_world;
            let z = cam_from_world.transform_point(x);
            if !(z.z > 0.0) || !landmark.visibility.holds(&(center - x)) {
                continue;
            }
            if let Some(pixel) = camera.pixel_from_cam(&z)
                && pixel.x >= 0.0
                && pixel.y >= 0.0
                && pixel.x < width
                && pixel.y < height
            {
                let landmark = i as u32;
                self.visible.push(Visible { landmark, pixel });
            }
        }
        self.best_of_keypoint.clear();
        self.best_of_keypoint.resize(features.keypoints.len(), NONE);
        self.best_of_landmark.clear();
        let limit = window * window;
        for (v, visible) in self.visible.iter().enumerate() {
            let code = &landmarks.point_codes[visible.landmark as usize];
            let mut best = NONE;
            let at = visible.pixel;
            let keypoints = &features.keypoints;
            let (queries, best_of_keypoint) = (&self.queries, &mut self.best_of_keypoint);
            self.grid.around(at.x, at.y, window, |k| {
                let p = keypoints[k as usize].pixel;
                let (dx, dy) = (p.x - at.x, p.y - at.y);
                if dx * dx + dy * dy > limit {
                    return;
                }
                let similarity = similarity(&queries[k as usize], code);
                if similarity > best.similarity {
                    best = Best { similarity, of: k };
                }
                let other = &mut best_of_keypoint[k as usize];
                if similarity > other.similarity {
                    *other = Best {
                        similarity,
                        of: v as u32,
                    };
                }
            });
            self.best_of_landmark.push(best);
        }
        for (k, (keypoint, best)) in features
            .keypoints
            .iter()
            .zip(&self.best_of_keypoint)
            .enumerate()
        {
            let Some(back) = self.best_of_landmark.get(best.of as usize) else {
                continue;
            };
            if back.of != k as u32 {
                continue;
            }
            let landmark = &landmarks.points[self.visible[best.of as usize].landmark as usize];
            self.points_found.push(PointCorrespondence {
                pixel: keypoint.pixel,
                point_in_world: landmark.point_in_world,
                confidence: belief(best.similarity),
                sigma_m: landmark.sigma as f32,
                sigma_px: 0.0,
            });
        }
    }
}
