//! Follows a camera from a localised picture through the next ones, without networks.
//!
//! * **In and out**: frames, by number; of one of them a pose with the points and lines that agree with it (the *reference*); a
//!   pose with its covariance for any later frame, or why there is none.
//! * **Spaces and units**: the caller deals in pixels of its frames and in the world; patches are compared in a working picture
//!   of at most [`TrackerOptions::max_side`] pixels.
//! * **Method**: patches of the reference, warped as the expected pose asks, are found by pyramidal inverse compositional
//!   Lucas-Kanade with light taken out and checked on the way back; edges along segments by the strongest step across them; the
//!   pose by [`pose::refine`] from all of them. Points and lines are moved onto the rays of the reference first, so that its
//!   pose explains its own picture exactly and later poses differ by the movement alone. Patches are always those of the
//!   reference, never of the frame before: nothing accumulates. Where nothing else says where a search should begin, small
//!   pictures of the frames, aligned as wholes, tell how the camera turned.
//! * **Invariants**: the same frames, calls and kernels give the same poses; a pose is finite or absent; frames may change their
//!   size, which ends the reference.
//! * **Cost**: about a thousand patch products of 256 pixels a frame; no allocation once sizes and numbers were seen.

mod edge;
mod flow;
mod kernels;
mod patch;
mod pyramid;
mod reference;
#[cfg(test)]
pub(crate) mod tests;
mod turn;

use crate::geometry::{CamFromWorld, Camera, WorkingFromSensor};
use crate::image::{FrameView, GrayImage, ImageError, gray_from_frame, working_from_gray};
use crate::pose::{self, LineCorrespondence, PointCorrespondence, PoseOptions, PoseScratch};
use crate::simd::Level;
use edge::Piece;
pub use flow::{Flow, PointFlow};
use nalgebra::{Matrix3, Matrix6, Vector3};
use patch::Back;
use pyramid::Ring;
use reference::{Reference, index_coordinates, pixel_at};
use turn::{Thumbnail, turn_between};

/// What a tracker may spend and believe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerOptions {
    /// Longest side of the working picture, in pixels.
    pub max_side: usize,
    /// Points of the reference that are looked for.
    pub max_points: usize,
    /// Lines of the reference that are looked for.
    pub max_lines: usize,
    /// Pictures that are kept for references that come late.
    pub ring: usize,
    /// Patches that correlate less than this are not found.
    pub min_correlation: f32,
    /// Patches that miss their origin on the way back by more than this are not found, in pixels.
    pub max_way_back_px: f32,
    /// Fewer found things that agree with the pose are not believed.
    pub min_inliers: usize,
    /// Nor is a smaller share of what was found, which in sharp pictures of a room at rest is nine tenths and more.
    pub min_inlier_share: f32,
    /// Vector instructions of the patches. [`Level::Portable`] gives the same bits on every machine and in the browser.
    pub kernels: Level,
}

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            max_side: 640,
            max_points: 160,
            max_lines: 120,
            ring: 14,
            min_correlation: 0.75,
            max_way_back_px: 0.7,
            min_inliers: 12,
            min_inlier_share: 0.6,
            kernels: Level::best(),
        }
    }
}

/// Standard deviation of a found patch, and of a found edge across it, in pixels. An edge is found along its whole length, and the
/// error of its depth does not move it along itself.
const POINT_SIGMA_PX: f32 = 0.3;
const LINE_SIGMA_PX: f32 = 0.2;
/// Found things further than this from the pose do not agree with it, in pixels.
const MAX_ERROR_PX: f64 = 3.0;
/// One of so many points that were looked for has to be found and to agree: chance finds one of fourteen in another picture.
/// Edges do not count for them: in a blurred or dark picture many of one direction slip to their neighbours together.
const POINT_SHARE: usize = 8;
/// A pose whose turn is known worse than this hangs on a few things in a corner of the picture: a degree moves what is drawn by
/// nine pixels of 640.
const MAX_TURN_RAD: f64 = 0.0175;
/// A template is made anew when the picture around its point is distorted by this much more: a quarter of a pixel at the patch's
/// corner.
const MAX_WARP: f32 = 0.03;

/// Small pictures of past frames, for turns between them: more than a second at sixty frames a second.
const THUMBNAILS: usize = 64;

/// A pose of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked {
    /// The pose.
    pub cam_from_world: CamFromWorld,
    /// Of (rotation vector in radians, translation), left perturbation: that of the reference, carried along, and that of the
    /// movement since.
    pub covariance: Matrix6<f64>,
    /// Points that were looked for, found, and agree.
    pub num_points: [usize; 3],
    /// Lines that were looked for, found, and agree.
    pub num_lines: [usize; 3],
    /// Median distance of what agrees, pixels of the frame.
    pub median_error_px: f64,
}

