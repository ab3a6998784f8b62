//! The GPU executor against the oracle, and what happens when the device fails.

use std::sync::Arc;

use landline::nn::gpu::{
    AdapterChoice, Fault, GpuDevice, GpuError, GpuExecutor, GpuNetwork, MAP_DEADLINE_MS, Pipelines,
    WeightStorage, self_test,
};
use landline_testkit::{CPU_KINDS, NnCase, gpu_or_skip, nn_case, nn_cases};

fn any_device() -> Option<Arc<GpuDevice>> {
    gpu_or_skip(GpuDevice::request(AdapterChoice::Any))
}

fn load(
    gpu: &Arc<GpuDevice>,
    pipelines: &mut Pipelines,
    case: &NnCase,
) -> Result<GpuNetwork, GpuError> {
    pollster::block_on(GpuNetwork::new(
        gpu,
        pipelines,
        case.graph.clone(),
        case.weights.clone(),
        WeightStorage::Exact,
    ))
}

#[test]
fn every_kernel_agrees_with_the_oracle_on_random_shapes() {
    let Some(gpu) = any_device() else { return };
    let mut pipelines = Pipelines::new(&gpu);
    let failures: Vec<String> = nn_cases(1, 2)
        .iter()
        .filter_map(|case| {
            let (graph, weights) = (case.graph.clone(), case.weights.clone());
            let mut device = GpuExecutor::new(&gpu, &mut pipelines, graph, weights).expect("loads");
            match case.run(&mut device) {
                Ok(found) => case.difference(&found),
                Err(error) => Some(format!("{}: {error}", case.name)),
            }
        })
        .collect();
    assert!(
        failures.is_empty(),
        "{} cases differ:\n{}",
        failures.len(),
        failures.join("\n")
    );
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}

/// Widths that are no multiple of four: no scene has them today.
#[test]
fn odd_widths_that_the_cpu_takes_run_on_the_device_too() {
    let Some(gpu) = any_device() else { return };
    let mut pipelines = Pipelines::new(&gpu);
    let mut failures = Vec::new();
    for kind in CPU_KINDS {
        for seed in 0..8 {
            let case = nn_case(kind, seed);
            let (graph, weights) = (case.graph.clone(), case.weights.clone());
            let mut device = GpuExecutor::new(&gpu, &mut pipelines, graph, weights).expect("loads");
            let found = case.run(&mut device).expect("runs");
            failures.extend(case.difference(&found));
        }
    }
    assert!(
        failures.is_empty(),
        "{} cases differ:\n{}",
        failures.len(),
        failures.join("\n")
    );
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
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
    load(gpu, pipelines, &nn_cases(3, 1)[1]).expect("loads")
}

#[test]
fn weights_that_do_not_fit_are_refused() {
    let Some(gpu) = any_device() else { return };
    let case = nn_cases(4, 1)
        .into_iter()
        .find(|case| !case.graph.weights().is_empty())
        .expect("some case has weights");
    let made = load(
        &gpu,
        &mut Pipelines::new(&gpu),
        &NnCase {
            weights: landline::nn::Weights::new(),
            ..case
        },
    );
    assert!(matches!(made, Err(GpuError::Network(_))));
}

#[test]
fn no_adapter_and_an_adapter_below_the_guaranteed_limits_say_so() {
    let ask = |fault| {
        pollster::block_on(GpuDevice::request_with_fault(
            AdapterChoice::Any,
            Some(fault),
        ))
    };
    let none = ask(Fault::NoAdapter).expect_err("there is no adapter");
    assert!(matches!(none, GpuError::NoAdapter(_)), "{none}");
    if any_device().is_none() {
        return;
    }
    let low = ask(Fault::LowLimit).expect_err("the limit is too low");
    let expected = GpuError::LimitTooLow {
        limit: "maxComputeWorkgroupStorageSize",
        found: 8192,
        needed: 16384,
    };
    assert_eq!(low, expected);
}

fn tested(gpu: &Arc<GpuDevice>) -> Result<WeightStorage, GpuError> {
    pollster::block_on(self_test(gpu, &mut Pipelines::new(gpu), None))
}

#[test]
fn the_self_test_passes_here_with_matrices_in_16_bits() {
    let Some(gpu) = any_device() else { return };
    assert_eq!(tested(&gpu), Ok(WeightStorage::Exact));
}

#[test]
fn the_self_test_finds_a_device_that_reads_16_bits_wrongly_and_goes_on_with_32() {
    let Some(gpu) = any_device() else { return };
    gpu.simulate(Fault::WrongHalves);
    assert_eq!(tested(&gpu), Ok(WeightStorage::Single));
}

#[test]
fn the_self_test_refuses_a_device_that_computes_wrongly() {
    let Some(gpu) = any_device() else { return };
    gpu.simulate(Fault::WrongAnswer);
    let error = tested(&gpu).expect_err("a row is wrong");
    assert!(matches!(error, GpuError::SelfTest { .. }), "{error}");
}

#[test]
fn a_shader_that_the_driver_refuses_is_named() {
    let Some(gpu) = any_device() else { return };
    gpu.simulate(Fault::ShaderError);
    let error = tested(&gpu).expect_err("the shaders are broken");
    assert!(
        matches!(&error, GpuError::Refused { what, message } if what.contains("self-test") && message.contains("missing")),
        "{error}"
    );
    // It was caught where it was made, and is not held against the device itself.
    assert_eq!(gpu.check(), Ok(()));
}

#[test]
fn an_answer_that_does_not_come_is_given_up_and_the_next_one_is_read() {
    let Some(gpu) = any_device() else { return };
    let case = &nn_cases(3, 1)[1];
    let mut network = small(&gpu, &mut Pipelines::new(&gpu));
    let mut ask = |gpu: &GpuDevice, fault| {
        if let Some(fault) = fault {
            gpu.simulate(fault);
        } else {
            gpu.recover();
        }
        for (name, data) in &case.inputs {
            network.write_input(name, data).expect("has room");
        }
        for (name, count) in &case.counts {
            network.set_count(name, *count).expect("within capacity");
        }
        pollster::block_on(network.run(None))
    };
    let late = ask(&gpu, Some(Fault::LateMap)).expect_err("nothing arrives");
    assert!(
        matches!(late, GpuError::MapTimeout(ms) if ms >= MAP_DEADLINE_MS),
        "{late}"
    );
    let found = ask(&gpu, None).expect("the buffer is free again");
    assert_eq!(case.difference(&found), None);
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}

#[test]
fn a_lost_device_is_reported() {
    let Some(gpu) = any_device() else { return };
    let mut network = small(&gpu, &mut Pipelines::new(&gpu));
    gpu.simulate(Fault::Lost);
    assert!(matches!(
        pollster::block_on(network.run(None)),
        Err(GpuError::Lost(_))
    ));
}
