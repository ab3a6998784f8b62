//! A tiny network whose answer is known, run on the device before it is trusted: drivers have bugs.

use std::sync::Arc;

use half::f16;

use super::{
    device::GpuDevice, error::GpuError, executor::GpuNetwork, pipelines::Pipelines,
    readback::Timer, storage::WeightStorage,
};
use crate::{
    math::Rng,
    nn::{
        Activation, Dense, Executor, Graph, GraphBuilder, NnError, WeightTensor, Weights,
        oracle::OracleExecutor,
    },
};

/// Largest difference to the oracle, relative to the largest number of an output. A correct device stays a hundred times
/// below.
const TOLERANCE: f64 = 1e-3;

/// Side of the picture.
const SIDE: usize = 24;

/// A network that goes through the kernels which all scenes use.
fn network() -> Result<Graph, NnError> {
    let mut g = GraphBuilder::new("self-test");
    let gray = g.input_grid("gray", SIDE, SIDE, 1);
    let x = g.instance_norm(gray, 1e-5);
    let x = g.conv3x3(
        x,
        Dense::new("conv0", 8)
            .stride(2)
            .activation(Activation::Relu),
    );
    let x = g.conv3x3(x, Dense::new("conv1", 48).activation(Activation::Relu));
    let x = g.linear(
        x,
        Dense::new("linear", 48)
            .activation(Activation::Gelu)
            .residual(x),
    );
    let x = g.layer_norm(x, "norm", 1e-6);
    let (q, k, v) = (
        x.channel_range(0..16),
        x.channel_range(16..32),
        x.channel_range(32..48),
    );
    let x = g.attention([q, k, v], 2, 0.35, None);
    let unit = g.l2_norm(x, 1e-12);
    let [chosen, statistics] = g.soft_choice(unit, "anchor", 40, 3);
    g.output("chosen", chosen);
    g.output("statistics", statistics);
    g.finish()
}

fn weights(graph: &Graph, rng: &mut Rng) -> Result<Weights, NnError> {
    let mut weights = Weights::new();
    for spec in graph.weights() {
        let len = spec.shape.iter().product();
        let data = match spec.shape[..] {
            [1] => vec![6.0],
            // 16-bit numbers, so that matrices can be stored so without loss.
            _ => (0..len)
                .map(|_| f16::from_f64(rng.range(-0.4, 0.4)).to_f32())
                .collect(),
        };
        weights.insert(spec.name.clone(), WeightTensor::f32(&spec.shape, data)?);
    }
    Ok(weights)
}

/// Runs the network on the device and on the oracle, with matrices in 16 bits, and in 32 if that fails. Says which of the
/// two the device gets right.
///
/// # Errors
/// [`GpuError::SelfTest`] when it is wrong with both; any error of the device.
pub async fn self_test(
    gpu: &Arc<GpuDevice>,
    pipelines: &mut Pipelines,
    timer: Option<&Timer>,
) -> Result<WeightStorage, GpuError> {
    match compare(gpu, pipelines, timer, WeightStorage::Exact).await {
        Ok(()) => Ok(WeightStorage::Exact),
        Err(GpuError::SelfTest { .. } | GpuError::Refused { .. }) => {
            compare(gpu, pipelines, timer, WeightStorage::Single).await?;
            Ok(WeightStorage::Single)
        }
        Err(error) => Err(error),
    }
}

async fn compare(
    gpu: &Arc<GpuDevice>,
    pipelines: &mut Pipelines,
    timer: Option<&Timer>,
    storage: WeightStorage,
) -> Result<(), GpuError> {
    let graph = network()?;
    let mut rng = Rng::from_seed(7);
    let weights = weights(&graph, &mut rng)?;
    let gray: Vec<f32> = (0..SIDE * SIDE).map(|_| rng.uniform() as f32).collect();
    let mut oracle = OracleExecutor::new(graph.clone(), weights.clone())?;
    oracle.input("gray")?.copy_from_slice(&gray);
    oracle.run()?;
    let mut network = GpuNetwork::new(gpu, pipelines, graph, weights, storage).await?;
    network.write_input("gray", &gray)?;
    for (name, found) in network.run(timer).await? {
        let expected = oracle.output(&name)?;
        let scale = expected.iter().fold(f64::MIN_POSITIVE, |largest, &x| {
            largest.max(f64::from(x).abs())
        });
        let off = expected
            .iter()
            .zip(&found)
            .map(|(&e, &f)| (f64::from(e) - f64::from(f)).abs() / scale)
            // Unlike `f64::max` this keeps a NaN.
            .fold(0.0, |worst: f64, off| {
                if off > worst || off.is_nan() {
                    off
                } else {
                    worst
                }
            });
        if !(off <= TOLERANCE) {
            return Err(GpuError::SelfTest {
                what: name,
                found: off,
                allowed: TOLERANCE,
            });
        }
    }
    Ok(())
}
