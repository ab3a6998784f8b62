//! Features of a data set's pictures, by the same front end as the relocalizer, extracted once and cached.

use crate::augment::Variant;
use crate::dataset::DatasetImage;
use crate::feature_cache::{FeatureCache, FeatureCacheError};
use crate::picture::{self, PictureError};
use crate::progress::Progress;
use landline::features::FeatureSet;
use landline::front_end::{FrontEnd, FrontEndError, FrontEndOptions};
use landline::geometry::{Pixel, Segment2};
use landline::image::GrayImage;
use landline::scene_file::ExtractorFile;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Why features could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ExtractError {
    /// A picture that the import could open cannot be decoded.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// The cache refused.
    #[error(transparent)]
    Cache(#[from] FeatureCacheError),
    /// The extractor and its options do not fit.
    #[error(transparent)]
    Create(#[from] FrontEndError),
    /// A picture that the front end refuses.
    #[error("features of {path}: {source}")]
    Run {
        /// The picture.
        path: PathBuf,
        /// Why.
        source: FrontEndError,
    },
}

/// Makes features and keeps them.
pub struct Extraction {
    file: ExtractorFile,
    options: FrontEndOptions,
    cache: Option<FeatureCache>,
    idle: Mutex<Vec<FrontEnd>>,
}

impl Extraction {
    /// Features of an extractor with options; with a folder they are kept there.
    pub fn new(file: ExtractorFile, options: FrontEndOptions, folder: Option<&Path>) -> Self {
        let maker = maker(&file, &options);
        Self {
            cache: folder.map(|f| FeatureCache::new(f, maker)),
            file,
            options,
            idle: Mutex::new(Vec::new()),
        }
    }

    /// Identity of the extractor and every setting that changes its features.
    pub fn maker(&self) -> String {
        maker(&self.file, &self.options)
    }

    /// The extractor.
    pub fn extractor(&self) -> &ExtractorFile {
        &self.file
    }

    /// How features are made.
    pub fn options(&self) -> &FrontEndOptions {
        &self.options
    }

    /// Features of one picture, in its own pixels.
    ///
    /// # Errors
    /// When the picture cannot be read or the cache cannot be used.
    pub fn features(&self, image: &DatasetImage) -> Result<FeatureSet, ExtractError> {
        self.make(&image.name, image, None, |gray| gray)
    }

    /// Features of the `index`-th variant of a picture, in pixels of the unchanged picture.
    ///
    /// # Errors
    /// As [`Self::features`].
    pub fn variant_features(
        &self,
        image: &DatasetImage,
        index: usize,
    ) -> Result<FeatureSet, ExtractError> {
        let variant = Variant::draw(&image.name, index);
        let name = format!("variants/{index}/{}", image.name);
        let features = self.make(&name, image, None, |gray| variant.apply(&gray))?;
        let (width, height) = (image.camera.width as usize, image.camera.height as usize);
        Ok(variant.to_source(&features, width, height))
    }

    /// As [`Self::features`], with segments from elsewhere (start x, y, end x, y) in place of detected ones: all of them, in
    /// their order.
    ///
    /// # Errors
    /// As [`Self::features`].
    pub fn features_with_segments(
        &self,
        image: &DatasetImage,
        segments: &[[f64; 4]],
    ) -> Result<FeatureSet, ExtractError> {
        self.make(&image.name, image, Some(segments), |gray| gray)
    }

    /// Features of a changed picture, from the cache where they are under `name`.
    fn make(
        &self,
        name: &str,
        image: &DatasetImage,
        segments: Option<&[[f64; 4]]>,
        change: impl FnOnce(GrayImage) -> GrayImage,
    ) -> Result<FeatureSet, ExtractError> {
        let cache = match &self.cache {
            None => None,
            Some(cache) => Some(for_content(cache, image, segments)?),
        };
        if let Some(cache) = &cache
            && let Some(features) = cache.read(name)?
        {
            return Ok(features);
        }
        let gray = change(picture::read_gray(&image.path)?);
        let run_error = |source| ExtractError::Run {
            path: image.path.clone(),
            source,
        };
        let features = match segments {
            // Segments from elsewhere may be more than the idle front ends have room for.
            Some(segments) if segments.len() > self.options.max_segments => {
                let options = FrontEndOptions {
                    max_segments: segments.len(),
                    ..self.options
                };
                let mut front_end = FrontEnd::new(self.file.clone(), options)?;
                run(&mut front_end, &gray, Some(segments)).map_err(run_error)?
            }
            _ => {
                let idle = self.idle.lock().map(|mut idle| idle.pop()).unwrap_or(None);
                let mut front_end = match idle {
                    Some(front_end) => front_end,
                    None => FrontEnd::new(self.file.clone(), self.options)?,
                };
                let features = run(&mut front_end, &gray, segments).map_err(run_error)?;
                if let Ok(mut idle) = self.idle.lock() {
                    idle.push(front_end);
                }
                features
            }
        };
        let Some(cache) = &cache else {
            return Ok(features);
        };
        cache.write(name, &features)?;
        // The cache rounds. A run that was interrupted and one that was not must see the same numbers.
        Ok(cache.read(name)?.unwrap_or(features))
    }

    /// Features of many pictures, in their order. What was done before an error or an interrupt stays in the cache.
    ///
    /// # Errors
    /// The first one that [`Self::features`] meets.
    pub fn all(
        &self,
        images: &[&DatasetImage],
        progress: Progress,
    ) -> Result<Vec<FeatureSet>, ExtractError> {
        self.make_all(images, |_| None, progress)
    }

    /// [`Self::features_with_segments`] of many pictures; `segments` in their order.
    ///
    /// # Errors
    /// The first one that [`Self::features_with_segments`] meets.
    pub fn all_with_segments(
        &self,
        images: &[&DatasetImage],
        segments: &[&[[f64; 4]]],
        progress: Progress,
    ) -> Result<Vec<FeatureSet>, ExtractError> {
        self.make_all(images, |i| segments.get(i).copied(), progress)
    }

    /// Features of `count` variants of each picture, with the picture's index: all of the first picture, then the second.
    ///
    /// # Errors
    /// The first one that [`Self::variant_features`] meets.
    pub fn all_variants(
        &self,
        images: &[&DatasetImage],
        count: usize,
        progress: Progress,
    ) -> Result<Vec<(usize, FeatureSet)>, ExtractError> {
        let bar = progress.bar("extracting variants", images.len() * count);
        let features = (0..images.len() * count)
            .into_par_iter()
            .map(|i| {
                let features = self.variant_features(images[i / count], i % count)?;
                bar.inc(1);
                Ok((i / count, features))
            })
            .collect();
        bar.finish();
        features
    }

    fn make_all<'a>(
        &self,
        images: &[&DatasetImage],
        segments: impl Fn(usize) -> Option<&'a [[f64; 4]]> + Sync,
        progress: Progress,
    ) -> Result<Vec<FeatureSet>, ExtractError> {
        let bar = progress.bar("extracting features", images.len());
        let features = images
            .par_iter()
            .enumerate()
            .map(|(i, image)| {
                let features = self.make(&image.name, image, segments(i), |gray| gray);
                bar.inc(1);
                features
            })
            .collect();
        bar.finish();
        features
    }
}

/// The cache for a picture as it is now: another picture of the same name, or other segments, give other features.
fn for_content(
    cache: &FeatureCache,
    image: &DatasetImage,
    segments: Option<&[[f64; 4]]>,
) -> Result<FeatureCache, ExtractError> {
    let bytes = std::fs::read(&image.path).map_err(|source| PictureError::Open {
        path: image.path.clone(),
        source,
    })?;
    let mut hasher = Sha256::new();
    hasher.update(&bytes);
    for v in segments.into_iter().flatten().flatten() {
        hasher.update(v.to_le_bytes());
    }
    let digest = hasher.finalize();
    let what = if segments.is_some() {
        "picture and segments"
    } else {
        "picture"
    };
    Ok(FeatureCache::new(
        cache.folder(),
        format!("{} {what} {digest:x}", cache.maker()),
    ))
}

fn maker(file: &ExtractorFile, options: &FrontEndOptions) -> String {
    format!("{} {} {options:?}", file.kind.name(), file.source_sha256)
}

fn run(
    front_end: &mut FrontEnd,
    gray: &GrayImage,
    segments: Option<&[[f64; 4]]>,
) -> Result<FeatureSet, FrontEndError> {
    let frame = gray.frame();
    match segments {
        None => front_end.run(&frame)?,
        Some(segments) => {
            let segments: Vec<Segment2> = segments.iter().map(segment_from_ends).collect();
            front_end.run_with_segments(&frame, &segments)?
        }
    };
    let mut features = front_end.features().clone();
    features.map_pixels(&front_end.working_from_sensor().inverse());
    Ok(features)
}

/// A segment of which only the ends are known.
fn segment_from_ends(&[x1, y1, x2, y2]: &[f64; 4]) -> Segment2 {
    Segment2 {
        start: Pixel::new(x1, y1),
        end: Pixel::new(x2, y2),
        width_px: 1.0,
        precision: 0.125,
        neg_log10_nfa: 0.0,
    }
}
