//! The line segment detector takes whatever comes in: pixels that are not finite, sizes at the limits, any parameters.

use crate::lsd_properties::{at_scale, real_segments, segments, step};
use landline::geometry::Segment2;
use landline::image::{GrayView, ImageError, MAX_PIXELS, MAX_SIDE};
use landline::lsd::{
    LsdError, LsdParams, LsdScratch, LsdVersion, RealView, detect, detect_real, post,
};
use landline::math::Rng;
use proptest::prelude::*;

#[test]
fn edges_survive_beside_pixels_that_are_not_finite() {
    let mut data: Vec<f64> = step(false).into_iter().map(f64::from).collect();
    data[100 * 200 + 100] = f64::NAN;
    data[30 * 200 + 99] = f64::INFINITY;
    for scale in [1.0, 0.8] {
        let found = real_segments(&data, 200, &at_scale(scale));
        let length: f64 = found.iter().map(Segment2::length_px).sum();
        assert!(length > 150.0, "{scale}: {length}");
        assert!(
            found
                .iter()
                .all(|s| (s.start.x - 100.0).abs() < 1.0 && s.length_px().is_finite())
        );
    }
}

#[test]
fn pictures_without_room_for_a_segment_are_empty_not_errors() {
    for (w, h) in [(1, 1), (2, 2), (3, 3), (1, 300), (300, 1), (2, 300)] {
        let data: Vec<u8> = (0..w * h).map(|i| (i * 97 % 251) as u8).collect();
        for scale in [0.1, 0.8, 1.0, 2.0] {
            let found = segments(&data, w, &at_scale(scale));
            assert!(found.len() < 20, "{w}x{h}");
        }
    }
    for value in [0, 128, 255] {
        assert!(segments(&[value; 64 * 48], 64, &LsdParams::default()).is_empty());
    }
}

#[test]
fn inputs_that_disagree_are_named() {
    let mut scratch = LsdScratch::default();
    let data = [0; 100];
    let view = GrayView {
        data: &data,
        width: 10,
        height: 10,
        stride: 10,
    };
    let params = LsdParams::default();
    let mut error = |view: GrayView<'_>| detect(&view, &params, &mut scratch).map(|s| s.len());
    for (bad, want) in [
        (GrayView { width: 0, ..view }, "0x10"),
        (GrayView { stride: 9, ..view }, "stride of 9"),
        (GrayView { height: 11, ..view }, "holds 100 but 110"),
        (
            GrayView {
                width: MAX_SIDE + 1,
                stride: 20_000,
                ..view
            },
            "16385x10",
        ),
    ] {
        let message = error(bad).expect_err("refused").to_string();
        assert!(message.contains(want), "{message}");
    }
    const { assert!(MAX_SIDE * MAX_SIDE > MAX_PIXELS) };
    let huge = GrayView {
        width: MAX_SIDE,
        height: MAX_SIDE,
        stride: usize::MAX,
        ..view
    };
    assert!(matches!(
        error(huge),
        Err(LsdError::Image(ImageError::TooLarge { .. }))
    ));
    let params = LsdParams {
        angle_tolerance_deg: 0.0,
        ..LsdParams::default()
    };
    let message = detect(&view, &params, &mut scratch)
        .expect_err("refused")
        .to_string();
    assert_eq!(
        message,
        "LSD parameter angle_tolerance_deg is 0; it must be above 0 and below 180"
    );
}

#[test]
fn the_longest_side_allowed_works() {
    let data: Vec<u8> = (0..MAX_SIDE * 5)
        .map(|i| if i / MAX_SIDE < 2 { 0 } else { 200 })
        .collect();
    for (w, params) in [(MAX_SIDE, at_scale(0.8)), (5, at_scale(1.0))] {
        let found = segments(&data, w, &params);
        assert!(found.iter().all(|s| s.length_px().is_finite()));
        if w == MAX_SIDE {
            assert!(found[0].length_px() > 16_000.0);
        }
    }
}

