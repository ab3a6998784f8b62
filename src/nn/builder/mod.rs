//! Builds a [`Graph`]: one method per operation, each checking that its tensors fit.
//!
//! Methods do not return errors one by one: the first problem is kept and [`GraphBuilder::finish`] reports it, so that a
//! network reads like its drawing. Sizes may come from a file; nothing here panics on them.

mod ops;

use super::{
    error::NnError,
    graph::{Count, Graph, Node, Port, WeightSpec},
    op::{Activation, Op},
    shape::{CountId, Grid, Rows, Tensor, ValueId, WeightId},
};

/// Most numbers in one value: 1 GB of `f32`. More is a mistake or an attack.
const MAX_VALUE_SIZE: usize = 1 << 28;

/// Description of a linear layer or convolution: the weights are `NAME.w` and `NAME.b`.
#[derive(Debug, Clone)]
pub struct Dense<'a> {
    name: &'a str,
    out: usize,
    bias: bool,
    activation: Activation,
    residual: Option<Tensor>,
    groups: usize,
    stride: usize,
}

impl<'a> Dense<'a> {
    /// A layer with bias, without activation, with `out` output channels.
    pub fn new(name: &'a str, out: usize) -> Self {
        Self {
            name,
            out,
            bias: true,
            activation: Activation::None,
            residual: None,
            groups: 1,
            stride: 1,
        }
    }

    /// Leaves the bias out.
    pub fn without_bias(mut self) -> Self {
        self.bias = false;
        self
    }

    /// Applies a function to the sum of product, bias and residual.
    pub fn activation(mut self, activation: Activation) -> Self {
        self.activation = activation;
        self
    }

    /// Adds a tensor of the output's size before the activation.
    pub fn residual(mut self, residual: Tensor) -> Self {
        self.residual = Some(residual);
        self
    }

    /// Blocks of channels that do not see each other (linear layers only).
    pub fn groups(mut self, groups: usize) -> Self {
        self.groups = groups;
        self
    }

    /// Step over the picture, 1 or 2 (convolutions only).
    pub fn stride(mut self, stride: usize) -> Self {
        self.stride = stride;
        self
    }
}

/// See the [module](self).
#[derive(Debug)]
pub struct GraphBuilder {
    graph: Graph,
    problem: Option<NnError>,
}

