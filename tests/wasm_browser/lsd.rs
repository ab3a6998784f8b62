//! Line segments: the bits of the native build.

use landline_web::detect_segments;
use wasm_bindgen::JsCast as _;
use wasm_bindgen_test::wasm_bindgen_test;

#[wasm_bindgen_test]
fn segments_have_the_bits_of_the_native_build() {
    landline_testkit::check_lsd_fingerprints(|picture| {
        let (width, height) = (picture.width as u32, picture.height as u32);
        detect_segments(&picture.data, width, height, width).expect("a good picture")
    });
}

#[wasm_bindgen_test]
fn a_buffer_of_the_wrong_length_is_refused_with_a_code() {
    let error = detect_segments(&[0; 99], 10, 10, 10).expect_err("refused");
    let code = js_sys::Reflect::get(&error, &"code".into()).expect("an object");
    assert_eq!(code.as_string().as_deref(), Some("bad-input"));
    let message = String::from(error.unchecked_into::<js_sys::Error>().message());
    assert!(message.contains("holds 99 but 100 are needed"), "{message}");
}