/// Pictures with some structure, so that growing, refinement and improvement all run.
fn any_picture() -> impl Strategy<Value = (usize, usize, usize, Vec<u8>)> {
    (0usize..70, 0usize..70, 0usize..5, any::<u64>(), 0u8..4).prop_map(|(w, h, pad, seed, kind)| {
        let mut rng = Rng::from_seed(seed);
        let (a, b) = (rng.uniform() - 0.5, rng.uniform() - 0.5);
        let stride = w + pad;
        let data = (0..stride * h)
            .map(|i| {
                let (x, y) = ((i % stride.max(1)) as f64, (i / stride.max(1)) as f64);
                let noise = 255.0 * rng.uniform();
                let wave = 127.0 + 120.0 * (a * x + b * y + 0.01 * x * y * a).sin();
                match kind {
                    0 => noise as u8,
                    1 => wave as u8,
                    2 => (0.8 * wave + 0.2 * noise) as u8,
                    _ => {
                        if (x * a + y * b).fract() > 0.5 {
                            255
                        } else {
                            0
                        }
                    }
                }
            })
            .collect();
        (w, h, stride, data)
    })
}

fn any_params() -> impl Strategy<Value = LsdParams> {
    let scale = prop_oneof![Just(0.8), Just(1.0), 0.05..3.0f64];
    let angle = prop_oneof![
        Just(22.5),
        0.01..179.9f64,
        Just(90.0),
        Just(1e-9),
        Just(179.999)
    ];
    let bins = prop_oneof![Just(1024usize), Just(1), 1usize..65_536];
    (
        scale,
        0.01..4.0f64,
        0.0..20.0f64,
        angle,
        -50.0..50.0f64,
        0.0..=1.0f64,
        bins,
        any::<bool>(),
    )
        .prop_map(
            |(
                scale,
                sigma_scale,
                quantization_bound,
                angle_tolerance_deg,
                least,
                density,
                bins,
                old,
            )| LsdParams {
                scale,
                sigma_scale,
                quantization_bound,
                angle_tolerance_deg,
                min_neg_log10_nfa: least,
                min_density: density,
                num_bins: bins,
                version: if old {
                    LsdVersion::V1_5
                } else {
                    LsdVersion::V1_6
                },
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_picture_and_parameters_give_finite_segments_or_an_error(
        (width, height, stride, data) in any_picture(),
        params in any_params(),
        cut in 0usize..40,
    ) {
        let len = data.len().saturating_sub(if cut < 36 { 0 } else { cut });
        let view = GrayView { data: &data[..len], width, height, stride };
        let mut scratch = LsdScratch::default();
        match detect(&view, &params, &mut scratch) {
            Err(error) => {
                prop_assert!(width == 0 || height == 0 || len < stride * (height - 1) + width, "{error}");
            }
            Ok(found) => {
                for s in found {
                    prop_assert!(s.length_px().is_finite() && s.width_px > 0.0);
                    prop_assert!(s.neg_log10_nfa > params.min_neg_log10_nfa);
                }
                let first = found.to_vec();
                // The same again from used scratch memory, from real levels, and through the steps that follow.
                let again = detect(&view, &params, &mut scratch).expect("as before").to_vec();
                prop_assert_eq!(&again, &first);
                let levels: Vec<f64> = view.data.iter().map(|&v| f64::from(v)).collect();
                let real = RealView { data: &levels, width, height, stride };
                let again = detect_real(&real, &params, &mut scratch).expect("as before");
                prop_assert_eq!(again, &first[..]);
                let steps = post::PostParams {
                    merge: Some(landline::lsd::MergeParams::default()),
                    min_length_px: 3.0,
                    max_count: 7,
                    ..post::PostParams::default()
                };
                let mut kept = first;
                post::apply(&mut kept, &steps);
                prop_assert!(kept.len() <= 7);
            }
        }
    }

    #[test]
    fn any_real_levels_are_survived(
        width in 1usize..40,
        values in prop::collection::vec(
            prop_oneof![0.0..255.0f64, Just(f64::NAN), Just(f64::INFINITY), Just(-f64::INFINITY), Just(1e300), Just(-1e300), Just(1e-300)],
            0..1600,
        ),
        params in any_params(),
    ) {
        let height = values.len() / width;
        let view = RealView { data: &values, width, height, stride: width };
        if let Ok(found) = detect_real(&view, &params, &mut LsdScratch::default()) {
            for s in found {
                prop_assert!(!s.length_px().is_nan());
            }
        }
    }
}
