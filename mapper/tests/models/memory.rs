//! What a frame takes of memory, counted by the allocator.

use landline::features::{Extractor, ExtractorOptions, FeatureSet};
use landline::geometry::{Pixel, Segment2};
use landline::image::GrayImage;
use landline::models::{ExtractorKind, Preset, RegressorConfig, TensorSpec};
use landline::nn::{WeightTensor, Weights};
use landline::regress::{Predictions, Regressor};
use landline::scene_file::{ExtractorFile, Precision, SceneFile, SceneInfo};
use landline_testkit::{CountingAllocator, peak_bytes};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// What a page may spend on a frame, from the files' bytes to the scene points.
const FRAME_BUDGET: usize = 80_000_000;

/// Small random weights.
pub(crate) fn noise(specs: Vec<TensorSpec>) -> Weights {
    let mut state = 9_u32;
    let mut next = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / 16_777_216.0 - 0.5) * 0.1
    };
    specs
        .into_iter()
        .map(|t| {
            let data = (0..t.shape.iter().product::<usize>())
                .map(|_| next())
                .collect();
            (
                t.name,
                WeightTensor::f32(&t.shape, data).expect("sizes agree"),
            )
        })
        .collect()
}

/// The files as a page fetches them: f16.
fn files() -> (Vec<u8>, Vec<u8>) {
    let kind = ExtractorKind::Xfeat;
    let extractor = ExtractorFile {
        kind,
        source_sha256: "0".repeat(64),
        source: String::new(),
        licence: String::new(),
        weights: noise(kind.tensors()),
    };
    let config = RegressorConfig::preset(Preset::Paper, kind.descriptor_channels());
    let scene = SceneFile {
        info: SceneInfo::new(kind, "0".repeat(64)),
        weights: noise(config.tensors()),
        landmarks: None,
        config,
    };
    (
        extractor.to_bytes(Precision::F16).expect("writes"),
        scene.to_bytes(Precision::F16).expect("writes"),
    )
}

#[test]
fn a_frame_with_xfeat_and_the_paper_network_fits_in_80_mb() {
    let (extractor_bytes, scene_bytes) = files();
    let held = extractor_bytes.len() + scene_bytes.len();
    let gray = GrayImage {
        data: (0..640 * 480_u64).map(|i| (i * 7919 % 251) as u8).collect(),
        width: 640,
        height: 480,
    };
    let segments: Vec<Segment2> = (0..300)
        .map(|i| Segment2 {
            start: Pixel::new(10.0, 10.0 + f64::from(i)),
            end: Pixel::new(600.0, 20.0 + f64::from(i)),
            width_px: 1.0,
            precision: 0.125,
            neg_log10_nfa: 10.0,
        })
        .collect();
    // A page has one thread; here each would have working room of its own.
    let one_thread = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a thread starts");
    let frame = || {
        let file = ExtractorFile::from_bytes(&extractor_bytes).expect("reads");
        let mut options = ExtractorOptions::new(file.kind);
        options.max_segments = 300;
        options.keypoints.min_heat = 0.0;
        let mut extractor = Extractor::new(file.kind, file.weights, options).expect("fits");
        let scene = SceneFile::from_bytes(&scene_bytes).expect("reads");
        let mut regressor = Regressor::new(
            &scene.config,
            scene.weights,
            scene.info.scale,
            options.keypoints.max_keypoints,
            options.max_segments,
        )
        .expect("fits");
        let mut features = FeatureSet::default();
        extractor
            .extract(&gray.view(), &segments, &mut features)
            .expect("extracts");
        let mut out = Predictions::default();
        regressor.run(&features, &mut out).expect("runs");
        (features.keypoints.len(), features.segments.len())
    };
    let (counts, peak) = one_thread.install(|| peak_bytes(frame));
    assert_eq!(counts, (1024, 300), "a full frame");
    println!(
        "peak {:.1} MB, of which files {:.1} MB",
        (peak + held) as f64 / 1e6,
        held as f64 / 1e6
    );
    assert!(peak + held < FRAME_BUDGET, "{} bytes", peak + held);
}
