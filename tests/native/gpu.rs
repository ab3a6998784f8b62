//! The GPU executor against the oracle, and what happens when the device fails.

use std::sync::Arc;

use landline::nn::gpu::{AdapterChoice, GpuDevice, GpuError, GpuNetwork, Pipelines, self_test};
use landline_testkit::{NnCase, nn_cases, skip_without_gpu};

/// A device, software or not; without any the test is skipped with the reason.
fn device() -> Option<Arc<GpuDevice>> {
    match pollster::block_on(GpuDevice::request(AdapterChoice::Any)) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            skip_without_gpu(&error.to_string());
            None
        }
    }
}

fn run(
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
    pollster::block_on(network.run(None))
}

#[test]
fn every_kernel_agrees_with_the_oracle_on_random_shapes() {
    let Some(gpu) = device() else { return };
    let mut pipelines = Pipelines::new(&gpu);
    let failures: Vec<String> = nn_cases(1, 2)
        .iter()
        .filter_map(|case| match run(&gpu, &mut pipelines, case) {
            Ok(found) => case.difference(&found),
            Err(error) => Some(format!("{}: {error}", case.name)),
        })
        .collect();
    assert!(
        failures.is_empty(),
        "{} cases differ:\n{}",
        failures.len(),
        failures.join("\n")
    );
}

#[test]
fn the_comparison_notices_a_kernel_that_is_one_row_off() {
    let case = &nn_cases(2, 1)[0];
    let mut found = case.expected().expect("the oracle runs");
    assert_eq!(case.difference(&found), None);
    let shifted: Vec<f32> = found[0].1.iter().map(|x| x + 1e-3).collect();
    found[0].1 = shifted;
    assert!(case.difference(&found).is_some() || found[0].1.is_empty());
}

/// A small network that runs on the device.
fn small(gpu: &Arc<GpuDevice>, pipelines: &mut Pipelines) -> GpuNetwork {
    let case = &nn_cases(3, 1)[1];
    GpuNetwork::new(gpu, pipelines, case.graph.clone(), case.weights.clone()).expect("loads")
}

#[test]
fn two_thousand_runs_make_no_objects() {
    let Some(gpu) = device() else { return };
    let mut network = small(&gpu, &mut Pipelines::new(&gpu));
    let before = gpu.num_objects_created();
    for _ in 0..2000 {
        pollster::block_on(network.run(None)).expect("runs");
    }
    assert_eq!(gpu.num_objects_created(), before);
}

#[test]
fn a_lost_device_is_reported() {
    let Some(gpu) = device() else { return };
    let mut network = small(&gpu, &mut Pipelines::new(&gpu));
    gpu.simulate_loss();
    assert!(matches!(
        pollster::block_on(network.run(None)),
        Err(GpuError::Lost(_))
    ));
}

#[test]
fn weights_that_do_not_fit_are_refused() {
    let Some(gpu) = device() else { return };
    let case = nn_cases(4, 1)
        .into_iter()
        .find(|case| !case.graph.weights().is_empty())
        .expect("some case has weights");
    let made = GpuNetwork::new(
        &gpu,
        &mut Pipelines::new(&gpu),
        case.graph,
        landline::nn::Weights::new(),
    );
    assert!(matches!(made, Err(GpuError::Network(_))));
}

#[test]
fn the_self_test_passes_here() {
    let Some(gpu) = device() else { return };
    let mut pipelines = Pipelines::new(&gpu);
    pollster::block_on(self_test(&gpu, &mut pipelines, None)).expect("a conformant driver");
}
