//! The pipeline with its networks on the GPU against the same on the CPU, and the move to the CPU when the device fails.

use crate::gpu_frame::{picture, random_weights};
use landline::{
    geometry::Camera,
    image::{FrameView, PixelFormat},
    math::Rng,
    models::{ExtractorKind, Preset, RegressorConfig},
    nn::gpu::{AdapterChoice, GpuDevice},
    relocalizer::{GpuNetworks, Query, Relocalizer, RelocalizerOptions, Report},
    scene_file::{ExtractorFile, SceneFile, SceneInfo},
};
use landline_testkit::skip_without_gpu;
use std::sync::Arc;

const WIDTH: u32 = 160;
const HEIGHT: u32 = 128;

/// Options that make networks of random weights say something.
fn change(options: &mut RelocalizerOptions) {
    options.keypoints.min_heat = 0.012;
    options.keypoints.max_keypoints = 150;
    options.max_segments = 40;
    options.min_segment_px = 8.0;
}

fn files(preset: Preset) -> (SceneFile, ExtractorFile) {
    let mut rng = Rng::from_seed(21);
    let kind = ExtractorKind::Xfeat;
    let config = RegressorConfig::preset(preset, kind.descriptor_channels());
    let weights = random_weights(&config.tensors(), &mut rng);
    let sha256 = "ab".repeat(32);
    let scene = SceneFile {
        info: SceneInfo::new(kind, sha256.clone()),
        config,
        weights,
    };
    let extractor = ExtractorFile {
        kind,
        source_sha256: sha256,
        source: "random".to_owned(),
        licence: "none".to_owned(),
        weights: random_weights(&kind.tensors(), &mut rng),
    };
    (scene, extractor)
}

fn device() -> Option<Arc<GpuDevice>> {
    match pollster::block_on(GpuDevice::request(AdapterChoice::Any)) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            skip_without_gpu(&error.to_string());
            None
        }
    }
}

fn locate(relocalizer: &mut Relocalizer, bytes: &[u8]) -> Report {
    let frame = FrameView {
        bytes,
        width: WIDTH,
        height: HEIGHT,
        stride: WIDTH as usize,
        format: PixelFormat::Luma8,
    };
    let query = Query::with_camera(Camera::centered(WIDTH, HEIGHT, 150.0));
    pollster::block_on(relocalizer.locate_with_gpu(&frame, &query, &mut || 0.0))
        .expect("a valid frame")
}

fn pair(gpu: &Arc<GpuDevice>, preset: Preset) -> (Relocalizer, Relocalizer) {
    let (scene, extractor) = files(preset);
    let networks = pollster::block_on(GpuNetworks::new(
        Arc::clone(gpu),
        &scene,
        &extractor,
        change,
        None,
    ))
    .expect("fits");
    let on_cpu = Relocalizer::new(scene.clone(), extractor.clone(), change).expect("makes");
    let mut on_gpu = Relocalizer::new(scene, extractor, change).expect("makes");
    on_gpu.use_gpu(networks);
    (on_cpu, on_gpu)
}

#[test]
fn correspondences_are_those_of_the_cpu() {
    let Some(gpu) = device() else { return };
    for preset in [Preset::Compact, Preset::Standard] {
        let (mut on_cpu, mut on_gpu) = pair(&gpu, preset);
        let gray = picture(WIDTH as usize, HEIGHT as usize, &mut Rng::from_seed(3));
        let expected = locate(&mut on_cpu, &gray.data);
        let found = locate(&mut on_gpu, &gray.data);
        assert_eq!(on_gpu.gpu_failure(), None);
        assert!(
            expected.counts.num_keypoints > 100 && expected.counts.num_segments > 5,
            "{expected:?}"
        );
        assert_eq!(found.counts.num_keypoints, expected.counts.num_keypoints);
        assert_eq!(found.counts.num_segments, expected.counts.num_segments);
        let theirs: Vec<_> = on_gpu.points().map(|(c, _)| c).collect();
        let (mut common, mut worst) = (0, 0.0_f64);
        for (c, _) in on_cpu.points() {
            if let Some(other) = theirs.iter().find(|o| o.pixel.distance(c.pixel) < 1e-3) {
                common += 1;
                worst = worst.max((other.point_in_world - c.point_in_world).norm());
            }
        }
        let of = expected.counts.num_point_correspondences;
        assert!(
            common as f64 >= 0.98 * of as f64,
            "{preset:?}: {common} of {of} points in common"
        );
        assert!(worst < 1e-3, "{preset:?}: points off by {worst}");
        let lines = on_gpu.lines().zip(on_cpu.lines());
        let worst = lines
            .map(|((a, _), (b, _))| (a.start_in_world - b.start_in_world).norm())
            .fold(0.0, f64::max);
        assert!(worst < 1e-3, "{preset:?}: lines off by {worst}");
    }
}

#[test]
fn a_lost_device_hands_over_to_the_cpu_and_says_so() {
    let Some(gpu) = device() else { return };
    let (mut on_cpu, mut on_gpu) = pair(&gpu, Preset::Compact);
    let gray = picture(WIDTH as usize, HEIGHT as usize, &mut Rng::from_seed(4));
    locate(&mut on_gpu, &gray.data);
    assert!(on_gpu.gpu().is_some_and(|gpu| gpu.cost().is_some()));
    gpu.simulate_loss();
    let found = locate(&mut on_gpu, &gray.data);
    let expected = locate(&mut on_cpu, &gray.data);
    assert_eq!(
        found.counts, expected.counts,
        "the frame is answered all the same"
    );
    assert!(on_gpu.gpu().is_none());
    assert!(
        on_gpu.gpu_failure().is_some_and(|why| why.contains("lost")),
        "{:?}",
        on_gpu.gpu_failure()
    );
}

#[test]
fn pictures_of_changing_sizes_and_without_features_are_answered() {
    let Some(gpu) = device() else { return };
    let (_, mut on_gpu) = pair(&gpu, Preset::Compact);
    let flat = vec![128; (WIDTH * HEIGHT) as usize];
    let report = locate(&mut on_gpu, &flat);
    assert!(report.outcome.located().is_none());
    let gray = picture(96, 64, &mut Rng::from_seed(5));
    let frame = FrameView {
        bytes: &gray.data,
        width: 96,
        height: 64,
        stride: 96,
        format: PixelFormat::Luma8,
    };
    let query = Query::with_camera(Camera::centered(96, 64, 90.0));
    pollster::block_on(on_gpu.locate_with_gpu(&frame, &query, &mut || 0.0)).expect("another size");
    assert_eq!(on_gpu.gpu_failure(), None);
}