/// Why a frame has no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackLoss {
    /// There is no reference.
    NoReference,
    /// The frame is not kept any more, or never was.
    NoFrame,
    /// Frame and reference differ in size: another camera, or a turned one.
    Resized,
    /// Too little of the reference lies in the picture.
    OutOfView,
    /// Too little of it was found: blur, darkness, something in front of the camera.
    FewFound,
    /// What was found does not agree on one pose.
    Disagreement,
}

/// Follows one camera.
#[derive(Debug)]
pub struct Tracker {
    options: TrackerOptions,
    pose_options: PoseOptions,
    ring: Ring,
    /// By frame number modulo their count.
    thumbnails: Vec<(Option<u64>, Thumbnail)>,
    next_frame: u64,
    gray: GrayImage,
    working: GrayImage,
    /// Size of the last frame, and its map to the working picture.
    size: (u32, u32),
    working_from_sensor: WorkingFromSensor,
    reference: Reference,
    reference_size: (u32, u32),
    points: Vec<PointCorrespondence>,
    lines: Vec<LineCorrespondence>,
    errors_px: Vec<f64>,
    back: Back,
    pose: PoseScratch,
}

impl Default for Tracker {
    fn default() -> Self {
        Self::new(TrackerOptions::default())
    }
}

impl Tracker {
    /// A tracker without frames.
    pub fn new(options: TrackerOptions) -> Self {
        Self {
            options,
            pose_options: PoseOptions {
                sigma_px: f64::from(POINT_SIGMA_PX),
                max_point_error_px: MAX_ERROR_PX,
                max_line_error_px: MAX_ERROR_PX,
                ..PoseOptions::default()
            },
            ring: Ring::new(options.ring),
            thumbnails: (0..THUMBNAILS).map(|_| <_>::default()).collect(),
            next_frame: 0,
            gray: GrayImage::default(),
            working: GrayImage::default(),
            size: (0, 0),
            working_from_sensor: WorkingFromSensor::from_scale(1.0, 1.0),
            reference: Reference::default(),
            reference_size: (0, 0),
            points: Vec::new(),
            lines: Vec::new(),
            errors_px: Vec::new(),
            back: Back::default(),
            pose: PoseScratch::default(),
        }
    }

    /// The options in use.
    pub fn options(&self) -> &TrackerOptions {
        &self.options
    }

    /// Takes the next frame; its number. A change of size forgets the earlier frames and the reference.
    ///
    /// # Errors
    /// [`ImageError`] for a frame that makes no sense; nothing has changed then.
    pub fn push(&mut self, frame: &FrameView<'_>) -> Result<u64, ImageError> {
        gray_from_frame(frame, &mut self.gray)?;
        let map = working_from_gray(&self.gray.view(), self.options.max_side, &mut self.working)?;
        let size = (frame.width, frame.height);
        let is_new_size = size != self.size;
        if is_new_size {
            self.ring.clear();
            self.forget();
        }
        (self.size, self.working_from_sensor) = (size, map);
        let number = self.next_frame;
        self.next_frame += 1;
        self.ring
            .push(number, &self.working.view(), self.options.kernels);
        if let Some(pyramid) = self.ring.get(number) {
            if is_new_size {
                // All of them at once, so that later frames find their memory.
                for (of, thumbnail) in &mut self.thumbnails {
                    *of = None;
                    thumbnail.take(pyramid);
                }
            }
            let (of, thumbnail) = &mut self.thumbnails[number as usize % THUMBNAILS];
            *of = Some(number);
            thumbnail.take(pyramid);
        }
        Ok(number)
    }

    /// Keeps a frame's picture until a reference for it or a later one comes. False when it is gone already.
    pub fn hold(&mut self, frame: u64) -> bool {
        self.ring.hold(frame)
    }

    /// Whether a frame's picture is kept.
    pub fn has(&self, frame: u64) -> bool {
        self.ring.get(frame).is_some()
    }

    /// The newest frame up to the given one whose picture is kept.
    pub fn newest_up_to(&self, frame: u64) -> Option<u64> {
        self.ring.at_most(frame)
    }

    /// How the camera turned from one frame to a later one (`cam_to_from_cam_from`), as small pictures of them and of all frames
    /// between tell. `None` without a reference, whose camera is meant, and where pictures do not resemble each other or are
    /// gone.
    pub fn turned(&self, from: u64, to: u64) -> Option<Matrix3<f64>> {
        let camera = self.reference.camera?;
        if to.checked_sub(from)? >= THUMBNAILS as u64 || self.reference_size != self.size {
            return None;
        }
        let thumbnail = |frame: u64| {
            let (of, thumbnail) = &self.thumbnails[frame as usize % THUMBNAILS];
            (*of == Some(frame)).then_some(thumbnail)
        };
        let mut turn = Matrix3::identity();
        for frame in from..to {
            let (a, b) = (thumbnail(frame)?, thumbnail(frame + 1)?);
            turn = turn_between(a, b, &camera)? * turn;
        }
        Some(turn)
    }

