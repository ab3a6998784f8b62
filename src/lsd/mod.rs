//! Line segment detector: finds straight edges in a grey image, with a bound on the number of false detections.
//!
//! Input and output: [`GrayView`] in, [`Segment2`] out, through [`detect`]; scratch memory belongs to the caller.
//! Units: grey levels 0..=255, corner-based pixels of the given image. Inside, coordinates are those of the published
//! program (centre of the first pixel at (0, 0)); 0.5 is added once, on the way out.
//! Algorithm: LSD, `[lsd2010]` as published with its program in `[lsd2012]` (version 1.6): Gaussian resampling, level-line
//! field, pseudo-ordering, region growing, refinement by density, rectangle improvement, a-contrario validation.
//! Invariants: segments come in detection order; walking from start to end the darker side lies at the right hand; the
//! same input gives the same bits on every target, because the arithmetic is f64 with one software math library.
//! Cost: nothing is allocated after the first image of a size; time grows linearly with the number of pixels.

mod field;
mod kernels;
mod merge;
mod nfa;
mod params;
pub mod post;
mod rectangle;
mod region;
mod resample;

pub use merge::{MergeParams, Merged, merge_collinear};
pub use params::{LsdError, LsdParams, LsdVersion};

use crate::geometry::{Pixel, Segment2};
use crate::image::{GrayView, check_layout};
use core::f64::consts::PI;
use field::{AVAILABLE, Field};
use nfa::NfaTable;
use params::Tolerance;
use rectangle::Rectangle;
use region::Region;
use resample::{Resampler, Rows, Sample};

/// A grey image of real-valued levels, borrowed. Pixels may be NaN or infinite: edges do not pass through them.
#[derive(Debug, Clone, Copy)]
pub struct RealView<'a> {
    /// At least `stride * (height - 1) + width` levels, in the range 0..=255 that the thresholds are made for.
    pub data: &'a [f64],
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// Samples from one row to the next.
    pub stride: usize,
}

/// Memory of the detector, reused from image to image. About 30 bytes for each working pixel.
#[derive(Debug, Default)]
pub struct LsdScratch {
    resampler: Resampler,
    field: Field,
    region: Region,
    nfa: Option<NfaTable>,
    segments: Vec<Segment2>,
}

/// Detects the line segments of a grey image, in detection order.
///
/// # Errors
/// [`LsdError`] when the view is inconsistent or a parameter is out of range. An image without segments, even one too
/// small to hold any, is not an error: the result is empty.
pub fn detect<'a>(
    gray: &GrayView<'_>,
    params: &LsdParams,
    scratch: &'a mut LsdScratch,
) -> Result<&'a [Segment2], LsdError> {
    let rows = Rows {
        data: gray.data,
        width: gray.width,
        height: gray.height,
        stride: gray.stride,
    };
    detect_rows(&rows, params, scratch)
}

/// [`detect`] for real-valued levels.
///
/// # Errors
/// As [`detect`].
pub fn detect_real<'a>(
    image: &RealView<'_>,
    params: &LsdParams,
    scratch: &'a mut LsdScratch,
) -> Result<&'a [Segment2], LsdError> {
    let rows = Rows {
        data: image.data,
        width: image.width,
        height: image.height,
        stride: image.stride,
    };
    detect_rows(&rows, params, scratch)
}

fn detect_rows<'a, T: Sample>(
    image: &Rows<'_, T>,
    params: &LsdParams,
    scratch: &'a mut LsdScratch,
) -> Result<&'a [Segment2], LsdError> {
    scratch.segments.clear();
    params.check()?;
    check_layout(
        image.data.len(),
        image.width,
        image.height,
        image.stride,
        image.width,
    )?;
    let size_in = (image.width, image.height);
    let size = params.working_size(image.width, image.height)?;
    if size.0 < 2 || size.1 < 2 {
        return Ok(&scratch.segments);
    }
    let precision = params.angle_tolerance_deg / 180.0;
    let tolerance = Tolerance::new(PI * precision);
    let LsdScratch {
        resampler,
        field,
        region,
        nfa,
        segments,
    } = scratch;

    resampler.prepare(size_in, size, params.scale, params.sigma_scale);
    let least_norm = params.quantization_bound / libm::sin(tolerance.rad);
    field.compute(image, resampler, size, least_norm);
    let (num_precisions, max_norm) = match params.version {
        LsdVersion::V1_6 => (11.0, field.max_norm),
        LsdVersion::V1_5 => (1.0, 255.0),
    };
    field.sort(params.num_bins, max_norm);

    // Pairs of end points times widths, [lsd2012]: (NM)^2 sqrt(NM), for each precision that may be tried.
    let log10_tests = 2.5 * (libm::log10(size.0 as f64) + libm::log10(size.1 as f64))
        + libm::log10(num_precisions);
    // With fewer pixels even a fully aligned region cannot be meaningful.
    let min_region = (-log10_tests / libm::log10(precision)) as usize;
    let nfa = nfa.get_or_insert_with(|| NfaTable::new(precision, log10_tests));
    nfa.prepare(precision, log10_tests);

    let order = core::mem::take(&mut field.order);
    for &seed in &order {
        if field.state[field.index(seed)] & AVAILABLE == 0 {
            continue;
        }
        region.grow(field, seed, &tolerance);
        if region.pixels.len() < min_region {
            continue;
        }
        let Some(rectangle) = Rectangle::of_region(region, field, &tolerance) else {
            continue;
        };
        let Some(rectangle) = region.refined(field, rectangle, params.min_density, &tolerance)
        else {
            continue;
        };
        let (rectangle, neg_log10_nfa) = rectangle.improved(field, nfa, params.min_neg_log10_nfa);
        if neg_log10_nfa > params.min_neg_log10_nfa {
            segments.push(output(&rectangle, neg_log10_nfa, nfa, params.scale));
        }
    }
    field.order = order;
    Ok(segments)
}

/// From working coordinates to corner-based pixels of the input.
fn output(rectangle: &Rectangle, neg_log10_nfa: f64, nfa: &NfaTable, scale: f64) -> Segment2 {
    // The gradient belongs to the middle of its 2x2 pixels; the grids of input and working image share their origin.
    let pixel =
        |p: [f64; 2]| Pixel::from_index_coordinates((p[0] + 0.5) / scale, (p[1] + 0.5) / scale);
    Segment2 {
        start: pixel(rectangle.start),
        end: pixel(rectangle.end),
        width_px: rectangle.width / scale,
        precision: nfa.precision(rectangle.halvings),
        neg_log10_nfa,
    }
}
