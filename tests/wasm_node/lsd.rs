//! Line segments: the bits of the native build.

use landline_bench::detect_segments;
use wasm_bindgen_test::wasm_bindgen_test;

#[wasm_bindgen_test]
fn segments_have_the_bits_of_the_native_build() {
    landline_testkit::check_lsd_fingerprints(|picture| {
        let (width, height) = (picture.width as u32, picture.height as u32);
        detect_segments(&picture.data, width, height, width).expect("a good picture")
    });
}
