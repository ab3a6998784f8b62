//! WGSL kernels in the browser's own compiler against the oracle, on whatever adapter the browser has.

use landline::nn::gpu::{AdapterChoice, GpuDevice, GpuError, GpuNetwork, Pipelines, self_test};
use landline_testkit::{NnCase, nn_cases};
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

async fn run(
    gpu: &Arc<GpuDevice>,
    pipelines: &mut Pipelines,
    case: &NnCase,
) -> Result<Vec<(String, Vec<f32>)>, GpuError> {
    let mut network = GpuNetwork::new(gpu, pipelines, case.graph.clone(), case.weights.clone())?;
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
}

#[wasm_bindgen_test]
async fn the_self_test_passes_and_a_software_adapter_is_refused() {
    let gpu = device().await;
    let mut pipelines = Pipelines::new(&gpu);
    self_test(&gpu, &mut pipelines, None)
        .await
        .expect("a conformant browser");
    if gpu.is_software() {
        let refused = GpuDevice::request(AdapterChoice::Hardware).await;
        assert!(matches!(refused, Err(GpuError::SoftwareAdapter(_))));
    }
}

#[wasm_bindgen_test]
async fn a_lost_device_is_reported() {
    let gpu = device().await;
    let case = &nn_cases(3, 1)[1];
    let mut pipelines = Pipelines::new(&gpu);
    let mut network = GpuNetwork::new(
        &gpu,
        &mut pipelines,
        case.graph.clone(),
        case.weights.clone(),
    )
    .expect("loads");
    gpu.simulate_loss();
    assert!(matches!(network.run(None).await, Err(GpuError::Lost(_))));
}