    /// Forgets the reference.
    pub fn forget(&mut self) {
        self.reference.cam_from_world = None;
    }

    /// Whether there is a reference.
    pub fn has_reference(&self) -> bool {
        self.reference.cam_from_world.is_some()
    }

    /// Makes a frame the reference: its pose, and the points and lines that agree with it, in pixels of the frame.
    ///
    /// # Errors
    /// [`TrackLoss::NoFrame`] when its picture is gone, [`TrackLoss::Resized`] when the camera is not of its size,
    /// [`TrackLoss::FewFound`] when there is too little to follow. The earlier reference is gone in the last case.
    pub fn refer(
        &mut self,
        frame: u64,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        covariance: &Matrix6<f64>,
        points: impl Iterator<Item = PointCorrespondence>,
        lines: impl Iterator<Item = LineCorrespondence>,
    ) -> Result<(), TrackLoss> {
        let map = self.working_from_sensor;
        if (camera.width, camera.height) != self.size {
            return Err(TrackLoss::Resized);
        }
        let pyramid = self.ring.get(frame).ok_or(TrackLoss::NoFrame)?;
        self.points.clear();
        self.points.extend(points.map(|p| PointCorrespondence {
            pixel: map.apply(p.pixel),
            ..p
        }));
        self.lines.clear();
        self.lines.extend(lines.map(|l| LineCorrespondence {
            start: map.apply(l.start),
            end: map.apply(l.end),
            ..l
        }));
        self.reference.fill(
            pyramid,
            &camera.resized(&map),
            cam_from_world,
            covariance,
            &self.points,
            &self.lines,
            &self.options,
        );
        self.reference_size = self.size;
        self.ring.release(frame);
        let enough = self.reference.num_checked() + self.reference.lines.len();
        if enough < self.options.min_inliers {
            self.forget();
            return Err(TrackLoss::FewFound);
        }
        Ok(())
    }

    /// Root mean square distance in pixels of the frame between the reference's points under two poses; infinite when fewer
    /// than half of them are in front of both cameras. Says in one number how much two poses differ for the eye.
    pub fn distance_px(&self, a: &CamFromWorld, b: &CamFromWorld) -> f64 {
        let Some(camera) = &self.reference.camera else {
            return f64::INFINITY;
        };
        let (mut sum, mut num, mut all) = (0.0, 0, 0);
        for p in self.reference.worlds() {
            all += 1;
            let (a, b) = (a.transform_point(p), b.transform_point(p));
            if let (Some(a), Some(b)) = (camera.pixel_from_cam(&a), camera.pixel_from_cam(&b)) {
                sum += a.distance(b).powi(2);
                num += 1;
            }
        }
        if num == 0 || 2 * num < all {
            return f64::INFINITY;
        }
        (sum / f64::from(num)).sqrt() / self.working_from_sensor.scale_x
    }

    /// The pose of a frame, from a pose that is probably near.
    ///
    /// # Errors
    /// [`TrackLoss`]: why there is none.
    pub fn track(&mut self, frame: u64, expected: &CamFromWorld) -> Result<Tracked, TrackLoss> {
        let (Some(start), Some(camera)) = (self.reference.cam_from_world, self.reference.camera)
        else {
            return Err(TrackLoss::NoReference);
        };
        if self.reference_size != self.size {
            return Err(TrackLoss::Resized);
        }
        let num_points = self.find_points(frame, &camera, expected)?;
        let num_lines = self.find_lines(frame, &camera, expected)?;
        let looked_for = num_points + num_lines;
        let most_points = self.reference.num_points().min(self.options.max_points);
        if looked_for < self.options.min_inliers
            || looked_for * 8 < most_points + self.reference.lines.len()
        {
            return Err(TrackLoss::OutOfView);
        }
        let found = self.points.len() + self.lines.len();
        if found < self.options.min_inliers || self.points.len() * POINT_SHARE < num_points {
            return Err(TrackLoss::FewFound);
        }
        let solved = pose::refine(
            &self.points,
            &self.lines,
            &camera,
            expected,
            &self.pose_options,
            &mut self.pose,
            &mut || 0.0,
        );
        let Some(estimate) = solved.ok().and_then(|outcome| outcome.located().copied()) else {
            return Err(TrackLoss::Disagreement);
        };
        let inliers = self.pose.inliers();
        let (points, lines) = (inliers.points.len(), inliers.lines.len());
        let agreeing = points + lines;
        if agreeing < self.options.min_inliers
            || (agreeing as f32) < self.options.min_inlier_share * found as f32
            || points * POINT_SHARE < num_points
        {
            return Err(TrackLoss::Disagreement);
        }
        let carried = carry(&self.reference.covariance, &start, &estimate.cam_from_world);
        let covariance = carried + estimate.covariance;
        if !(covariance.fixed_view::<3, 3>(0, 0).trace() < MAX_TURN_RAD * MAX_TURN_RAD) {
            return Err(TrackLoss::OutOfView);
        }
        Ok(Tracked {
            cam_from_world: estimate.cam_from_world,
            covariance,
            num_points: [num_points, self.points.len(), points],
            num_lines: [num_lines, self.lines.len(), lines],
            median_error_px: self.median_error_px(),
        })
    }

