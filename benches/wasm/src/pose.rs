//! The pose solver alone, on flat numbers.
//!
//! Points: u, v, X, Y, Z, confidence, sigma (7 each). Lines: u1, v1, u2, v2, X1, Y1, Z1, X2, Y2, Z2, confidence, sigma (12
//! each). Pixels are corner-based; sigma is the standard deviation of the world coordinates, 0 when unknown.
//! Camera: a model name and parameter order of COLMAP. Options: `options` below; a missing or NaN entry keeps the default.
//! Result: [`RESULT_LEN`] numbers, then one posterior inlier probability for each point and each line.

use landline::geometry::{Camera, CameraModel, Pixel};
use landline::pose::{
    Focal, LineCorrespondence, PointCorrespondence, PoseOptions, PoseOutcome, PoseScratch,
    PoseStatus, estimate,
};
use nalgebra::Vector3;
use wasm_bindgen::JsError;
use wasm_bindgen::prelude::wasm_bindgen;

const POINT_STRIDE: usize = 7;
const LINE_STRIDE: usize = 12;

/// Numbers before the posteriors: status, 1 when there is a pose, 16 of `cam_from_world` row-major, fx, fy, position sigma,
/// rotation sigma (radians), point and line inliers, log evidence, runner-up ratio (NaN when none), iterations, milliseconds.
const RESULT_LEN: usize = 28;

/// Solver with buffers that are kept from call to call.
#[wasm_bindgen]
#[derive(Debug, Default)]
pub struct PoseSolver {
    scratch: PoseScratch,
    points: Vec<PointCorrespondence>,
    lines: Vec<LineCorrespondence>,
}

#[wasm_bindgen]
impl PoseSolver {
    /// A solver with empty buffers.
    #[wasm_bindgen(constructor)]
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Solves one problem. Options: largest point error in pixels, largest line error in pixels, pixel sigma, confidence, most
    /// iterations, time budget in milliseconds, seed, 1 for an unknown focal length.
    ///
    /// # Errors
    /// When an array's length is no multiple of its stride, or the camera or an option has no meaning.
    #[expect(
        clippy::too_many_arguments,
        reason = "flat numbers cross the border without making objects"
    )]
    pub fn solve(
        &mut self,
        points: &[f64],
        lines: &[f64],
        camera_model: &str,
        width: u32,
        height: u32,
        camera_params: &[f64],
        options: &[f64],
    ) -> Result<Vec<f64>, JsError> {
        let bad = |message: String| JsError::new(&message);
        for (name, numbers, stride) in [
            ("points", points, POINT_STRIDE),
            ("lines", lines, LINE_STRIDE),
        ] {
            if numbers.len() % stride != 0 {
                let n = numbers.len();
                return Err(bad(format!(
                    "{name} has {n} numbers; it must be a multiple of {stride}"
                )));
            }
        }
        let camera = Camera {
            width,
            height,
            model: CameraModel::from_colmap(camera_model, camera_params)
                .map_err(|e| bad(e.to_string()))?,
        };
        self.points.clear();
        self.points
            .extend(points.as_chunks::<POINT_STRIDE>().0.iter().map(
                |&[u, v, x, y, z, confidence, sigma]| PointCorrespondence {
                    pixel: Pixel::new(u, v),
                    point_in_world: Vector3::new(x, y, z),
                    confidence: confidence as f32,
                    sigma_m: sigma as f32,
                    sigma_px: 0.0,
                },
            ));
        self.lines.clear();
        self.lines
            .extend(lines.as_chunks::<LINE_STRIDE>().0.iter().map(
                |&[u1, v1, u2, v2, x1, y1, z1, x2, y2, z2, confidence, sigma]| LineCorrespondence {
                    start: Pixel::new(u1, v1),
                    end: Pixel::new(u2, v2),
                    start_in_world: Vector3::new(x1, y1, z1),
                    end_in_world: Vector3::new(x2, y2, z2),
                    confidence: confidence as f32,
                    sigma_m: sigma as f32,
                    sigma_px: 0.0,
                },
            ));
        let begin = crate::performance_now();
        let outcome = estimate(
            &self.points,
            &self.lines,
            &camera,
            &pose_options(options),
            &mut self.scratch,
            &mut crate::performance_now,
        )
        .map_err(|e| bad(e.to_string()))?;
        let ms = crate::performance_now() - begin;
        Ok(self.encode(&outcome, ms))
    }

    fn encode(&self, outcome: &PoseOutcome, ms: f64) -> Vec<f64> {
        let mut out = vec![0.0; RESULT_LEN];
        out[0] = status_code(outcome.status);
        if let Some(e) = &outcome.estimate {
            out[1] = 1.0;
            out[2..18].copy_from_slice(&e.cam_from_world.to_row_major());
            let (fx, fy) = e.camera.focal_px();
            let ratio = e.runner_up.map_or(f64::NAN, |r| r.score_ratio);
            out[18..26].copy_from_slice(&[
                fx,
                fy,
                e.sigma_m,
                e.sigma_rad,
                f64::from(e.num_point_inliers),
                f64::from(e.num_line_inliers),
                e.log_evidence,
                ratio,
            ]);
        }
        out[26] = f64::from(outcome.stats.iterations);
        out[27] = ms;
        let posteriors = [
            self.scratch.point_posteriors(),
            self.scratch.line_posteriors(),
        ];
        out.extend(
            posteriors
                .iter()
                .flat_map(|p| p.iter().copied().map(f64::from)),
        );
        out
    }
}

/// 0 located, 1 too few, 2 low inliers, 3 degenerate, 4 ambiguous, 5 out of time.
fn status_code(status: PoseStatus) -> f64 {
    match status {
        PoseStatus::Ok => 0.0,
        PoseStatus::TooFew => 1.0,
        PoseStatus::LowInliers => 2.0,
        PoseStatus::Degenerate => 3.0,
        PoseStatus::Ambiguous => 4.0,
        PoseStatus::OutOfTime => 5.0,
    }
}

fn pose_options(numbers: &[f64]) -> PoseOptions {
    let mut options = PoseOptions::default();
    let given = |i: usize| numbers.get(i).copied().filter(|v| !v.is_nan());
    let set = |i: usize, field: &mut f64| {
        if let Some(v) = given(i) {
            *field = v;
        }
    };
    set(0, &mut options.max_point_error_px);
    set(1, &mut options.max_line_error_px);
    set(2, &mut options.sigma_px);
    set(3, &mut options.confidence);
    if let Some(v) = given(4) {
        options.max_iterations = v as u32;
    }
    options.time_budget_ms = given(5);
    if let Some(v) = given(6) {
        options.seed = v as u64;
    }
    if given(7) == Some(1.0) {
        options.focal = Focal::Unknown;
    }
    options
}
