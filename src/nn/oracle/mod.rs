//! The definition of every operation: scalar, one file per operation, accumulating in `f64`.
//!
//! Slow and simple on purpose. Every other executor is tested against this one.

mod attention;
mod conv3x3;
mod detector_heat;
mod elementwise;
mod keep;
mod linear;
mod norm;
mod pool;
mod resize;
mod sample;
mod soft_choice;
mod token_pool;
mod unfold;

use super::{
    error::NnError,
    executor::Executor,
    graph::{Graph, Node},
    op::Op,
    shape::{Grid, Tensor, WeightId},
    weights::Weights,
};

pub use elementwise::activate;

/// A tensor's numbers at the current counts.
#[derive(Debug, Clone, Copy)]
struct View<'a> {
    data: &'a [f32],
    rows: usize,
    channels: usize,
    row_stride: usize,
    grid: Grid,
}

impl View<'_> {
    fn row(&self, row: usize) -> &[f32] {
        &self.data[row * self.row_stride..][..self.channels]
    }

    /// A channel of a pixel; zero outside the picture.
    fn pixel(&self, y: isize, x: isize, channel: usize) -> f64 {
        match (usize::try_from(y), usize::try_from(x)) {
            (Ok(y), Ok(x)) if y < self.grid.height && x < self.grid.width => {
                f64::from(self.row(y * self.grid.width + x)[channel])
            }
            _ => 0.0,
        }
    }
}

/// Runs a graph with the reference operations. Allocates in every run.
#[derive(Debug, Clone)]
pub struct OracleExecutor {
    graph: Graph,
    weights: Vec<Vec<f32>>,
    values: Vec<Vec<f32>>,
    counts: Vec<usize>,
}

impl OracleExecutor {
    /// Takes the graph's weights out of `weights`.
    ///
    /// # Errors
    /// A weight that is missing, has another shape, or is not finite.
    pub fn new(graph: Graph, mut weights: Weights) -> Result<Self, NnError> {
        let weights = graph
            .weights()
            .iter()
            .map(|spec| weights.take_f32(&spec.name, &spec.shape))
            .collect::<Result<_, _>>()?;
        let values = graph
            .value_sizes()
            .iter()
            .map(|&size| vec![f32::NAN; size])
            .collect();
        let counts = graph.capacities();
        Ok(Self {
            graph,
            weights,
            values,
            counts,
        })
    }

    fn view(&self, tensor: &Tensor) -> View<'_> {
        View {
            data: &self.values[tensor.value.0][tensor.offset..],
            rows: tensor.rows.at(&self.counts),
            channels: tensor.channels,
            row_stride: tensor.row_stride,
            grid: tensor.grid.unwrap_or(Grid {
                height: 0,
                width: 0,
            }),
        }
    }

    fn weight(&self, id: WeightId) -> &[f32] {
        &self.weights[id.0]
    }

    /// The results of one operation and, for [`Op::Keep`], the number of rows kept.
    fn compute(&self, node: &Node) -> (Vec<Vec<f32>>, Option<usize>) {
        let x = self.view(&node.inputs[0]);
        let second = node.inputs.get(1).map(|tensor| self.view(tensor));
        let out_grid = node.outputs[0].grid.unwrap_or(Grid {
            height: 0,
            width: 0,
        });
        let bias = |id: &Option<WeightId>| id.map(|id| self.weight(id));
        let y = match &node.op {
            Op::Conv3x3 {
                weight,
                bias: b,
                stride,
                activation,
            } => conv3x3::conv3x3(
                x,
                self.weight(*weight),
                bias(b),
                second,
                *stride,
                out_grid,
                *activation,
            ),
            Op::Linear {
                weight,
                bias: b,
                groups,
                activation,
            } => linear::linear(
                x,
                self.weight(*weight),
                bias(b),
                second,
                *groups,
                node.outputs[0].channels,
                *activation,
            ),
            Op::Activate { activation } => elementwise::map(x, *activation),
            Op::Add { activation } => elementwise::add(x, self.view(&node.inputs[1]), *activation),
            Op::Resize => resize::resize(x, second, out_grid),
            Op::AvgPool { size } => pool::avg_pool(x, *size, out_grid),
            Op::MaxPool { size, stride, pad } => pool::max_pool(x, *size, *stride, *pad, out_grid),
            Op::InstanceNorm { eps } => norm::instance_norm(x, *eps),
            Op::Unfold { block } => unfold::unfold(x, *block),
            Op::DetectorHeat { block } => detector_heat::detector_heat(x, *block),
            Op::LayerNorm { gain, bias, eps } => {
                norm::layer_norm(x, self.weight(*gain), self.weight(*bias), *eps)
            }
            Op::L2Norm { eps } => norm::l2_norm(x, *eps),
            Op::Attention {
                heads,
                scale,
                masked,
            } => {
                let [k, v] = [self.view(&node.inputs[1]), self.view(&node.inputs[2])];
                let keep = masked.then(|| self.view(&node.inputs[3]));
                attention::attention(x, k, v, keep, *heads, *scale)
            }
            Op::TokenPool {
                heads,
                tokens,
                scale,
            } => token_pool::token_pool(x, self.view(&node.inputs[1]), *heads, *tokens, *scale),
            Op::Sample {
                filter,
                x: map_x,
                y: map_y,
            } => sample::sample(x, self.view(&node.inputs[1]), *filter, *map_x, *map_y),
            Op::SoftChoice {
                keys,
                values,
                sharpness,
            } => {
                let sharpness = self.weight(*sharpness)[0];
                let [chosen, statistics] = soft_choice::soft_choice(
                    x,
                    self.weight(*keys),
                    self.weight(*values),
                    node.outputs[0].channels,
                    sharpness,
                );
                return (vec![chosen, statistics], None);
            }
            Op::Keep { min_logit } => {
                let [kept, index] = keep::keep(x, self.view(&node.inputs[1]), *min_logit);
                let count = index.len();
                return (vec![kept, index], Some(count));
            }
        };
        (vec![y], None)
    }

    fn filled(&self, tensor: &Tensor) -> usize {
        tensor.rows.at(&self.counts) * tensor.channels
    }
}

impl Executor for OracleExecutor {
    fn graph(&self) -> &Graph {
        &self.graph
    }

    fn set_count(&mut self, name: &str, count: usize) -> Result<(), NnError> {
        self.graph.set_count(&mut self.counts, name, count)
    }

    fn count(&self, name: &str) -> Result<usize, NnError> {
        Ok(self.counts[self.graph.count(name)?.0])
    }

    fn input(&mut self, name: &str) -> Result<&mut [f32], NnError> {
        let tensor = self.graph.input(name)?;
        let filled = self.filled(&tensor);
        Ok(&mut self.values[tensor.value.0][..filled])
    }

    fn run(&mut self) -> Result<(), NnError> {
        for step in 0..self.graph.nodes.len() {
            let node = self.graph.nodes[step].clone();
            let (results, kept) = self.compute(&node);
            if let (Some(kept), super::Rows::Counted { count, .. }) = (kept, node.outputs[0].rows) {
                self.counts[count.0] = kept;
            }
            for (tensor, result) in node.outputs.iter().zip(results) {
                self.values[tensor.value.0][..result.len()].copy_from_slice(&result);
            }
        }
        Ok(())
    }

    fn output(&self, name: &str) -> Result<&[f32], NnError> {
        let tensor = self.graph.output(name)?;
        Ok(&self.values[tensor.value.0][..self.filled(&tensor)])
    }
}
