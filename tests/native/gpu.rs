//! The GPU executor against the oracle, and what happens when the device fails.

use std::sync::Arc;

use landline::nn::gpu::{AdapterChoice, GpuDevice, GpuError, GpuNetwork, Pipelines};
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
