//! The pipeline with its networks on the GPU against the same on the CPU, and the move to the CPU when the device fails.

use landline::{
    geometry::Camera,
    image::GrayImage,
    math::Rng,
    models::{
        ExtractorKind, LineBranchConfig, PointBranchConfig, Preset, RegressorConfig, V1Config,
    },
    nn::gpu::{AdapterChoice, Fault, GpuDevice, GpuError},
    relocalizer::{GpuNetworks, LocateError, Query, Relocalizer, RelocalizerOptions, Report},
    scene_file::{ExtractorFile, SceneFile},
};
use landline_testkit::{gpu_or_skip, random_picture, random_scene};
use std::sync::Arc;

const WIDTH: usize = 160;
const HEIGHT: usize = 128;

/// Options that make networks of random weights say something.
fn change(options: &mut RelocalizerOptions) {
    let options = &mut options.front_end;
    options.keypoints.min_heat = 0.012;
    options.keypoints.max_keypoints = 150;
    options.max_segments = 40;
    options.min_segment_px = 8.0;
}

fn preset(preset: Preset) -> (SceneFile, ExtractorFile) {
    let kind = ExtractorKind::Xfeat;
    let config = RegressorConfig::preset(preset, kind.descriptor_channels());
    random_scene(kind, config)
}

fn any_device() -> Option<Arc<GpuDevice>> {
    gpu_or_skip(GpuDevice::request(AdapterChoice::Any))
}

fn query(gray: &GrayImage) -> Query {
    let (width, height) = (gray.width as u32, gray.height as u32);
    Query::with_camera(Camera::centered(width, height, 150.0))
}

fn locate(relocalizer: &mut Relocalizer, gray: &GrayImage) -> Report {
    pollster::block_on(relocalizer.locate_with_gpu(&gray.frame(), &query(gray), &mut || 0.0))
        .expect("a valid frame")
}

fn networks(
    gpu: &Arc<GpuDevice>,
    (scene, extractor): &(SceneFile, ExtractorFile),
    options: &RelocalizerOptions,
) -> Result<GpuNetworks, GpuError> {
    let options = &options.front_end;
    let gpu = Arc::clone(gpu);
    pollster::block_on(GpuNetworks::new(gpu, scene, extractor, options, None))
}

/// The same scene on the CPU and on the device.
fn pair(
    gpu: &Arc<GpuDevice>,
    files: (SceneFile, ExtractorFile),
    change: fn(&mut RelocalizerOptions),
) -> (Relocalizer, Relocalizer) {
    let (scene, extractor) = files.clone();
    let on_cpu = Relocalizer::new(scene.clone(), extractor.clone(), change).expect("makes");
    let mut on_gpu = Relocalizer::new(scene, extractor, change).expect("makes");
    let made = networks(gpu, &files, on_gpu.options()).expect("fits");
    on_gpu.use_gpu(made).expect("made for it");
    (on_cpu, on_gpu)
}

fn a_picture(seed: u64) -> GrayImage {
    random_picture(WIDTH, HEIGHT, &mut Rng::from_seed(seed))
}

/// Both find the same things and say the same about them.
fn check(
    files: (SceneFile, ExtractorFile),
    gray: &GrayImage,
    change: fn(&mut RelocalizerOptions),
    at_least: usize,
) {
    let Some(gpu) = any_device() else { return };
    let (mut on_cpu, mut on_gpu) = pair(&gpu, files, change);
    let expected = locate(&mut on_cpu, gray);
    let found = locate(&mut on_gpu, gray);
    assert_eq!(on_gpu.gpu_failure(), None);
    assert!(found.on_gpu && !expected.on_gpu);
    assert!(
        expected.counts.num_keypoints > at_least && expected.counts.num_segments > 5,
        "{expected:?}"
    );
    assert_eq!(found.counts.num_keypoints, expected.counts.num_keypoints);
    assert_eq!(found.counts.num_segments, expected.counts.num_segments);
    let size = 2.0
        * on_cpu
            .points()
            .map(|(c, _)| c.point_in_world.norm())
            .fold(0.5, f64::max);
    let theirs: Vec<_> = on_gpu.points().map(|(c, _)| c).collect();
    let (mut common, mut worst) = (0, 0.0_f64);
    for (c, _) in on_cpu.points() {
        if let Some(other) = theirs.iter().find(|o| o.pixel.distance(c.pixel) < 1e-3) {
            common += 1;
            worst = worst.max((other.point_in_world - c.point_in_world).norm());
        }
    }
    let of = expected.counts.num_point_correspondences;
    assert!(of > 0, "no point survives the network's own choice");
    assert!(
        common as f64 >= 0.98 * of as f64,
        "{common} of {of} points in common"
    );
    assert!(worst < 1e-3 * size, "points off by {worst} of {size}");
    let lines = on_gpu.lines().zip(on_cpu.lines());
    let worst = lines
        .map(|((a, _), (b, _))| (a.start_in_world - b.start_in_world).norm())
        .fold(0.0, f64::max);
    assert!(worst < 1e-3 * size, "lines off by {worst} of {size}");
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}

