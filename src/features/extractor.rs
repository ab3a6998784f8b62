//! The extractor on the CPU: network, selection, sampling.

use super::{FeatureSet, Keypoint, KeypointParams, SelectScratch, select_keypoints};
use crate::geometry::Segment2;
use crate::image::GrayView;
use crate::models::{ExtractorKind, ModelError, Sampler, SelectionRule, ports};
use crate::nn::cpu::{CpuExecutor, Level};
use crate::nn::{Executor, NnError, Weights};

/// Why features could not be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FeatureError {
    /// The picture is smaller than the extractor's smallest input.
    #[error(
        "the picture has {width}x{height} pixels; {extractor} needs at least {min_side} on each side"
    )]
    PictureTooSmall {
        /// Width of the picture.
        width: usize,
        /// Height of the picture.
        height: usize,
        /// The extractor.
        extractor: &'static str,
        /// Smallest side.
        min_side: usize,
    },
    /// The view's size and its buffer disagree.
    #[error(
        "a grey picture of {width}x{height} pixels with rows {stride} apart needs {needed} bytes, got {found}"
    )]
    Buffer {
        /// Width of the picture.
        width: usize,
        /// Height of the picture.
        height: usize,
        /// Bytes from row to row.
        stride: usize,
        /// Bytes needed.
        needed: usize,
        /// Bytes given.
        found: usize,
    },
    /// More segments than there is room for.
    #[error("{found} segments given, there is room for {capacity}; pass the best ones")]
    TooManySegments {
        /// Segments given.
        found: usize,
        /// Most segments.
        capacity: usize,
    },
    /// Descriptors were asked for before a picture was given.
    #[error("no picture has been processed yet")]
    NoPicture,
    /// The weights do not fit or a size is out of range.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The runtime refused.
    #[error(transparent)]
    Nn(#[from] NnError),
}

/// Most positions at which the map is read in one run.
const MAX_SAMPLES: usize = 2048;

/// How features are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtractorOptions {
    /// Selection of keypoints.
    pub keypoints: KeypointParams,
    /// Most segments of a picture.
    pub max_segments: usize,
    /// Samples along a segment, both ends included; at least 2.
    pub tokens: usize,
    /// How descriptors are read.
    pub sampler: Sampler,
}

impl ExtractorOptions {
    /// Published selection, 512 segments of 12 samples, the sampler for networks trained here.
    pub fn new(kind: ExtractorKind) -> Self {
        Self {
            keypoints: KeypointParams::published(kind),
            max_segments: 512,
            tokens: 12,
            sampler: kind.default_sampler(),
        }
    }

    /// Samples along the segments of a full picture.
    pub(super) fn token_capacity(&self) -> usize {
        self.max_segments * self.tokens
    }

    /// Samples of one run: all keypoints or all samples along the segments, or part of them where they would take megabytes.
    fn sample_capacity(&self) -> usize {
        let most = self.keypoints.max_keypoints.max(self.token_capacity());
        most.clamp(1, MAX_SAMPLES)
    }
}

/// An extractor with its weights. Networks are built for a picture size when the first picture of that size comes.
#[derive(Debug)]
pub struct Extractor {
    kind: ExtractorKind,
    options: ExtractorOptions,
    level: Level,
    weights: Weights,
    networks: Option<Networks>,
    select: SelectScratch,
    positions: Vec<f32>,
}

#[derive(Debug)]
struct Networks {
    picture: (usize, usize),
    dense: CpuExecutor,
    sampler: CpuExecutor,
}

