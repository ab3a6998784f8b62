//! Runs a scene on pictures with known poses. The main result comes from the relocalizer as it ships; the others are the
//! relocalizer with points alone, with lines alone, and without the second look where the scene has one, and the baseline, all
//! from the same features and solved by the same solver. Further seeds solve the same features again.

use super::baseline::Landmarks;
use super::lines::{LineAccuracy, LineTruth};
use super::peer::{FullMatching, NUM_PICTURES};
use super::reliability::CONFIDENT;
use super::{Comparison, OtherWorld, PoseError, Reliability, Summary};
use crate::dataset::DatasetImage;
use crate::extract::{ExtractError, Extraction};
use crate::picture::{self, PictureError};
use landline::features::FeatureSet;
use landline::geometry::CamFromWorld;
use landline::image::{FrameView, PixelFormat};
use landline::landmarks::FoundAgain;
use landline::math::stats::median_in_place;
use landline::pose::{
    self, LineCorrespondence, PointCorrespondence, PoseError as SolverError, PoseOptions,
    PoseScratch,
};
use landline::relocalizer::{
    CreateError, LiveOptions, LocateError, Outcome, Query, Relocalizer, Report,
};
use landline::scene_file::Units;
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
    /// An option has no meaning.
    #[error(transparent)]
    Options(CreateError),
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
    /// The same with the solver's further seeds.
    pub other_seeds: Vec<Vec<MethodResult>>,
    /// From the data set.
    pub truth: CamFromWorld,
    /// The pose that the scene gave.
    pub cam_from_world: Option<CamFromWorld>,
    /// Predicted segments against triangulated ones.
    pub lines: Option<LineAccuracy>,
    /// What the second look found again, where there was one.
    pub found_again: Option<FoundAgain>,
    /// How sure the scene's own answer is, where there is one.
    pub confidence: Option<f64>,
    /// Of the relocalizer, without reading the picture.
    pub total_ms: f64,
    /// Grey and resize, features, lines, networks, solver, second look.
    pub stages_ms: [f64; 6],
}

impl ImageResult {
    /// Results of all seeds, the relocalizer's own first.
    pub fn all_seeds(&self) -> impl Iterator<Item = &[MethodResult]> {
        std::iter::once(self.methods.as_slice()).chain(self.other_seeds.iter().map(Vec::as_slice))
    }
}

/// Options of an evaluation.
#[derive(Clone, Copy)]
pub struct EvalOptions<'a> {
    /// Features of the test pictures; baseline and lines need them.
    pub extraction: Option<&'a Extraction>,
    /// Landmarks of the baseline; none leaves it out.
    pub baseline: Option<&'a Landmarks>,
    /// Full matching beside the scene; none leaves it out.
    pub peer: Option<&'a FullMatching<'a>>,
    /// Triangulated lines to compare the predicted ones with; none leaves the comparison out.
    pub lines: Option<&'a LineTruth>,
    /// How often each picture is solved, with seeds of its own.
    pub num_seeds: u64,
    /// What the world's lengths are told in.
    pub units: Units,
}

impl Default for EvalOptions<'_> {
    fn default() -> Self {
        Self {
            extraction: None,
            baseline: None,
            peer: None,
            lines: None,
            num_seeds: 1,
            units: Units::Arbitrary,
        }
    }
}

/// Figures over all pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Name and figures of each method; the scene's own first.
    pub methods: Vec<(String, Summary)>,
    /// Picture by picture.
    pub images: Vec<ImageResult>,
    /// Medians: grey and resize, features, lines, networks, solver, second look, all.
    pub median_ms: [f64; 7],
    /// Solver seeds that are pooled in the figures.
    pub num_seeds: u64,
    /// Points and lines against points only; none without lines.
    pub comparison: Option<Comparison>,
    /// Predicted segments against triangulated ones, over all pictures.
    pub lines: Option<LineAccuracy>,
    /// What the confidence of the scene's own answers is worth.
    pub reliability: Reliability,
    /// Unit of all positions and thresholds.
    pub units: Units,
    /// Where the answers are right in another world than the data's.
    pub other_world: Option<OtherWorld>,
}

/// Names of the scene's own methods, in the order of [`ImageResult::methods`]. The last is there where the scene has landmarks.
const METHODS: [&str; 4] = ["points + lines", "points only", "lines only", FIRST_POSE];
const FIRST_POSE: &str = "first pose";