#[test]
fn compact_agrees_with_the_cpu() {
    check(preset(Preset::Compact), &a_picture(3), change, 100);
}

#[test]
fn standard_agrees_with_the_cpu() {
    check(preset(Preset::Standard), &a_picture(3), change, 100);
}

#[test]
fn paper_agrees_with_the_cpu() {
    let kind = ExtractorKind::Xfeat;
    let mut config = RegressorConfig::preset(Preset::Paper, kind.descriptor_channels());
    if let RegressorConfig::Branches {
        point: PointBranchConfig::Attention(point),
        line: Some(LineBranchConfig::Attention(line)),
    } = &mut config
    {
        // Random heads are sure of nothing.
        (point.min_confidence, line.min_confidence) = (0.0, 0.0);
    }
    check(random_scene(kind, config), &a_picture(3), change, 100);
}

#[test]
fn v1_on_superpoint_agrees_with_the_cpu() {
    let config = V1Config {
        // Random heads are sure of nothing.
        min_point_confidence: 0.0,
        min_line_confidence: 0.0,
        ..V1Config::paper()
    };
    let files = random_scene(ExtractorKind::SuperPointV1, RegressorConfig::V1(config));
    let gray = random_picture(96, 72, &mut Rng::from_seed(3));
    let few = |options: &mut RelocalizerOptions| {
        let options = &mut options.front_end;
        options.keypoints.min_heat = 0.0;
        options.keypoints.max_keypoints = 60;
        options.max_segments = 20;
        options.min_segment_px = 6.0;
    };
    check(files, &gray, few, 40);
}

#[test]
fn the_next_frame_may_begin_before_the_last_one_is_solved() {
    let Some(gpu) = any_device() else { return };
    let (mut one_by_one, mut overlapping) = pair_on_gpu(&gpu);
    let frames = [a_picture(5), a_picture(6), a_picture(7)];
    let expected: Vec<Report> = frames.iter().map(|f| locate(&mut one_by_one, f)).collect();
    let mut clock = || 0.0;
    let found: Vec<Report> = pollster::block_on(async {
        let mut reports = Vec::new();
        let mut begun = overlapping
            .begin(&frames[0].frame(), &query(&frames[0]), &mut clock)
            .await
            .expect("a valid frame");
        for (i, gray) in frames.iter().enumerate() {
            let observed = overlapping
                .observe(begun, &mut clock)
                .await
                .expect("in order");
            let next = &frames[(i + 1) % frames.len()];
            begun = overlapping
                .begin(&next.frame(), &query(next), &mut clock)
                .await
                .expect("a valid frame");
            reports.push(
                overlapping
                    .solve(observed, &query(gray), &mut clock)
                    .expect("in order"),
            );
        }
        // The last one that was begun is replaced, and says so.
        let again = overlapping
            .begin(&frames[0].frame(), &query(&frames[0]), &mut clock)
            .await;
        let late = overlapping
            .observe(begun, &mut clock)
            .await
            .expect_err("replaced");
        assert!(
            matches!(late, LocateError::OutOfOrder { number: 4 }),
            "{late}"
        );
        let observed = overlapping
            .observe(again.expect("a valid frame"), &mut clock)
            .await;
        assert!(observed.is_ok());
        reports
    });
    for (e, f) in expected.iter().zip(&found) {
        assert!(f.on_gpu);
        assert_eq!(f.counts, e.counts);
        assert_eq!(f.outcome, e.outcome);
    }
}

fn pair_on_gpu(gpu: &Arc<GpuDevice>) -> (Relocalizer, Relocalizer) {
    let both = || pair(gpu, preset(Preset::Compact), change).1;
    (both(), both())
}

/// What every failure must lead to: the frame is answered by the CPU, and the result says why.
fn answered_by_the_cpu(report: &Report, on_gpu: &Relocalizer, on_cpu: &mut Relocalizer, why: &str) {
    let expected = locate(on_cpu, &a_picture(4));
    assert!(!report.on_gpu);
    assert_eq!(report.counts, expected.counts);
    assert_eq!(report.outcome, expected.outcome);
    assert!(
        on_gpu.gpu_failure().is_some_and(|text| text.contains(why)),
        "{:?}",
        on_gpu.gpu_failure()
    );
}

#[test]
fn a_lost_device_hands_over_to_the_cpu_once_and_says_so() {
    let Some(gpu) = any_device() else { return };
    let (mut on_cpu, mut on_gpu) = pair(&gpu, preset(Preset::Compact), change);
    assert!(locate(&mut on_gpu, &a_picture(4)).on_gpu);
    assert!(on_gpu.gpu().is_some_and(|gpu| gpu.cost().is_some()));
    gpu.simulate(Fault::Lost);
    for _ in 0..2 {
        let report = locate(&mut on_gpu, &a_picture(4));
        answered_by_the_cpu(&report, &on_gpu, &mut on_cpu, "lost");
        assert!(on_gpu.gpu().is_none(), "the device is given up once");
    }
}