impl Extractor {
    /// An extractor from its file's weights.
    ///
    /// # Errors
    /// [`FeatureError::Model`] when a weight is missing, misshapen or too many, or an option is out of range.
    pub fn new(
        kind: ExtractorKind,
        weights: Weights,
        options: ExtractorOptions,
    ) -> Result<Self, FeatureError> {
        kind.check_weights(&weights)?;
        if !kind.supports(options.sampler) {
            return Err(ModelError::Mismatch(format!(
                "sampler `{}` does not read the map of `{}`",
                options.sampler.name(),
                kind.name()
            ))
            .into());
        }
        for (field, found, min, max) in [
            ("tokens", options.tokens, 2, 64),
            ("max_segments", options.max_segments, 0, 16_384),
            ("max_keypoints", options.keypoints.max_keypoints, 0, 65_536),
        ] {
            if !(min..=max).contains(&found) {
                return Err(ModelError::Size {
                    field,
                    found,
                    min,
                    max,
                }
                .into());
            }
        }
        Ok(Self {
            kind,
            options,
            level: Level::best(),
            weights,
            networks: None,
            select: SelectScratch::default(),
            positions: Vec::new(),
        })
    }

    /// Uses these kernels instead of the machine's best.
    #[must_use]
    pub fn with_level(mut self, level: Level) -> Self {
        self.level = level;
        self.networks = None;
        self
    }

    /// Which extractor this is.
    pub fn kind(&self) -> ExtractorKind {
        self.kind
    }

    /// The options it was made with.
    pub fn options(&self) -> &ExtractorOptions {
        &self.options
    }

    /// Keypoints, their descriptors, and the descriptors along the segments of a picture.
    ///
    /// # Errors
    /// [`FeatureError`] for a picture that is too small or whose buffer is too short, and for too many segments.
    pub fn extract(
        &mut self,
        gray: &GrayView<'_>,
        segments: &[Segment2],
        out: &mut FeatureSet,
    ) -> Result<(), FeatureError> {
        self.run_dense(gray)?;
        self.select(&mut out.keypoints)?;
        self.describe(segments, out)
    }

    /// Runs the network on a picture. The maps stay until the next picture.
    ///
    /// # Errors
    /// [`FeatureError`] for a picture that is too small or whose buffer is too short.
    pub fn run_dense(&mut self, gray: &GrayView<'_>) -> Result<(), FeatureError> {
        check_picture(self.kind, gray)?;
        let picture = (gray.width, gray.height);
        let networks = match self.networks.take().filter(|n| n.picture == picture) {
            Some(networks) => self.networks.insert(networks),
            None => {
                let networks = self.build(picture)?;
                self.networks.insert(networks)
            }
        };
        write_gray(gray, networks.dense.input(ports::GRAY)?);
        networks.dense.run()?;
        Ok(())
    }

    /// A map of the last picture: [`ports::FEATURES`], [`ports::HEAT`], or [`ports::RELIABILITY`].
    ///
    /// # Errors
    /// [`FeatureError::NoPicture`], [`FeatureError::Nn`] for an unknown name.
    pub fn map(&self, name: &str) -> Result<&[f32], FeatureError> {
        let networks = self.networks.as_ref().ok_or(FeatureError::NoPicture)?;
        Ok(networks.dense.output(name)?)
    }

    /// Keypoints of the last picture, ordered by (y, x).
    ///
    /// # Errors
    /// [`FeatureError::NoPicture`].
    pub fn select(&mut self, out: &mut Vec<Keypoint>) -> Result<(), FeatureError> {
        let networks = self.networks.as_ref().ok_or(FeatureError::NoPicture)?;
        let selection = self.kind.selection();
        let heat = networks.dense.output(selection.heat)?;
        let reliability = match selection.rule {
            SelectionRule::Reliable { reliability, .. } => {
                Some(networks.dense.output(reliability)?)
            }
            SelectionRule::ThreePass => None,
        };
        let (width, height) = networks.picture;
        select_keypoints(
            &selection,
            heat,
            reliability,
            self.kind.inner_size(width, height),
            networks.picture,
            &self.options.keypoints,
            &mut self.select,
            out,
        );
        Ok(())
    }

