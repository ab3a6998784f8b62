//! Keypoints from an extractor's maps, as the references choose them.

use super::Keypoint;
use crate::geometry::Pixel;
use crate::math::order::Best;
use crate::models::{CELL, ExtractorKind, Selection, SelectionRule};

/// How keypoints are chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeypointParams {
    /// Half the side of the suppression window, without its centre, pixels of the keypoint map.
    pub nms_radius: usize,
    /// Values of the keypoint map that are not above this are no keypoints.
    pub min_heat: f32,
    /// Keypoints closer to the border of the keypoint map than this are dropped, pixels.
    pub border: usize,
    /// Most keypoints; the best by score stay.
    pub max_keypoints: usize,
}

impl KeypointParams {
    /// The settings that the extractor was published with; for SuperPoint those of the paper's experiments.
    pub fn published(kind: ExtractorKind) -> Self {
        let published = kind.selection();
        Self {
            nms_radius: published.nms_radius,
            min_heat: published.min_heat,
            border: published.border,
            max_keypoints: published.max_keypoints,
        }
    }
}

/// Buffers of [`select_keypoints`], reused from frame to frame.
#[derive(Debug, Default)]
pub struct SelectScratch {
    candidates: Vec<Candidate>,
    best: Best,
    is_max: Vec<bool>,
    suppressed: Vec<bool>,
    masked: Vec<f32>,
    filtered: Vec<f32>,
    rows: Vec<f32>,
    flags: Vec<bool>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate {
    x: usize,
    y: usize,
    score: f32,
}

/// Chooses keypoints by the extractor's rule. `heat_hw` is the keypoint map of `inner` (width, height) pixels;
/// `reliability_hw` has a value for each cell, where the rule asks for one. Positions come out in pixels of the picture of size
/// `picture` that the extractor was given.
///
/// # Panics
/// If a map does not have the size given.
#[expect(
    clippy::too_many_arguments,
    reason = "maps and sizes of one network run"
)]
pub fn select_keypoints(
    selection: &Selection,
    heat_hw: &[f32],
    reliability_hw: Option<&[f32]>,
    inner: (usize, usize),
    picture: (usize, usize),
    params: &KeypointParams,
    scratch: &mut SelectScratch,
    out: &mut Vec<Keypoint>,
) {
    let (width, height) = inner;
    assert_eq!(
        heat_hw.len(),
        width * height,
        "keypoint map has another size"
    );
    let mut candidates = std::mem::take(&mut scratch.candidates);
    candidates.clear();
    match selection.rule {
        SelectionRule::Reliable { sampler, .. } => {
            let cells = (width / CELL, height / CELL);
            if let Some(reliability) = reliability_hw {
                assert_eq!(
                    reliability.len(),
                    cells.0 * cells.1,
                    "reliability has another size"
                );
            }
            local_maxima(heat_hw, width, height, params, &mut candidates);
            let (to_x, to_y) = (sampler.axis(width, width), sampler.axis(height, height));
            candidates.retain_mut(|c| {
                if c.x + 1 == width || c.y + 1 == height {
                    return false;
                }
                if let Some(reliability) = reliability_hw {
                    let fx = to_x.scale * (c.x as f32 + 0.5) + to_x.offset;
                    let fy = to_y.scale * (c.y as f32 + 0.5) + to_y.offset;
                    c.score *= bilinear(reliability, cells, fx, fy);
                }
                c.score > 0.0
            });
        }
        SelectionRule::ThreePass => {
            three_pass_maxima(heat_hw, width, height, params.nms_radius, scratch);
            let b = params.border;
            for y in b..height.saturating_sub(b) {
                for x in b..width.saturating_sub(b) {
                    let i = y * width + x;
                    if scratch.is_max[i] && heat_hw[i] > params.min_heat {
                        candidates.push(Candidate {
                            x,
                            y,
                            score: heat_hw[i],
                        });
                    }
                }
            }
        }
    }
    // They stand row by row: of equal scores the upper left ones stay, so that the same maps always give the same set.
    let scores = (0..).zip(candidates.iter().map(|c| c.score));
    scratch.best.choose(params.max_keypoints, scores);
    let kept = (0..)
        .zip(&candidates)
        .filter(|(i, c)| scratch.best.keeps(*i, c.score));

    let (sx, sy) = selection.picture_per_map(picture, inner);
    out.clear();
    out.extend(kept.map(|(_, c)| Keypoint {
        pixel: Pixel::new((c.x as f64 + 0.5) * sx, (c.y as f64 + 0.5) * sy),
        score: c.score,
    }));
    scratch.candidates = candidates;
}

