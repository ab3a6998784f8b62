//! Runs a scene on pictures with known poses. The main result comes from the relocalizer as it ships; the others are the
//! same correspondences of points alone and of lines alone, and the baseline, all solved by the same solver.

use super::baseline::Landmarks;
use super::{PoseError, Summary};
use crate::dataset::DatasetImage;
use crate::extract::{ExtractError, Extraction};
use crate::picture::{self, PictureError};
use landline::features::FeatureSet;
use landline::geometry::CamFromWorld;
use landline::image::{FrameView, PixelFormat};
use landline::math::stats::median_in_place;
use landline::pose::{
    self, LineCorrespondence, PointCorrespondence, PoseError as SolverError, PoseOptions,
    PoseScratch,
};
use landline::relocalizer::{LocateError, Outcome, Query, Relocalizer, RelocalizerOptions};
use nalgebra::Vector3;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Why an evaluation stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// A picture cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// Features for the baseline.
    #[error(transparent)]
    Extract(#[from] ExtractError),
    /// The relocalizer refused a frame.
    #[error("locating {path}: {source}")]
    Locate {
        /// The picture.
        path: PathBuf,
        /// Why.
        source: LocateError,
    },
    /// The solver refused its input.
    #[error("solving {name}: {source}")]
    Solve {
        /// The picture.
        name: String,
        /// Why.
        source: SolverError,
    },
    /// A test picture without a known pose.
    #[error("picture {0} has no pose to compare with")]
    NoTruth(String),
}

/// One method on one picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MethodResult {
    /// None without a pose.
    pub error: Option<PoseError>,
    /// Points and lines that agree.
    pub inliers: (usize, usize),
    /// Why there is no pose.
    pub reason: Option<String>,
}

/// All methods on one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageResult {
    /// As the data set calls it.
    pub name: String,
    /// In the order of [`Evaluation::methods`].
    pub methods: Vec<MethodResult>,
    /// The pose that the scene gave.
    pub cam_from_world: Option<CamFromWorld>,
    /// Of the relocalizer, without reading the picture.
    pub total_ms: f64,
    /// Grey and resize, features, lines, networks, solver.
    pub stages_ms: [f64; 5],
}

/// Options of an evaluation.
pub struct EvalOptions<'a> {
    /// Landmarks of the baseline, with the features to use; none leaves the baseline out.
    pub baseline: Option<(&'a Landmarks, &'a Extraction)>,
}

/// Figures over all pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Name and figures of each method; the scene's own first.
    pub methods: Vec<(String, Summary)>,
    /// Picture by picture.
    pub images: Vec<ImageResult>,
    /// Medians: grey and resize, features, lines, networks, solver, all.
    pub median_ms: [f64; 6],
}

/// Names of the stages in the order of [`Evaluation::median_ms`].
pub(super) const STAGES: [&str; 6] = ["resize", "features", "lines", "networks", "solver", "all"];

/// Runs a scene over pictures.
pub struct Evaluator<'a> {
    relocalizer: &'a mut Relocalizer,
    options: EvalOptions<'a>,
    scratch: PoseScratch,
}

impl<'a> Evaluator<'a> {
    /// For a scene.
    pub fn new(relocalizer: &'a mut Relocalizer, options: EvalOptions<'a>) -> Self {
        Self {
            relocalizer,
            options,
            scratch: PoseScratch::new(),
        }
    }

    /// Evaluates the pictures; `done` is called after each.
    ///
    /// # Errors
    /// When a picture cannot be read or has no known pose.
    pub fn run(
        &mut self,
        images: &[&DatasetImage],
        mut done: impl FnMut(&ImageResult),
    ) -> Result<Evaluation, EvalError> {
        let mut results = Vec::with_capacity(images.len());
        let mut has_lines = false;
        for image in images {
            let result = self.image(image, &mut has_lines)?;
            done(&result);
            results.push(result);
        }
        let mut names = vec!["scene"];
        if has_lines {
            names = vec!["points + lines", "points only", "lines only"];
        }
        let mut methods: Vec<(String, Summary)> = Vec::new();
        // Without lines the variants say nothing; they are dropped from the table, not from the run.
        let columns: Vec<usize> = if has_lines { vec![0, 1, 2] } else { vec![0] };
        let baseline = self.options.baseline.as_ref().map(|(l, _)| l.len());
        let all = columns
            .iter()
            .copied()
            .zip(names.into_iter().map(str::to_owned))
            .chain(baseline.map(|n| (3, format!("nearest of {n} landmarks"))));
        for (column, name) in all {
            let of: Vec<&MethodResult> = results
                .iter()
                .filter_map(|r: &ImageResult| r.methods.get(column))
                .collect();
            let errors: Vec<_> = of.iter().map(|m| m.error).collect();
            let inliers: Vec<_> = of
                .iter()
                .filter(|m| m.error.is_some())
                .map(|m| m.inliers)
                .collect();
            methods.push((name, Summary::of(&errors, &inliers)));
        }
        let median = |part: &dyn Fn(&ImageResult) -> f64| {
            median_in_place(&mut results.iter().map(part).collect::<Vec<f64>>()).unwrap_or(0.0)
        };
        let median_ms = [
            median(&|r| r.stages_ms[0]),
            median(&|r| r.stages_ms[1]),
            median(&|r| r.stages_ms[2]),
            median(&|r| r.stages_ms[3]),
            median(&|r| r.stages_ms[4]),
            median(&|r| r.total_ms),
        ];
        if !has_lines {
            for result in &mut results {
                let baseline = result.methods.split_off(result.methods.len().min(3));
                result.methods.truncate(1);
                result.methods.extend(baseline);
            }
        }
        Ok(Evaluation {
            methods,
            images: results,
            median_ms,
        })
    }