    /// Fills in descriptors of the keypoints that `out` holds and of these segments, from the last picture.
    ///
    /// # Errors
    /// [`FeatureError::NoPicture`], [`FeatureError::TooManySegments`].
    pub fn describe(
        &mut self,
        segments: &[Segment2],
        out: &mut FeatureSet,
    ) -> Result<(), FeatureError> {
        if segments.len() > self.options.max_segments {
            return Err(FeatureError::TooManySegments {
                found: segments.len(),
                capacity: self.options.max_segments,
            });
        }
        out.descriptor_channels = self.kind.descriptor_channels();
        out.tokens = self.options.tokens;
        out.segments.clear();
        out.segments.extend_from_slice(segments);
        let mut positions = std::mem::take(&mut self.positions);
        positions.clear();
        for keypoint in &out.keypoints {
            positions.extend([keypoint.pixel.x as f32, keypoint.pixel.y as f32]);
        }
        write_token_positions(segments, self.options.tokens, &mut positions);
        let (points, tokens) = positions.split_at(2 * out.keypoints.len());
        let outcome = self
            .sample(points, &mut out.descriptors_nd)
            .and_then(|()| self.sample(tokens, &mut out.segment_descriptors_nsd));
        self.positions = positions;
        outcome
    }

    /// Reads the map at positions (x, y interleaved), in as many runs as the sampler's capacity needs.
    fn sample(&mut self, positions: &[f32], out: &mut Vec<f32>) -> Result<(), FeatureError> {
        let capacity = self.options.sample_capacity();
        let networks = self.networks.as_mut().ok_or(FeatureError::NoPicture)?;
        out.clear();
        for part in positions.chunks(2 * capacity) {
            let sampler = &mut networks.sampler;
            sampler.set_count(ports::SAMPLES, part.len() / 2)?;
            sampler
                .input(ports::CELLS)?
                .copy_from_slice(networks.dense.output(ports::FEATURES)?);
            sampler.input(ports::POSITIONS)?.copy_from_slice(part);
            sampler.run()?;
            out.extend_from_slice(sampler.output(ports::DESCRIPTORS)?);
        }
        Ok(())
    }

    fn build(&self, picture: (usize, usize)) -> Result<Networks, FeatureError> {
        let (width, height) = picture;
        let dense = self.kind.graph(width, height, false)?;
        let sampler = self.kind.sampler_graph(
            width,
            height,
            self.options.sampler,
            self.options.sample_capacity(),
        )?;
        Ok(Networks {
            picture,
            dense: CpuExecutor::with_level(dense, self.weights.clone(), self.level)?,
            sampler: CpuExecutor::with_level(sampler, Weights::new(), self.level)?,
        })
    }
}

fn check_picture(kind: ExtractorKind, gray: &GrayView<'_>) -> Result<(), FeatureError> {
    let (width, height) = (gray.width, gray.height);
    if width < kind.min_side() || height < kind.min_side() {
        return Err(FeatureError::PictureTooSmall {
            width,
            height,
            extractor: kind.name(),
            min_side: kind.min_side(),
        });
    }
    let needed = gray
        .stride
        .checked_mul(height - 1)
        .and_then(|n| n.checked_add(width))
        .unwrap_or(usize::MAX);
    if gray.stride < width || gray.data.len() < needed {
        return Err(FeatureError::Buffer {
            width,
            height,
            stride: gray.stride,
            needed,
            found: gray.data.len(),
        });
    }
    Ok(())
}

/// Writes the picture as numbers 0..1, row-major without gaps.
///
/// # Panics
/// If `out` does not have a number for each pixel, or the view's buffer is too short.
pub fn write_gray(gray: &GrayView<'_>, out: &mut [f32]) {
    assert_eq!(
        out.len(),
        gray.width * gray.height,
        "input has another size than the picture"
    );
    for (target, row) in out
        .chunks_exact_mut(gray.width)
        .zip(gray.data.chunks(gray.stride))
    {
        for (t, v) in target.iter_mut().zip(&row[..gray.width]) {
            *t = f32::from(*v) / 255.0;
        }
    }
}

/// Appends x and y of `tokens` positions evenly along each segment, both ends included.
pub fn write_token_positions(segments: &[Segment2], tokens: usize, out: &mut Vec<f32>) {
    let last = tokens.saturating_sub(1).max(1) as f64;
    for s in segments {
        for i in 0..tokens {
            let a = i as f64 / last;
            out.push((s.start.x + a * (s.end.x - s.start.x)) as f32);
            out.push((s.start.y + a * (s.end.y - s.start.y)) as f32);
        }
    }
}
