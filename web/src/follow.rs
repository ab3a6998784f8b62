//! The follower as JavaScript sees it: a pose for every frame, on whatever thread the page likes.

use crate::error::{Code, js_error};
use crate::frame::pose_from;
use landline::geometry::{Camera, CameraModel, Pixel};
use landline::image::{FrameView, PixelFormat};
use landline::pose::{LineCorrespondence, PointCorrespondence};
use landline::session::{
    Answer, AnswerUse, FollowLimit, FollowOptions, FollowReport, FollowSource, FollowState,
    Follower,
};
use landline::simd::Level;
use landline::tracker::{TrackLoss, TrackerOptions};
use nalgebra::{Matrix3, Matrix6, Vector3};
use wasm_bindgen::JsValue;
use wasm_bindgen::prelude::wasm_bindgen;

/// Must equal `layoutVersion` in `web/ts/follower.ts`, which reads what [`encode`] writes.
const LAYOUT_VERSION: f64 = 1.0;
/// Numbers of one report.
const LENGTH: usize = 90;

/// Follows one camera.
#[wasm_bindgen]
#[derive(Debug)]
pub struct RawFollower {
    core: Follower,
    frame: Vec<u8>,
    result: Vec<f64>,
}

#[wasm_bindgen]
impl RawFollower {
    /// Corrections fade in over `blend_ms`.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code` for a time that is none.
    #[wasm_bindgen(constructor)]
    pub fn new(blend_ms: f64) -> Result<RawFollower, JsValue> {
        if !(0.0..=10_000.0).contains(&blend_ms) {
            let message =
                format!("option blendMs is {blend_ms}; it must be 0 to 10000 milliseconds");
            return Err(js_error(Code::BadInput, &message));
        }
        Ok(Self {
            core: Follower::new(FollowOptions {
                blend_ms,
                // The same in every build: relaxed SIMD is for networks.
                tracker: TrackerOptions {
                    kernels: Level::Portable,
                    ..TrackerOptions::default()
                },
                ..FollowOptions::default()
            }),
            frame: Vec::new(),
            result: vec![0.0; LENGTH],
        })
    }

    /// Makes room for a frame; its address in the engine's memory, valid until the next call.
    #[wasm_bindgen(js_name = frameBuffer)]
    pub fn frame_buffer(&mut self, len: usize) -> usize {
        self.frame.resize(len, 0);
        self.frame.as_mut_ptr() as usize
    }

    /// Takes the frame that was written into the buffer, four bytes a pixel. `turned` is empty, or the turn of the camera since
    /// the frame before, row by row. The report lies at [`Self::result_address`] then.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub fn track(
        &mut self,
        width: u32,
        height: u32,
        timestamp_ms: f64,
        turned: &[f64],
    ) -> Result<(), JsValue> {
        let frame = FrameView {
            bytes: &self.frame,
            width,
            height,
            stride: 4 * width as usize,
            format: PixelFormat::Rgba8,
        };
        let turned = (turned.len() == 9).then(|| Matrix3::from_row_slice(turned));
        let report = self
            .core
            .frame(&frame, timestamp_ms, turned.as_ref())
            .map_err(|e| js_error(Code::BadInput, &e.to_string()))?;
        encode(&report, &mut self.result);
        Ok(())
    }

    /// Address of the last report's numbers, valid until the next call.
    #[wasm_bindgen(js_name = resultAddress)]
    #[must_use]
    pub fn result_address(&self) -> usize {
        self.result.as_ptr() as usize
    }

    /// How many numbers there are.
    #[wasm_bindgen(js_name = resultLength)]
    #[must_use]
    pub fn result_length(&self) -> usize {
        self.result.len()
    }

    /// Keeps a frame's picture, because it goes to the relocalizer.
    pub fn hold(&mut self, frame: f64) -> bool {
        self.core.hold(frame as u64)
    }

    /// Takes an answer of the relocalizer: width, height, fx, fy, cx, cy; `cam_from_world` row-major; covariance row-major or
    /// empty; what agrees with the pose, pixels and world points one after the other (two and three numbers a point, four and six
    /// a line). 0 when it is followed, 1 when it waits for the next, else two more than the code of the loss.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code` when the lists do not fit each other.
    #[expect(
        clippy::too_many_arguments,
        reason = "flat numbers cross the border without making objects"
    )]
    pub fn localized(
        &mut self,
        frame: f64,
        camera: &[f64],
        cam_from_world: &[f64],
        covariance: &[f64],
        point_pixels: &[f32],
        point_worlds: &[f32],
        line_pixels: &[f32],
        line_worlds: &[f32],
    ) -> Result<u32, JsValue> {
        let fits = point_pixels.len() * 3 == point_worlds.len() * 2
            && line_pixels.len() * 3 == line_worlds.len() * 2
            && matches!(covariance.len(), 0 | 36);
        let (&[width, height, fx, fy, cx, cy], true) = (camera, fits) else {
            return Err(js_error(
                Code::BadInput,
                "the lists of an answer do not fit each other",
            ));
        };
        let Some(cam_from_world) = pose_from(cam_from_world)? else {
            return Err(js_error(Code::BadInput, "an answer has a pose"));
        };
        let answer = Answer {
            frame: frame as u64,
            camera: Camera {
                width: width as u32,
                height: height as u32,
                model: CameraModel::Pinhole { fx, fy, cx, cy },
            },
            cam_from_world,
            covariance: if covariance.is_empty() {
                // A degree and a hundredth of a unit.
                Matrix6::identity().scale(1e-4)
            } else {
                Matrix6::from_row_slice(covariance)
            },
        };
        let points = point_pixels.as_chunks::<2>().0.iter();
        let points =
            points
                .zip(point_worlds.as_chunks::<3>().0)
                .map(|(p, w)| PointCorrespondence {
                    pixel: pixel(p[0], p[1]),
                    point_in_world: world(w[0], w[1], w[2]),
                    confidence: 1.0,
                    sigma_m: 0.0,
                    sigma_px: 0.0,
                });
        let lines = line_pixels.as_chunks::<4>().0.iter();
        let lines = lines
            .zip(line_worlds.as_chunks::<6>().0)
            .map(|(p, w)| LineCorrespondence {
                start: pixel(p[0], p[1]),
                end: pixel(p[2], p[3]),
                start_in_world: world(w[0], w[1], w[2]),
                end_in_world: world(w[3], w[4], w[5]),
                confidence: 1.0,
                sigma_m: 0.0,
                sigma_px: 0.0,
            });
        Ok(match self.core.localized(&answer, points, lines) {
            AnswerUse::Followed => 0,
            AnswerUse::Unconfirmed => 1,
            AnswerUse::Unusable(why) => 2 + loss_code(why) as u32,
        })
    }

    /// Takes note that the relocalizer found nothing in a frame.
    #[wasm_bindgen(js_name = notLocated)]
    pub fn not_located(&mut self, frame: f64) {
        self.core.not_located(frame as u64);
    }

    /// A pose near that of the newest frame as 16 numbers row-major, for the relocalizer; empty when there is none.
    #[must_use]
    pub fn prior(&self) -> Vec<f64> {
        let pose = self.core.prior();
        pose.map_or_else(Vec::new, |pose| pose.to_row_major().to_vec())
    }

    /// Forgets where the camera was.
    pub fn reset(&mut self) {
        self.core.reset();
    }
}