    fn image(
        &mut self,
        image: &DatasetImage,
        has_lines: &mut bool,
    ) -> Result<ImageResult, EvalError> {
        let truth = image
            .cam_from_world
            .ok_or_else(|| EvalError::NoTruth(image.name.clone()))?;
        let rgb = picture::read(&image.path)?.into_rgb8();
        let frame = FrameView {
            bytes: rgb.as_raw(),
            width: rgb.width(),
            height: rgb.height(),
            stride: 3 * rgb.width() as usize,
            format: PixelFormat::Rgb8,
        };
        let start = Instant::now();
        let mut clock = || start.elapsed().as_secs_f64() * 1e3;
        let report = self
            .relocalizer
            .locate(&frame, &Query::with_camera(image.camera), &mut clock)
            .map_err(|source| EvalError::Locate {
                path: image.path.clone(),
                source,
            })?;
        let mut methods = Vec::with_capacity(4);
        let cam_from_world = report.outcome.located().map(|l| l.cam_from_world);
        methods.push(MethodResult {
            error: cam_from_world.map(|t| PoseError::between(&t, &truth)),
            inliers: (
                report.counts.num_point_inliers,
                report.counts.num_line_inliers,
            ),
            reason: match report.outcome {
                Outcome::Located(_) => None,
                Outcome::NotLocated(reason) => Some(reason.message().to_owned()),
            },
        });
        let points: Vec<PointCorrespondence> = self.relocalizer.points().map(|(p, _)| p).collect();
        let lines: Vec<LineCorrespondence> = self.relocalizer.lines().map(|(l, _)| l).collect();
        *has_lines |= !lines.is_empty();
        let options = solver_options(self.relocalizer.options(), frame.width, frame.height);
        methods.push(self.solve(image, &truth, &points, &[], &options)?);
        methods.push(self.solve(image, &truth, &[], &lines, &options)?);
        if let Some((landmarks, extraction)) = self.options.baseline {
            let features: FeatureSet = extraction.features(image)?.into();
            let points = landmarks.correspond(&features);
            methods.push(self.solve(image, &truth, &points, &[], &options)?);
        }
        let t = report.timings;
        Ok(ImageResult {
            name: image.name.clone(),
            methods,
            cam_from_world,
            total_ms: t.total_ms,
            stages_ms: [
                t.preprocess_ms,
                t.features_ms,
                t.lines_ms,
                t.regress_ms,
                t.solve_ms,
            ],
        })
    }

    fn solve(
        &mut self,
        image: &DatasetImage,
        truth: &CamFromWorld,
        points: &[PointCorrespondence],
        lines: &[LineCorrespondence],
        options: &PoseOptions,
    ) -> Result<MethodResult, EvalError> {
        let outcome = pose::estimate(
            points,
            lines,
            &image.camera,
            options,
            &mut self.scratch,
            &mut || 0.0,
        )
        .map_err(|source| EvalError::Solve {
            name: image.name.clone(),
            source,
        })?;
        let inliers = self.scratch.inliers();
        Ok(MethodResult {
            error: outcome
                .located()
                .map(|e| PoseError::between(&e.cam_from_world, truth)),
            inliers: (inliers.points.len(), inliers.lines.len()),
            reason: outcome
                .located()
                .is_none()
                .then(|| outcome.status.message().to_owned()),
        })
    }
}

/// The relocalizer's solver for correspondences in a picture's own pixels: its thresholds are in pixels of the working image.
pub fn solver_options(options: &RelocalizerOptions, width: u32, height: u32) -> PoseOptions {
    let longest = f64::from(width.max(height));
    let factor = longest / (options.max_side as f64).min(longest);
    PoseOptions {
        max_point_error_px: options.pose.max_point_error_px * factor,
        max_line_error_px: options.pose.max_line_error_px * factor,
        sigma_px: options.pose.sigma_px * factor,
        ..options.pose
    }
}

/// Share of predicted segments whose ends lie within a distance of the true infinite line and whose direction is within an
/// angle of its direction.
pub fn line_share(
    predicted_and_true: &[([Vector3<f64>; 2], [Vector3<f64>; 2])],
    max_distance: f64,
    max_angle_deg: f64,
) -> f64 {
    let cos_limit = max_angle_deg.to_radians().cos();
    let good = predicted_and_true
        .iter()
        .filter(|([p, q], [a, b])| {
            let (Some(direction), Some(truth)) =
                ((q - p).try_normalize(1e-9), (b - a).try_normalize(1e-9))
            else {
                return false;
            };
            let off = |x: &Vector3<f64>| ((x - a) - truth * (x - a).dot(&truth)).norm();
            direction.dot(&truth).abs() >= cos_limit
                && off(p) <= max_distance
                && off(q) <= max_distance
        })
        .count();
    good as f64 / predicted_and_true.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_compared_as_infinite_ones() {
        let x = |x: f64, y: f64| Vector3::new(x, y, 0.0);
        let truth = [x(0.0, 0.0), x(1.0, 0.0)];
        // Shifted along itself and reversed: the same line. 6 cm beside it, or turned by 5 degrees: not.
        let pairs = [
            ([x(3.0, 0.01), x(2.0, 0.01)], truth),
            ([x(0.0, 0.06), x(1.0, 0.06)], truth),
            ([x(0.0, 0.0), x(0.4, 0.035)], truth),
            ([x(0.0, 0.0), x(0.0, 0.0)], truth),
        ];
        assert_eq!(line_share(&pairs, 0.05, 3.0), 0.25);
        assert_eq!(line_share(&[], 0.05, 3.0), 0.0);
    }
}