/// Pixels above the threshold that no pixel of their window exceeds.
fn local_maxima(
    heat: &[f32],
    width: usize,
    height: usize,
    params: &KeypointParams,
    out: &mut Vec<Candidate>,
) {
    let (r, b) = (params.nms_radius, params.border);
    for y in b..height.saturating_sub(b) {
        let rows = y.saturating_sub(r)..(y + r + 1).min(height);
        for x in b..width.saturating_sub(b) {
            let score = heat[y * width + x];
            if score <= params.min_heat {
                continue;
            }
            let (from, to) = (x.saturating_sub(r), (x + r + 1).min(width));
            let highest = rows.clone().all(|yy| {
                heat[yy * width + from..yy * width + to]
                    .iter()
                    .all(|v| *v <= score)
            });
            if highest {
                out.push(Candidate { x, y, score });
            }
        }
    }
}

/// SuperPoint's suppression: window maxima; then, twice, what lies in a maximum's window is set to zero and the window maxima
/// of the rest join, unless they lie in such a window. The result is in `scratch.is_max`.
fn three_pass_maxima(heat: &[f32], width: usize, height: usize, r: usize, s: &mut SelectScratch) {
    max_filter(heat, width, height, r, &mut s.rows, &mut s.filtered);
    s.is_max.clear();
    s.is_max
        .extend(heat.iter().zip(&s.filtered).map(|(v, m)| v == m));
    for _ in 0..2 {
        spread(&s.is_max, width, height, r, &mut s.flags, &mut s.suppressed);
        s.masked.clear();
        s.masked.extend(
            heat.iter()
                .zip(&s.suppressed)
                .map(|(v, hidden)| if *hidden { 0.0 } else { *v }),
        );
        max_filter(&s.masked, width, height, r, &mut s.rows, &mut s.filtered);
        for (i, is_max) in s.is_max.iter_mut().enumerate() {
            *is_max |= s.masked[i] == s.filtered[i] && !s.suppressed[i];
        }
    }
}

/// Largest value in each (2r + 1)-window.
fn max_filter(
    values: &[f32],
    width: usize,
    height: usize,
    r: usize,
    rows: &mut Vec<f32>,
    out: &mut Vec<f32>,
) {
    rows.clear();
    rows.extend_from_slice(values);
    for (target, source) in rows.chunks_exact_mut(width).zip(values.chunks_exact(width)) {
        for shift in 1..=r.min(width - 1) {
            let n = width - shift;
            for (t, v) in target[..n].iter_mut().zip(&source[shift..]) {
                *t = t.max(*v);
            }
            for (t, v) in target[shift..].iter_mut().zip(&source[..n]) {
                *t = t.max(*v);
            }
        }
    }
    out.clear();
    out.extend_from_slice(rows);
    for shift in 1..=r.min(height - 1) {
        let n = (height - shift) * width;
        for (t, v) in out[..n].iter_mut().zip(&rows[shift * width..]) {
            *t = t.max(*v);
        }
        for (t, v) in out[shift * width..].iter_mut().zip(&rows[..n]) {
            *t = t.max(*v);
        }
    }
}

/// Whether any flag of each (2r + 1)-window is set.
fn spread(
    flags: &[bool],
    width: usize,
    height: usize,
    r: usize,
    rows: &mut Vec<bool>,
    out: &mut Vec<bool>,
) {
    rows.clear();
    rows.resize(flags.len(), false);
    out.clear();
    out.resize(flags.len(), false);
    for (i, _) in flags.iter().enumerate().filter(|(_, f)| **f) {
        let (x, y) = (i % width, i / width);
        rows[y * width + x.saturating_sub(r)..y * width + (x + r + 1).min(width)].fill(true);
    }
    for (y, row) in rows.chunks_exact(width).enumerate() {
        for yy in y.saturating_sub(r)..(y + r + 1).min(height) {
            for (t, f) in out[yy * width..(yy + 1) * width].iter_mut().zip(row) {
                *t |= f;
            }
        }
    }
}

