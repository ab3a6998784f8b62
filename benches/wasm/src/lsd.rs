//! The line segment detector on its own.

use landline::image::GrayView;
use landline::lsd::{LsdParams, LsdScratch, detect};
use std::cell::RefCell;
use wasm_bindgen::JsError;
use wasm_bindgen::prelude::wasm_bindgen;

/// Numbers for each segment in the result of [`detect_segments`].
pub const NUMBERS_PER_SEGMENT: usize = 7;

thread_local! {
    // Kept between calls, so that a video's second frame allocates nothing in the detector.
    static SCRATCH: RefCell<LsdScratch> = RefCell::default();
}

/// Line segments of a grey picture in detection order: for each x1, y1, x2, y2 (corner-based pixels), width (pixels),
/// precision, -log10 of the number of false alarms. `stride` counts bytes from row to row.
///
/// # Errors
/// An `Error` when size, stride and buffer disagree.
#[wasm_bindgen(js_name = detectSegments)]
pub fn detect_segments(
    bytes: &[u8],
    width: u32,
    height: u32,
    stride: u32,
) -> Result<Vec<f64>, JsError> {
    let gray = GrayView {
        data: bytes,
        width: width as usize,
        height: height as usize,
        stride: stride as usize,
    };
    SCRATCH.with_borrow_mut(|scratch| {
        let segments = detect(&gray, &LsdParams::default(), scratch)
            .map_err(|error| JsError::new(&error.to_string()))?;
        let mut numbers = Vec::with_capacity(NUMBERS_PER_SEGMENT * segments.len());
        for s in segments {
            numbers.extend_from_slice(&s.to_numbers());
        }
        Ok(numbers)
    })
}
