//! A network on the device behind the interface of the CPU's executors, for native callers, whose driver blocks.

use std::{
    future::Future,
    pin::pin,
    sync::Arc,
    task::{Context, Poll, Waker},
};

use super::{
    device::GpuDevice,
    error::GpuError,
    executor::{GpuNetwork, Outputs},
    pipelines::Pipelines,
    storage::WeightStorage,
};
use crate::nn::{Executor, Graph, NnError, Rows, Weights};

/// Runs one graph on a device and waits.
#[derive(Debug)]
pub struct GpuExecutor {
    network: GpuNetwork,
    counts: Vec<usize>,
    inputs: Vec<(String, Vec<f32>)>,
    outputs: Outputs,
}

/// The result of a future that is ready at once, as all of this module's are natively.
fn now<T>(future: impl Future<Output = Result<T, GpuError>>) -> Result<T, GpuError> {
    let mut context = Context::from_waker(Waker::noop());
    match pin!(future).poll(&mut context) {
        Poll::Ready(result) => result,
        Poll::Pending => Err(GpuError::MapFailed("the driver did not block".to_owned())),
    }
}

impl GpuExecutor {
    /// Loads a graph.
    ///
    /// # Errors
    /// As for [`GpuNetwork::new`].
    pub fn new(
        gpu: &Arc<GpuDevice>,
        pipelines: &mut Pipelines,
        graph: Graph,
        weights: Weights,
    ) -> Result<Self, GpuError> {
        let counts = graph.capacities();
        let storage = WeightStorage::Exact;
        Ok(Self {
            network: now(GpuNetwork::new(gpu, pipelines, graph, weights, storage))?,
            counts,
            inputs: Vec::new(),
            outputs: Outputs::new(),
        })
    }
}

impl Executor for GpuExecutor {
    fn graph(&self) -> &Graph {
        self.network.graph()
    }

    fn set_count(&mut self, name: &str, count: usize) -> Result<(), NnError> {
        self.network
            .graph()
            .set_count(&mut self.counts, name, count)?;
        self.network.set_count(name, count).map_err(in_words)
    }

    fn count(&self, name: &str) -> Result<usize, NnError> {
        let graph = self.graph();
        let id = graph.count(name)?;
        if !graph.counts()[id.0].derived {
            return Ok(self.counts[id.0]);
        }
        // What the network counted shows in the outputs that have so many rows.
        let shown = graph
            .outputs()
            .iter()
            .find_map(|port| match port.tensor.rows {
                Rows::Counted { count, per } if count == id => {
                    let (_, data) = self.outputs.iter().find(|(name, _)| *name == port.name)?;
                    Some(data.len() / (per * port.tensor.channels).max(1))
                }
                _ => None,
            });
        Ok(shown.unwrap_or(self.counts[id.0]))
    }

    fn input(&mut self, name: &str) -> Result<&mut [f32], NnError> {
        let tensor = self.graph().input(name)?;
        let len = tensor.rows.at(&self.counts) * tensor.channels;
        let found = self.inputs.iter().position(|(other, _)| other == name);
        let at = found.unwrap_or_else(|| {
            self.inputs.push((name.to_owned(), Vec::new()));
            self.inputs.len() - 1
        });
        let room = &mut self.inputs[at].1;
        room.resize(len, 0.0);
        Ok(room)
    }

    fn run(&mut self) -> Result<(), NnError> {
        for (name, data) in &self.inputs {
            self.network.write_input(name, data).map_err(in_words)?;
        }
        self.outputs = now(self.network.run(None)).map_err(in_words)?;
        Ok(())
    }

    fn output(&self, name: &str) -> Result<&[f32], NnError> {
        self.graph().output(name)?;
        let found = self.outputs.iter().find(|(other, _)| other == name);
        Ok(found.map_or(&[], |(_, data)| data))
    }
}

fn in_words(error: GpuError) -> NnError {
    match error {
        GpuError::Network(error) => error,
        other => NnError::Device(other.to_string()),
    }
}
