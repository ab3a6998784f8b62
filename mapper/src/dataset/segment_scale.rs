//! Of which picture size are imported segments?
//!
//! Line mapping tools shrink pictures before they look for segments (LIMAP: `max_image_dim`) and write positions of the
//! shrunk picture. What the segments lie on decides: the right scale puts them on edges, a wrong one beside them.

use super::DatasetImage;
use crate::picture;
use landline::image::GrayImage;

/// Pictures that are looked at, and segments in each.
const MAX_PICTURES: usize = 6;
const MAX_SEGMENTS: usize = 200;
/// Places along a segment.
const NUM_SAMPLES: usize = 12;
/// Fewer segments than this decide nothing.
const LEAST_SEGMENTS: usize = 50;
/// Another scale has to put segments on edges that are so much stronger.
const LEAST_GAIN: f64 = 1.5;
/// Beyond the border by this much a segment is of another picture.
const MAX_OUTSIDE_PX: f64 = 2.0;

/// Scales segments (start x, y, end x, y; one list a picture) to the pictures, where they were found at another size.
/// Returns what was done, for the table.
///
/// # Errors
/// In words, when they lie outside their pictures at every size that fits.
pub(super) fn fit_to_pictures(
    images: &[DatasetImage],
    segments: &mut [Vec<[f64; 4]>],
) -> Result<Option<String>, String> {
    let long_side = |image: &DatasetImage| f64::from(image.camera.width.max(image.camera.height));
    // How far segments reach, as a part of the picture's longer side.
    let mut reach = 0.0_f64;
    for (image, own) in images.iter().zip(segments.iter()) {
        let is_wide = image.camera.width >= image.camera.height;
        for [x1, y1, x2, y2] in own {
            let far = if is_wide { x1.max(*x2) } else { y1.max(*y2) };
            reach = reach.max(far / long_side(image));
        }
    }
    let Some(first) = images
        .iter()
        .zip(segments.iter())
        .find(|(_, own)| !own.is_empty())
    else {
        return Ok(None);
    };
    let side = long_side(first.0);
    let is_outside = reach > 1.0 + MAX_OUTSIDE_PX / side;
    // A detector finds something near the border of some picture; where it does, only the stated size fits.
    if !is_outside && reach > 0.99 {
        return Ok(None);
    }
    let is_enough = segments.iter().map(Vec::len).sum::<usize>() >= LEAST_SEGMENTS;
    if !is_outside && !is_enough {
        return Ok(None);
    }
    let samples = Sampled::read(images, segments);
    // Sizes are whole numbers of pixels, from the least that holds all segments to one that they would fill badly.
    let least = (reach * side - 0.5).ceil().max(1.0);
    let most = (1.25 * least).max(least + 8.0);
    let (mut best, mut best_side) = (0.0, side);
    let mut candidate = least;
    while candidate <= most {
        let support = samples.support(side / candidate);
        if support > best {
            (best, best_side) = (support, candidate);
        }
        candidate += 1.0;
    }
    let as_given = samples.support(1.0);
    if is_enough && best > LEAST_GAIN * as_given && best_side != side {
        let scale = side / best_side;
        for v in segments.iter_mut().flatten().flatten() {
            *v *= scale;
        }
        return Ok(Some(format!(
            "segments are of pictures {best_side} pixels long, not {side}: scaled by {scale:.4} (edges under them are \
             {:.1} times as strong)",
            best / as_given.max(1e-9)
        )));
    }
    if is_outside {
        return Err(format!(
            "segments reach to {:.0} pixels in pictures of {side}, and fit at no other size: are they of these pictures?",
            reach * side
        ));
    }
    Ok(None)
}

/// Some pictures with some of their segments.
struct Sampled(Vec<(GrayImage, Vec<[f64; 4]>)>);

impl Sampled {
    fn read(images: &[DatasetImage], segments: &[Vec<[f64; 4]>]) -> Self {
        let chosen: Vec<_> = images
            .iter()
            .zip(segments)
            .filter(|(_, own)| !own.is_empty())
            .collect();
        let step = chosen.len().div_ceil(MAX_PICTURES).max(1);
        Self(
            chosen
                .into_iter()
                .step_by(step)
                .filter_map(|(image, own)| {
                    // A picture that cannot be decoded is reported where its features are made.
                    let gray = picture::read_gray(&image.path).ok()?;
                    let step = own.len().div_ceil(MAX_SEGMENTS).max(1);
                    Some((gray, own.iter().copied().step_by(step).collect()))
                })
                .collect(),
        )
    }

    /// Mean strength of the edges under the segments, scaled so: the grey step across them.
    fn support(&self, scale: f64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (gray, segments) in &self.0 {
            for segment in segments {
                let [x1, y1, x2, y2] = segment.map(|v| v * scale);
                let (dx, dy) = (x2 - x1, y2 - y1);
                let length = dx.hypot(dy);
                if !(length > 0.0) {
                    continue;
                }
                let (nx, ny) = (-dy / length, dx / length);
                for i in 0..NUM_SAMPLES {
                    let along = (i as f64 + 0.5) / NUM_SAMPLES as f64;
                    let (x, y) = (x1 + along * dx, y1 + along * dy);
                    let step = match (grey(gray, x + nx, y + ny), grey(gray, x - nx, y - ny)) {
                        (Some(a), Some(b)) => (a - b).abs(),
                        // Outside there is no edge.
                        _ => 0.0,
                    };
                    sum += step;
                    count += 1.0;
                }
            }
        }
        sum / f64::max(count, 1.0)
    }
}

/// Grey level at a corner-based position, between pixels by weight.
fn grey(gray: &GrayImage, x: f64, y: f64) -> Option<f64> {
    let (x, y) = (x - 0.5, y - 0.5);
    if !(x >= 0.0 && y >= 0.0) {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    if column + 1 >= gray.width || row + 1 >= gray.height {
        return None;
    }
    let (tx, ty) = (x - column as f64, y - row as f64);
    let at = |c: usize, r: usize| f64::from(gray.data[r * gray.width + c]);
    let top = at(column, row) * (1.0 - tx) + at(column + 1, row) * tx;
    let bottom = at(column, row + 1) * (1.0 - tx) + at(column + 1, row + 1) * tx;
    Some(top * (1.0 - ty) + bottom * ty)
}