    /// Fills `points` with what is found; how many were looked for.
    fn find_points(
        &mut self,
        frame: u64,
        camera: &Camera,
        expected: &CamFromWorld,
    ) -> Result<usize, TrackLoss> {
        let picture = self.ring.get(frame).ok_or(TrackLoss::NoFrame)?;
        let vectors = self.options.kernels;
        let mut looked_for = 0;
        self.points.clear();
        let (points, reference) = self.reference.points();
        let (width, height) = picture.size();
        for point in points {
            if looked_for == self.options.max_points {
                break;
            }
            let Some(start) = point.expect(reference, camera, expected, MAX_WARP, vectors) else {
                continue;
            };
            let inside = |v: f32, len: usize| v > 8.0 && v < len as f32 - 9.0;
            if !(inside(start[0], width) && inside(start[1], height)) {
                continue;
            }
            looked_for += 1;
            let Some(found) = point.template.find(picture, start, vectors) else {
                continue;
            };
            if found.correlation < self.options.min_correlation {
                continue;
            }
            let back = point
                .template
                .way_back(picture, &found, &mut self.back, vectors);
            if !(back <= self.options.max_way_back_px) {
                continue;
            }
            self.points.push(PointCorrespondence {
                pixel: pixel_at(found.position),
                point_in_world: point.in_world,
                confidence: 0.9,
                // Depths are off by more than pixels once the camera has moved; by how much, the pose tells from what is left.
                sigma_m: 0.0,
                sigma_px: POINT_SIGMA_PX,
            });
        }
        Ok(looked_for)
    }

    /// Fills `lines` with what is found; how many were looked for.
    fn find_lines(
        &mut self,
        frame: u64,
        camera: &Camera,
        expected: &CamFromWorld,
    ) -> Result<usize, TrackLoss> {
        let picture = self.ring.get(frame).ok_or(TrackLoss::NoFrame)?;
        let image = picture.level(0).view();
        let mut looked_for = 0;
        self.lines.clear();
        for line in &self.reference.lines {
            let ends = line.ends_in_world.map(|end| {
                let pixel = camera.pixel_from_cam(&expected.transform_point(&end))?;
                Some(index_coordinates(pixel))
            });
            let [Some(start), Some(end)] = ends else {
                continue;
            };
            let near = Piece { start, end };
            if near.inside(image.width, image.height).is_none() {
                continue;
            }
            looked_for += 1;
            if let Some((found, _)) = edge::find(&image, &near, Some(line.strength)) {
                self.lines.push(LineCorrespondence {
                    start: pixel_at(found.start),
                    end: pixel_at(found.end),
                    start_in_world: line.ends_in_world[0],
                    end_in_world: line.ends_in_world[1],
                    confidence: 0.9,
                    sigma_m: 0.0,
                    sigma_px: LINE_SIGMA_PX,
                });
            }
        }
        Ok(looked_for)
    }

    fn median_error_px(&mut self) -> f64 {
        let inliers = self.pose.inliers();
        let (points, lines) = (self.pose.point_errors_px(), self.pose.line_errors_px());
        self.errors_px.clear();
        let of = |i: &u32| *i as usize;
        self.errors_px
            .extend(inliers.points.iter().map(|i| f64::from(points[of(i)])));
        self.errors_px.extend(inliers.lines.iter().map(|i| {
            let [a, b] = lines[of(i)];
            0.5 * f64::from(a + b)
        }));
        crate::math::stats::median_in_place(&mut self.errors_px).unwrap_or(0.0)
            / self.working_from_sensor.scale_x
    }

    /// Bytes of the pictures that are kept.
    pub fn picture_bytes(&self) -> usize {
        self.ring.bytes()
    }
}

/// The covariance of one camera as that of another that is rigidly joined to it.
pub(crate) fn carry(
    covariance: &Matrix6<f64>,
    from: &CamFromWorld,
    to: &CamFromWorld,
) -> Matrix6<f64> {
    let turn = to.rotation * from.rotation.transpose();
    let shift = to.translation - turn * from.translation;
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    adjoint
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(cross(&shift) * turn));
    adjoint * covariance * adjoint.transpose()
}

fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}
