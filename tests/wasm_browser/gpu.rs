//! WGSL kernels in the browser's own compiler against the oracle, on whatever adapter the browser has, and the way back to
//! the CPU from inside a page.

use landline::geometry::Camera;
use landline::image::{FrameView, PixelFormat};
use landline::math::Rng;
use landline::models::{ExtractorKind, Preset, RegressorConfig};
use landline::nn::gpu::{
    AdapterChoice, Fault, GpuDevice, GpuError, GpuNetwork, Outputs, Pipelines, WeightStorage,
    self_test,
};
use landline::relocalizer::{GpuNetworks, Query, Relocalizer, RelocalizerOptions, Report};
use landline_testkit::{NnCase, nn_cases, random_picture, random_scene};
use std::sync::Arc;
use wasm_bindgen_test::{console_log, wasm_bindgen_test};

/// A device; the browser tier always has one, because Chromium brings a software adapter.
async fn device() -> Arc<GpuDevice> {
    let gpu = GpuDevice::request(AdapterChoice::Any)
        .await
        .expect("an adapter");
    console_log!("adapter: {}", gpu.adapter_name());
    gpu
}

async fn load(
    gpu: &Arc<GpuDevice>,
    pipelines: &mut Pipelines,
    case: &NnCase,
) -> Result<GpuNetwork, GpuError> {
    let (graph, weights) = (case.graph.clone(), case.weights.clone());
    GpuNetwork::new(gpu, pipelines, graph, weights, WeightStorage::Exact).await
}

async fn run(
    gpu: &Arc<GpuDevice>,
    pipelines: &mut Pipelines,
    case: &NnCase,
) -> Result<Outputs, GpuError> {
    let mut network = load(gpu, pipelines, case).await?;
    for (name, count) in &case.counts {
        network.set_count(name, *count)?;
    }
    for (name, data) in &case.inputs {
        network.write_input(name, data)?;
    }
    network.run(None).await
}

#[wasm_bindgen_test]
async fn every_kernel_agrees_with_the_oracle() {
    let gpu = device().await;
    let mut pipelines = Pipelines::new(&gpu);
    let mut failures = Vec::new();
    for case in nn_cases(5, 1) {
        match run(&gpu, &mut pipelines, &case).await {
            Ok(found) => failures.extend(case.difference(&found)),
            Err(error) => failures.push(format!("{}: {error}", case.name)),
        }
    }
    assert!(
        failures.is_empty(),
        "{} cases differ:\n{}",
        failures.len(),
        failures.join("\n")
    );
    assert_eq!(gpu.check(), Ok(()), "the browser refused something");
}

#[wasm_bindgen_test]
async fn the_self_test_passes_and_a_software_adapter_is_refused() {
    let gpu = device().await;
    let mut pipelines = Pipelines::new(&gpu);
    let storage = self_test(&gpu, &mut pipelines, None)
        .await
        .expect("a conformant browser");
    assert_eq!(storage, WeightStorage::Exact);
    if gpu.is_software() {
        let refused = GpuDevice::request(AdapterChoice::Hardware).await;
        assert!(matches!(refused, Err(GpuError::SoftwareAdapter(_))));
    }
}

#[wasm_bindgen_test]
async fn what_is_wrong_with_a_device_is_found_out() {
    for (fault, expected) in [
        (Fault::NoAdapter, "no GPU adapter"),
        (Fault::LowLimit, "maxComputeWorkgroupStorageSize"),
        (Fault::ShaderError, "refused"),
        (Fault::WrongAnswer, "self-test"),
        (Fault::LateMap, "did not answer"),
        (Fault::Lost, "lost"),
    ] {
        let made = GpuDevice::request_with_fault(AdapterChoice::Any, Some(fault)).await;
        let error = match made {
            Ok(gpu) => self_test(&gpu, &mut Pipelines::new(&gpu), None).await.err(),
            Err(error) => Some(error),
        };
        let text = error.map(|error| error.to_string()).unwrap_or_default();
        assert!(text.contains(expected), "{fault:?}: {text}");
    }
}

#[wasm_bindgen_test]
async fn a_lost_device_is_reported() {
    let gpu = device().await;
    let mut pipelines = Pipelines::new(&gpu);
    let case = &nn_cases(3, 1)[1];
    let mut network = load(&gpu, &mut pipelines, case).await.expect("loads");
    gpu.simulate(Fault::Lost);
    assert!(matches!(network.run(None).await, Err(GpuError::Lost(_))));
}

const SIDE: usize = 64;

async fn locate(relocalizer: &mut Relocalizer, gray: &[u8]) -> Report {
    let frame = FrameView::tight(gray, SIDE as u32, SIDE as u32, PixelFormat::Luma8);
    let query = Query::with_camera(Camera::centered(SIDE as u32, SIDE as u32, 60.0));
    relocalizer
        .locate_with_gpu(&frame, &query, &mut || 0.0)
        .await
        .expect("a valid frame")
}

#[wasm_bindgen_test]
async fn a_whole_frame_agrees_with_the_cpu_and_the_cpu_takes_over() {
    let gpu = device().await;
    let kind = ExtractorKind::Xfeat;
    let config = RegressorConfig::preset(Preset::Compact, kind.descriptor_channels());
    let (scene, extractor) = random_scene(kind, config);
    let change = |options: &mut RelocalizerOptions| {
        let options = &mut options.front_end;
        options.keypoints.min_heat = 0.012;
        options.keypoints.max_keypoints = 60;
        options.max_segments = 20;
        options.min_segment_px = 6.0;
    };
    let mut on_cpu = Relocalizer::new(scene.clone(), extractor.clone(), change).expect("makes");
    let mut on_gpu = Relocalizer::new(scene.clone(), extractor.clone(), change).expect("makes");
    let options = on_gpu.options().front_end;
    let networks = GpuNetworks::new(Arc::clone(&gpu), &scene, &extractor, &options, None)
        .await
        .expect("fits");
    on_gpu.use_gpu(networks).expect("made for it");
    let gray = random_picture(SIDE, SIDE, &mut Rng::from_seed(5)).data;

    let expected = locate(&mut on_cpu, &gray).await;
    let made = {
        locate(&mut on_gpu, &gray).await;
        gpu.num_objects_created()
    };
    let found = locate(&mut on_gpu, &gray).await;
    assert!(found.on_gpu, "{:?}", on_gpu.gpu_failure());
    assert_eq!(gpu.num_objects_created(), made, "a frame made objects");
    assert!(expected.counts.num_keypoints > 20, "{expected:?}");
    assert_eq!(found.counts.num_keypoints, expected.counts.num_keypoints);
    assert_eq!(found.counts.num_segments, expected.counts.num_segments);
    let theirs: Vec<_> = on_gpu.points().map(|(c, _)| c).collect();
    for (c, _) in on_cpu.points() {
        let same = theirs.iter().find(|o| o.pixel.distance(c.pixel) < 1e-3);
        let off = same.map(|o| (o.point_in_world - c.point_in_world).norm());
        assert!(off.is_some_and(|off| off < 1e-3), "{c:?}: {off:?}");
    }
    assert_eq!(gpu.check(), Ok(()), "the browser refused something");

    // Nothing to see, nothing to do: valid all the same.
    assert!(locate(&mut on_gpu, &[90; SIDE * SIDE]).await.on_gpu);
    gpu.simulate(Fault::Lost);
    let report = locate(&mut on_gpu, &gray).await;
    assert!(!report.on_gpu);
    assert_eq!(report.counts, expected.counts);
    assert!(on_gpu.gpu_failure().is_some_and(|why| why.contains("lost")));
}