/// How a method changes the options.
fn of_method(name: &str, live: LiveOptions) -> LiveOptions {
    let all = live;
    match name {
        "points only" => LiveOptions {
            max_lines: 0,
            ..all
        },
        "lines only" => LiveOptions {
            max_points: 0,
            ..all
        },
        FIRST_POSE => LiveOptions {
            look_again: false,
            ..all
        },
        _ => all,
    }
}

/// Names of the stages in the order of [`Evaluation::median_ms`].
pub(super) const STAGES: [&str; 7] = [
    "resize", "features", "lines", "networks", "solver", "again", "all",
];

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
        let mut results: Vec<ImageResult> = Vec::with_capacity(images.len());
        let mut has_lines = false;
        for image in images {
            let result = self.image(image, &mut has_lines)?;
            done(&result);
            results.push(result);
        }
        // Without lines the other methods say nothing.
        if !has_lines {
            for result in &mut results {
                let methods = std::iter::once(&mut result.methods);
                for methods in methods.chain(&mut result.other_seeds) {
                    methods.drain(1..3.min(methods.len()));
                }
            }
        }
        let mut names = if has_lines {
            METHODS[..3].iter().map(|n| (*n).to_owned()).collect()
        } else {
            vec!["scene".to_owned()]
        };
        if self.relocalizer.has_landmarks() {
            names.push(FIRST_POSE.to_owned());
        }
        let baseline = self.options.baseline;
        let baseline_name = baseline.map(|l| format!("nearest of {} landmarks", l.len()));
        let peer_name = self
            .options
            .peer
            .map(|_| format!("full matching, {NUM_PICTURES} pictures"));
        names.extend(baseline_name.into_iter().chain(peer_name));
        let num_columns = names.len();
        let errors: Vec<Vec<Vec<Option<PoseError>>>> = (0..num_columns)
            .map(|column| {
                let of_image = |r: &ImageResult| -> Vec<Option<PoseError>> {
                    r.all_seeds()
                        .filter_map(|m| m.get(column).map(|m| m.error))
                        .collect()
                };
                results.iter().map(of_image).collect()
            })
            .collect();
        let methods: Vec<(String, Summary)> = names
            .into_iter()
            .zip(&errors)
            .enumerate()
            .map(|(column, (name, errors))| {
                let pooled: Vec<_> = errors.iter().flatten().copied().collect();
                let inliers: Vec<_> = results
                    .iter()
                    .flat_map(ImageResult::all_seeds)
                    .filter_map(|m| m.get(column))
                    .filter(|m| m.error.is_some())
                    .map(|m| m.inliers)
                    .collect();
                (name, Summary::of(&pooled, &inliers))
            })
            .collect();
        let comparison = match errors.as_slice() {
            [both, points, _, ..] if has_lines => {
                Some(Comparison::new((METHODS[0], both), (METHODS[1], points)))
            }
            _ => None,
        };
        let mut lines: Option<LineAccuracy> = None;
        for found in results.iter().filter_map(|r| r.lines) {
            lines.get_or_insert_default().add(&found);
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
            median(&|r| r.stages_ms[5]),
            median(&|r| r.total_ms),
        ];
        let own = |r: &ImageResult| r.confidence.zip(r.methods.first()?.error);
        Ok(Evaluation {
            reliability: Reliability::of(results.iter().filter_map(own)),
            other_world: OtherWorld::of(&results, CONFIDENT),
            methods,
            images: results,
            median_ms,
            num_seeds: self.options.num_seeds,
            comparison,
            lines,
            units: self.options.units,
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
        let frame = FrameView::tight(rgb.as_raw(), rgb.width(), rgb.height(), PixelFormat::Rgb8);
        let start = Instant::now();
        let mut clock = || start.elapsed().as_secs_f64() * 1e3;
        let query = Query::with_camera(image.camera);
        let located = |source| EvalError::Locate {
            path: image.path.clone(),
            source,
        };
        // On the CPU unless the caller moved the networks to a device.
        let observed = pollster::block_on(async {
            let begun = self.relocalizer.begin(&frame, &query, &mut clock).await?;
            self.relocalizer.observe(begun, &mut clock).await
        })
        .map_err(located)?;
        let report = self
            .relocalizer
            .solve(observed.clone(), &query, &mut clock)
            .map_err(located)?;
        let cam_from_world = report.outcome.located().map(|l| l.cam_from_world);
        let live = self.relocalizer.options().live;
        let num_methods = METHODS.len() - usize::from(!self.relocalizer.has_landmarks());
        let mut methods = vec![method_result(&report, &truth)];
        let mut predicted: Vec<(LineCorrespondence, bool)> = self.relocalizer.lines().collect();
        *has_lines |= !predicted.is_empty();
        let options = self.relocalizer.options();
        let max_side = options.front_end.max_side;
        let options = solver_options(&options.live.pose, max_side, frame.width, frame.height);
        let mut other_seeds = Vec::new();
        for seed in 0..self.options.num_seeds {
            let mut of_seed = Vec::with_capacity(METHODS.len() + 1);
            for name in &METHODS[usize::from(seed == 0)..num_methods] {
                let mut changed = of_method(name, live);
                changed.pose.seed = live.pose.seed.wrapping_add(seed);
                self.relocalizer
                    .set_live(changed)
                    .map_err(EvalError::Options)?;
                let report = self
                    .relocalizer
                    .solve(observed.clone(), &query, &mut clock)
                    .map_err(located)?;
                of_seed.push(method_result(&report, &truth));
                if seed == 0 && *name == FIRST_POSE {
                    predicted = self.relocalizer.lines().collect();
                }
            }
            if seed == 0 {
                methods.append(&mut of_seed);
            } else {
                other_seeds.push(of_seed);
            }
        }
        self.relocalizer
            .set_live(live)
            .map_err(EvalError::Options)?;
        let wants_features = self.options.baseline.is_some()
            || self.options.lines.is_some()
            || self.options.peer.is_some();
        let features: Option<FeatureSet> = match self.options.extraction {
            Some(extraction) if wants_features => Some(extraction.features(image)?),
            _ => None,
        };
        let line_accuracy = match (self.options.lines, &features) {
            (Some(known), Some(features)) if !predicted.is_empty() => {
                Some(known.compare(image.camera, truth, features, &predicted))
            }
            _ => None,
        };
        let mut peers = Vec::new();
        if let Some(features) = &features {
            peers.extend(self.options.baseline.map(|l| l.correspond(features)));
            peers.extend(self.options.peer.map(|p| p.correspond(features)));
        }
        for points in &peers {
            methods.push(self.solve(image, &truth, points, &options)?);
            for (more, of_seed) in (1..).zip(&mut other_seeds) {
                let options = PoseOptions {
                    seed: options.seed.wrapping_add(more),
                    ..options
                };
                of_seed.push(self.solve(image, &truth, points, &options)?);
            }
        }
        let t = report.timings;
        Ok(ImageResult {
            name: image.name.clone(),
            methods,
            other_seeds,
            truth,
            cam_from_world,
            lines: line_accuracy,
            found_again: report.found_again,
            confidence: report.outcome.located().map(|l| l.confidence),
            total_ms: t.total_ms,
            stages_ms: [
                t.preprocess_ms,
                t.features_ms,
                t.lines_ms,
                t.regress_ms,
                t.solve_ms,
                t.look_ms,
            ],
        })
    }

    fn solve(
        &mut self,
        image: &DatasetImage,
        truth: &CamFromWorld,
        points: &[PointCorrespondence],
        options: &PoseOptions,
    ) -> Result<MethodResult, EvalError> {
        let outcome = pose::estimate(
            points,
            &[],
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

fn method_result(report: &Report, truth: &CamFromWorld) -> MethodResult {
    let counts = &report.counts;
    MethodResult {
        error: report
            .outcome
            .located()
            .map(|l| PoseError::between(&l.cam_from_world, truth)),
        inliers: (counts.num_point_inliers, counts.num_line_inliers),
        reason: match report.outcome {
            Outcome::Located(_) => None,
            Outcome::NotLocated(reason) => Some(reason.message().to_owned()),
        },
    }
}

/// The relocalizer's solver for correspondences in a picture's own pixels: its thresholds are in pixels of the working image.
pub fn solver_options(
    solver: &PoseOptions,
    max_side: usize,
    width: u32,
    height: u32,
) -> PoseOptions {
    let longest = f64::from(width.max(height));
    let factor = longest / (max_side as f64).min(longest);
    PoseOptions {
        max_point_error_px: solver.max_point_error_px * factor,
        max_line_error_px: solver.max_line_error_px * factor,
        sigma_px: solver.sigma_px * factor,
        ..*solver
    }
}