/// Bilinear value at a cell position; cells outside count as zero.
fn bilinear(map: &[f32], (width, height): (usize, usize), x: f32, y: f32) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let (ax, ay) = (x - x0, y - y0);
    let at = |xi: f32, yi: f32| {
        if xi < 0.0 || yi < 0.0 || xi >= width as f32 || yi >= height as f32 {
            return 0.0;
        }
        map[yi as usize * width + xi as usize]
    };
    let top = at(x0, y0) * (1.0 - ax) + at(x0 + 1.0, y0) * ax;
    let bottom = at(x0, y0 + 1.0) * (1.0 - ax) + at(x0 + 1.0, y0 + 1.0) * ax;
    top * (1.0 - ay) + bottom * ay
}

#[cfg(test)]
mod tests {
    use super::*;

    fn select(kind: ExtractorKind, heat: &[f32], side: usize, max: usize) -> Vec<(f64, f64)> {
        let params = KeypointParams {
            max_keypoints: max,
            border: 0,
            ..KeypointParams::published(kind)
        };
        let mut out = Vec::new();
        select_keypoints(
            &kind.selection(),
            heat,
            None,
            (side, side),
            (side, side),
            &params,
            &mut SelectScratch::default(),
            &mut out,
        );
        out.iter().map(|k| (k.pixel.x, k.pixel.y)).collect()
    }

    #[test]
    fn keeps_the_best_in_order_of_position() {
        let mut heat = vec![0.0; 32 * 32];
        for (x, y, v) in [
            (20, 3, 0.5),
            (4, 9, 0.9),
            (25, 20, 0.7),
            (26, 21, 0.6),
            (10, 30, 0.06),
        ] {
            heat[y * 32 + x] = v;
        }
        let all = select(ExtractorKind::Xfeat, &heat, 32, 100);
        assert_eq!(all, [(20.5, 3.5), (4.5, 9.5), (25.5, 20.5), (10.5, 30.5)]);
        let best = select(ExtractorKind::Xfeat, &heat, 32, 2);
        assert_eq!(best, [(4.5, 9.5), (25.5, 20.5)]);
        assert!(select(ExtractorKind::Xfeat, &heat, 32, 0).is_empty());
    }

    #[test]
    fn last_column_and_row_never_become_xfeat_keypoints() {
        let mut heat = vec![0.0; 32 * 32];
        heat[5 * 32 + 31] = 0.9;
        heat[31 * 32 + 5] = 0.9;
        assert!(select(ExtractorKind::Xfeat, &heat, 32, 10).is_empty());
    }

    #[test]
    fn second_and_third_pass_bring_back_what_a_suppressed_pixel_hid() {
        // 0.9 hides 0.8 two pixels on; 0.8 hides 0.7; once 0.8 is suppressed, 0.7 is a maximum again.
        let mut heat = vec![0.0; 32 * 32];
        for (x, v) in [(10, 0.9), (12, 0.8), (15, 0.7)] {
            heat[10 * 32 + x] = v;
        }
        let got = select(ExtractorKind::SuperPointV1, &heat, 32, 10);
        assert_eq!(got, [(10.5, 10.5), (15.5, 10.5)]);
    }

    #[test]
    fn filters_agree_with_their_definition() {
        let (w, h) = (13, 9);
        let values: Vec<f32> = (0..w * h).map(|i| ((i * 7919) % 101) as f32).collect();
        let flags: Vec<bool> = values.iter().map(|v| *v > 95.0).collect();
        for r in [0, 1, 3, 20] {
            let (mut rows, mut out) = (Vec::new(), Vec::new());
            max_filter(&values, w, h, r, &mut rows, &mut out);
            let (mut frows, mut fout) = (Vec::new(), Vec::new());
            spread(&flags, w, h, r, &mut frows, &mut fout);
            for y in 0..h {
                for x in 0..w {
                    let window = (y.saturating_sub(r)..(y + r + 1).min(h)).flat_map(|yy| {
                        (x.saturating_sub(r)..(x + r + 1).min(w)).map(move |xx| yy * w + xx)
                    });
                    let highest = window.clone().map(|i| values[i]).fold(0.0, f32::max);
                    assert_eq!(out[y * w + x], highest);
                    assert_eq!(fout[y * w + x], window.clone().any(|i| flags[i]));
                }
            }
        }
    }
}