#[test]
fn a_device_lost_between_the_steps_of_a_frame_does_not_lose_the_frame() {
    let Some(gpu) = any_device() else { return };
    let (mut on_cpu, mut on_gpu) = pair(&gpu, preset(Preset::Compact), change);
    let (gray, mut clock) = (a_picture(4), || 0.0);
    let report = pollster::block_on(async {
        let begun = on_gpu.begin(&gray.frame(), &query(&gray), &mut clock).await;
        gpu.simulate(Fault::Lost);
        let observed = on_gpu
            .observe(begun.expect("a valid frame"), &mut clock)
            .await;
        on_gpu.solve(observed.expect("answered"), &query(&gray), &mut clock)
    });
    answered_by_the_cpu(&report.expect("answered"), &on_gpu, &mut on_cpu, "lost");
}

#[test]
fn one_late_answer_is_forgiven_and_two_are_not() {
    let Some(gpu) = any_device() else { return };
    let (mut on_cpu, mut on_gpu) = pair(&gpu, preset(Preset::Compact), change);
    gpu.simulate(Fault::LateMap);
    let report = locate(&mut on_gpu, &a_picture(4));
    answered_by_the_cpu(&report, &on_gpu, &mut on_cpu, "did not answer within");
    assert!(on_gpu.gpu().is_some());
    gpu.recover();
    let report = locate(&mut on_gpu, &a_picture(4));
    assert!(report.on_gpu);
    assert_eq!(on_gpu.gpu_failure(), None);
    gpu.simulate(Fault::LateMap);
    for _ in 0..2 {
        let report = locate(&mut on_gpu, &a_picture(4));
        answered_by_the_cpu(&report, &on_gpu, &mut on_cpu, "did not answer within");
    }
    assert!(on_gpu.gpu().is_none(), "two in a row");
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}

#[test]
fn a_shader_error_in_the_scenes_networks_hands_over_to_the_cpu() {
    let Some(gpu) = any_device() else { return };
    let (mut on_cpu, mut on_gpu) = pair(&gpu, preset(Preset::Compact), change);
    // The self-test is behind us; the kernels of the first picture's size are yet to come.
    gpu.simulate(Fault::ShaderError);
    let report = locate(&mut on_gpu, &a_picture(4));
    answered_by_the_cpu(&report, &on_gpu, &mut on_cpu, "the driver refused");
    assert!(on_gpu.gpu().is_none());
    assert_eq!(gpu.check(), Ok(()), "it was caught where it was made");
}

#[test]
fn a_wrong_device_never_gets_the_networks() {
    let Some(gpu) = any_device() else { return };
    gpu.simulate(Fault::WrongAnswer);
    let files = preset(Preset::Compact);
    let options = RelocalizerOptions::for_scene(&files.0);
    let error = networks(&gpu, &files, &options).expect_err("wrong");
    assert!(error.to_string().contains("self-test"), "{error}");
}

#[test]
fn networks_that_were_made_with_other_options_are_refused() {
    let Some(gpu) = any_device() else { return };
    let files = preset(Preset::Compact);
    let options = RelocalizerOptions::for_scene(&files.0);
    let made = networks(&gpu, &files, &options).expect("fits");
    let mut relocalizer = Relocalizer::new(files.0, files.1, change).expect("makes");
    let refused = relocalizer.use_gpu(made).expect_err("other options");
    assert!(refused.to_string().contains("prepared with"), "{refused}");
    assert!(relocalizer.gpu().is_none());
}

#[test]
fn pictures_of_changing_sizes_and_without_features_are_answered() {
    let Some(gpu) = any_device() else { return };
    let (_, mut on_gpu) = pair(&gpu, preset(Preset::Compact), change);
    let flat = GrayImage {
        data: vec![128; WIDTH * HEIGHT],
        width: WIDTH,
        height: HEIGHT,
    };
    let first = locate(&mut on_gpu, &a_picture(5));
    for (width, height) in [(96, 64), (64, 96), (33, 40)] {
        let gray = random_picture(width, height, &mut Rng::from_seed(5));
        assert!(locate(&mut on_gpu, &gray).on_gpu, "{width}x{height}");
        let report = locate(&mut on_gpu, &flat);
        assert!(report.on_gpu && report.outcome.located().is_none());
    }
    let again = locate(&mut on_gpu, &a_picture(5));
    assert_eq!(again.counts, first.counts);
    assert_eq!(on_gpu.gpu_failure(), None);
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}

#[test]
fn more_segments_than_capacity_keep_the_longest_on_both_backends() {
    fn crowded(options: &mut RelocalizerOptions) {
        change(options);
        options.front_end.max_segments = 6;
        options.front_end.min_segment_px = 1.0;
    }
    check(preset(Preset::Compact), &a_picture(8), crowded, 100);
}