impl GraphBuilder {
    /// An empty graph. The name is for messages.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            graph: Graph {
                name: name.into(),
                counts: Vec::new(),
                weights: Vec::new(),
                value_sizes: Vec::new(),
                inputs: Vec::new(),
                nodes: Vec::new(),
                outputs: Vec::new(),
            },
            problem: None,
        }
    }

    /// Adds a run-time number of rows with room for `capacity`.
    pub fn count(&mut self, name: &str, capacity: usize) -> CountId {
        if capacity == 0 || self.graph.counts.iter().any(|count| count.name == name) {
            self.fail_graph(format!(
                "count `{name}` exists already or has capacity {capacity}"
            ));
        }
        self.graph.counts.push(Count {
            name: name.to_owned(),
            capacity: capacity.max(1),
            derived: false,
        });
        CountId(self.graph.counts.len() - 1)
    }

    /// Adds an input picture.
    pub fn input_grid(
        &mut self,
        name: &str,
        height: usize,
        width: usize,
        channels: usize,
    ) -> Tensor {
        let grid = Grid { height, width };
        let rows = Rows::Fixed(height.saturating_mul(width));
        self.input(name, rows, channels, Some(grid))
    }

    /// Adds an input of one row per element of a count.
    pub fn input_rows(&mut self, name: &str, count: CountId, channels: usize) -> Tensor {
        self.input(name, Rows::Counted { count, per: 1 }, channels, None)
    }

    /// Adds an input of `per` rows per element of a count, such as the tokens of a segment.
    pub fn input_tokens(
        &mut self,
        name: &str,
        count: CountId,
        per: usize,
        channels: usize,
    ) -> Tensor {
        self.input(name, Rows::Counted { count, per }, channels, None)
    }

    /// Adds an input.
    pub fn input(&mut self, name: &str, rows: Rows, channels: usize, grid: Option<Grid>) -> Tensor {
        if self.graph.inputs.iter().any(|port| port.name == name) {
            self.fail_graph(format!("two inputs are called `{name}`"));
        }
        let tensor = self.value(rows, channels, grid);
        self.graph.inputs.push(Port {
            name: name.to_owned(),
            tensor,
        });
        tensor
    }

    /// Names a result. It has to be a whole value (not a window, not an input).
    pub fn output(&mut self, name: &str, tensor: Tensor) {
        let whole = self
            .graph
            .nodes
            .iter()
            .any(|node| node.outputs.contains(&tensor));
        if !whole || self.graph.outputs.iter().any(|port| port.name == name) {
            self.fail_graph(format!(
                "output `{name}` exists already or is not the whole result of an operation"
            ));
        }
        self.graph.outputs.push(Port {
            name: name.to_owned(),
            tensor,
        });
    }

    /// Joins neighbouring rows without moving anything. See [`Tensor::join_rows`].
    pub fn join_rows(&mut self, x: Tensor, times: usize) -> Tensor {
        x.join_rows(times).unwrap_or_else(|| {
            self.fail_graph(format!("rows of {x:?} cannot be joined {times} at a time"));
            x
        })
    }

    /// The finished graph.
    ///
    /// # Errors
    /// The first problem met while building.
    pub fn finish(self) -> Result<Graph, NnError> {
        match self.problem {
            Some(problem) => Err(problem),
            None if self.graph.outputs.is_empty() => Err(NnError::BadGraph {
                graph: self.graph.name,
                problem: "it has no output".to_owned(),
            }),
            None => Ok(self.graph),
        }
    }

    fn node(&mut self, op: Op, inputs: &[Tensor], output: Tensor) -> Tensor {
        let label = op.name().to_owned();
        self.push(op, inputs.to_vec(), vec![output], label);
        output
    }

    fn push(&mut self, op: Op, inputs: Vec<Tensor>, outputs: Vec<Tensor>, label: String) {
        for tensor in &inputs {
            let known = tensor.value.0 < self.graph.value_sizes.len();
            self.check(&op, known, || {
                format!("{tensor:?} belongs to another graph")
            });
        }
        self.graph.nodes.push(Node {
            op,
            inputs,
            outputs,
            label,
        });
    }

    fn grid_value(&mut self, grid: Grid, channels: usize) -> Tensor {
        self.value(
            Rows::Fixed(grid.height.saturating_mul(grid.width)),
            channels,
            Some(grid),
        )
    }

    fn value(&mut self, rows: Rows, channels: usize, grid: Option<Grid>) -> Tensor {
        let capacities = self.graph.capacities();
        let known = match rows {
            Rows::Fixed(_) => true,
            Rows::Counted { count, .. } => count.0 < capacities.len(),
        };
        let size = if known {
            match rows {
                Rows::Fixed(rows) => rows.checked_mul(channels),
                Rows::Counted { count, per } => capacities[count.0]
                    .checked_mul(per)
                    .and_then(|rows| rows.checked_mul(channels)),
            }
        } else {
            None
        };
        let size = size.filter(|&size| size > 0 && size <= MAX_VALUE_SIZE).unwrap_or_else(|| {
            self.fail_graph(format!(
                "a tensor of {rows:?} and {channels} channels is empty or has more than {MAX_VALUE_SIZE} numbers"
            ));
            0
        });
        self.graph.value_sizes.push(size);
        let value = ValueId(self.graph.value_sizes.len() - 1);
        Tensor {
            value,
            rows,
            channels,
            offset: 0,
            row_stride: channels,
            grid,
        }
    }

    fn weight(&mut self, name: &str, shape: &[usize]) -> WeightId {
        if let Some(id) = self.graph.weights.iter().position(|spec| spec.name == name) {
            if self.graph.weights[id].shape != shape {
                let known = self.graph.weights[id].shape.clone();
                self.fail_graph(format!(
                    "weight `{name}` is used as {known:?} and as {shape:?}"
                ));
            }
            return WeightId(id);
        }
        let size = shape
            .iter()
            .try_fold(1_usize, |product, &n| product.checked_mul(n));
        if size.is_none_or(|size| size == 0 || size > MAX_VALUE_SIZE) {
            self.fail_graph(format!(
                "weight `{name}` of shape {shape:?} is empty or too large"
            ));
        }
        self.graph.weights.push(WeightSpec {
            name: name.to_owned(),
            shape: shape.to_vec(),
        });
        WeightId(self.graph.weights.len() - 1)
    }

    fn check(&mut self, op: &Op, fits: bool, problem: impl FnOnce() -> String) {
        if !fits && self.problem.is_none() {
            self.problem = Some(NnError::BadNode {
                graph: self.graph.name.clone(),
                node: self.graph.nodes.len(),
                op: op.name(),
                problem: problem(),
            });
        }
    }

    fn fail_graph(&mut self, problem: String) {
        if self.problem.is_none() {
            self.problem = Some(NnError::BadGraph {
                graph: self.graph.name.clone(),
                problem,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_the_first_problem() {
        let mut g = GraphBuilder::new("bad");
        let x = g.input_grid("image", 4, 4, 3);
        let y = g.conv3x3(x, Dense::new("c", 8).stride(3));
        let n = g.count("n", 5);
        let rows = g.input_rows("rows", n, 3);
        let z = g.add(y, rows, Activation::None);
        g.output("z", z);
        assert!(matches!(
            g.finish(),
            Err(NnError::BadNode {
                node: 0,
                op: "conv3x3",
                ..
            })
        ));
    }

    #[test]
    fn refuses_sizes_that_cannot_be() {
        for (rows, channels) in [(usize::MAX, 2), (0, 3), (3, 0), (1 << 20, 1 << 20)] {
            let mut g = GraphBuilder::new("huge");
            let x = g.input("x", Rows::Fixed(rows), channels, None);
            let y = g.activate(x, Activation::Relu);
            g.output("y", y);
            assert!(
                matches!(g.finish(), Err(NnError::BadGraph { .. })),
                "{rows} x {channels}"
            );
        }
        let mut g = GraphBuilder::new("weights");
        let x = g.input("x", Rows::Fixed(2), 4, None);
        let y = g.linear(x, Dense::new("a", usize::MAX / 2));
        g.output("y", y);
        assert!(g.finish().is_err());
    }

    #[test]
    fn one_weight_name_has_one_shape() {
        let mut g = GraphBuilder::new("shared");
        let x = g.input("x", Rows::Fixed(2), 4, None);
        let y = g.linear(x, Dense::new("a", 4));
        let z = g.linear(y, Dense::new("a", 4));
        g.output("z", z);
        let graph = g.finish().expect("the same layer twice is allowed");
        assert_eq!(graph.weights().len(), 2);
        assert_eq!(graph.macs(&[]), 2 * 2 * 16);
        let mut g = GraphBuilder::new("shared");
        let x = g.input("x", Rows::Fixed(2), 4, None);
        let y = g.linear(x, Dense::new("a", 5));
        let z = g.linear(y, Dense::new("a", 4));
        g.output("z", z);
        assert!(g.finish().is_err());
    }
}