fn pixel(x: f32, y: f32) -> Pixel {
    Pixel::new(f64::from(x), f64::from(y))
}

fn world(x: f32, y: f32, z: f32) -> Vector3<f64> {
    Vector3::new(x, y, z).cast()
}

/// | from | what |
/// | --- | --- |
/// | 0 | layout version |
/// | 1 | number of the frame |
/// | 2, 3 | code of the state, code of what limits it |
/// | 4 | code of the loss, or -1 |
/// | 5, 6 | correction in pixels or NaN, 1 when it is a jump |
/// | 7 | 1 when a pose follows |
/// | 8 | `cam_from_world` for display, 16 numbers row-major |
/// | 24 | the same as believed |
/// | 40 | covariance, 36 numbers row-major |
/// | 76 | 1 when localised in this very frame |
/// | 77, 78 | frames and milliseconds since the last localised one |
/// | 79 | points looked for, found, agreeing; lines likewise |
/// | 85 | median error in pixels |
fn encode(report: &FollowReport, out: &mut [f64]) {
    out.fill(0.0);
    let mut put = |at: usize, values: &[f64]| {
        if let Some(room) = out.get_mut(at..at + values.len()) {
            room.copy_from_slice(values);
        }
    };
    let (state, limit) = state_codes(report.state);
    let loss = report.loss.map_or(-1.0, loss_code);
    let (distance, is_jump) = report.correction.map_or((f64::NAN, 0.0), |c| {
        (c.distance_px, f64::from(u8::from(c.is_jump)))
    });
    put(
        0,
        &[
            LAYOUT_VERSION,
            report.frame as f64,
            state,
            limit,
            loss,
            distance,
            is_jump,
        ],
    );
    let Some(pose) = &report.pose else { return };
    put(7, &[1.0]);
    put(8, &pose.cam_from_world.to_row_major());
    put(24, &pose.believed.to_row_major());
    for r in 0..6 {
        for c in 0..6 {
            put(40 + 6 * r + c, &[pose.covariance[(r, c)]]);
        }
    }
    let is_localized = pose.source == FollowSource::Localization;
    put(
        76,
        &[
            f64::from(u8::from(is_localized)),
            pose.age_frames as f64,
            pose.age_ms,
        ],
    );
    put(79, &pose.num_points.map(|n| n as f64));
    put(82, &pose.num_lines.map(|n| n as f64));
    put(85, &[pose.median_error_px]);
}

fn state_codes(state: FollowState) -> (f64, f64) {
    match state {
        FollowState::Searching => (0.0, 0.0),
        FollowState::Tracking => (1.0, 0.0),
        FollowState::Limited(limit) => (
            2.0,
            match limit {
                FollowLimit::ExcessiveMotion => 0.0,
                FollowLimit::InsufficientFeatures => 1.0,
                FollowLimit::OutOfView => 2.0,
                FollowLimit::Relocalizing => 3.0,
                FollowLimit::Jump => 4.0,
                FollowLimit::Unconfirmed => 5.0,
                FollowLimit::Frozen => 6.0,
                FollowLimit::Clock => 7.0,
                FollowLimit::Resized => 8.0,
            },
        ),
    }
}

fn loss_code(loss: TrackLoss) -> f64 {
    match loss {
        TrackLoss::NoReference => 0.0,
        TrackLoss::NoFrame => 1.0,
        TrackLoss::Resized => 2.0,
        TrackLoss::OutOfView => 3.0,
        TrackLoss::FewFound => 4.0,
        TrackLoss::Disagreement => 5.0,
    }
}
