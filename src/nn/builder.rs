//! Builds a [`Graph`]: one method per operation, each checking that its tensors fit.
//!
//! Methods do not return errors one by one: the first problem is kept and [`GraphBuilder::finish`] reports it, so that a
//! network reads like its drawing. Sizes may come from a file; nothing here panics on them.

use super::{
    error::NnError,
    graph::{Count, Graph, Node, Port, WeightSpec},
    op::{Activation, AxisMap, CHOICE_STATISTICS, Filter, Op},
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

    /// Linear layer or 1x1 convolution. See [`Op::Linear`].
    pub fn linear(&mut self, x: Tensor, layer: Dense<'_>) -> Tensor {
        let groups = layer.groups.max(1);
        let fits = x.channels.is_multiple_of(groups)
            && layer.out.is_multiple_of(groups)
            && layer.stride == 1;
        let weight = self.weight(
            &format!("{}.w", layer.name),
            &[layer.out, x.channels / groups],
        );
        let bias = layer
            .bias
            .then(|| self.weight(&format!("{}.b", layer.name), &[layer.out]));
        let op = Op::Linear {
            weight,
            bias,
            groups,
            activation: layer.activation,
        };
        let y = self.value(x.rows, layer.out, x.grid);
        self.check(&op, fits, || {
            format!(
                "`{}`: {} input and {} output channels in {} groups with stride {}",
                layer.name, x.channels, layer.out, groups, layer.stride
            )
        });
        self.dense_node(op, x, y, &layer)
    }

    /// 3x3 convolution. See [`Op::Conv3x3`].
    pub fn conv3x3(&mut self, x: Tensor, layer: Dense<'_>) -> Tensor {
        let weight = self.weight(&format!("{}.w", layer.name), &[layer.out, x.channels, 3, 3]);
        let bias = layer
            .bias
            .then(|| self.weight(&format!("{}.b", layer.name), &[layer.out]));
        let op = Op::Conv3x3 {
            weight,
            bias,
            stride: layer.stride,
            activation: layer.activation,
        };
        let fits = x.grid.is_some() && layer.groups == 1 && matches!(layer.stride, 1 | 2);
        self.check(&op, fits, || {
            format!(
                "`{}` needs a picture, stride 1 or 2, and no groups; got grid {:?}, stride {}, {} groups",
                layer.name, x.grid, layer.stride, layer.groups
            )
        });
        let stride = layer.stride.clamp(1, 2);
        let grid = x.grid.unwrap_or(Grid {
            height: 1,
            width: 1,
        });
        let grid = Grid {
            height: grid.height.div_ceil(stride),
            width: grid.width.div_ceil(stride),
        };
        let y = self.grid_value(grid, layer.out);
        self.dense_node(op, x, y, &layer)
    }

    /// The activation alone. See [`Op::Activate`].
    pub fn activate(&mut self, x: Tensor, activation: Activation) -> Tensor {
        let y = self.value(x.rows, x.channels, x.grid);
        self.node(Op::Activate { activation }, &[x], y)
    }

    /// Sum. See [`Op::Add`].
    pub fn add(&mut self, a: Tensor, b: Tensor, activation: Activation) -> Tensor {
        let op = Op::Add { activation };
        self.check_same_size(&op, a, b);
        let y = self.value(a.rows, a.channels, a.grid);
        self.node(op, &[a, b], y)
    }

    /// Bilinear resize. See [`Op::Resize`].
    pub fn resize(&mut self, x: Tensor, height: usize, width: usize) -> Tensor {
        self.check(&Op::Resize, x.grid.is_some(), || {
            "input is not a picture".to_owned()
        });
        let y = self.grid_value(Grid { height, width }, x.channels);
        self.node(Op::Resize, &[x], y)
    }

    /// Bilinear resize of `x` to the size of `addend`, plus `addend`. See [`Op::Resize`].
    pub fn resize_add(&mut self, x: Tensor, addend: Tensor) -> Tensor {
        let fits = x.grid.is_some() && addend.grid.is_some() && x.channels == addend.channels;
        self.check(&Op::Resize, fits, || format!("inputs {x:?} and {addend:?}"));
        let y = self.grid_value(
            addend.grid.unwrap_or(Grid {
                height: 1,
                width: 1,
            }),
            x.channels,
        );
        self.node(Op::Resize, &[x, addend], y)
    }

    /// Mean of blocks. See [`Op::AvgPool`].
    pub fn avg_pool(&mut self, x: Tensor, size: usize) -> Tensor {
        let op = Op::AvgPool { size };
        let grid = self.pooled(&op, x, size, size, 0);
        let y = self.grid_value(grid, x.channels);
        self.node(op, &[x], y)
    }

    /// Maximum of windows. See [`Op::MaxPool`].
    pub fn max_pool(&mut self, x: Tensor, size: usize, stride: usize, pad: usize) -> Tensor {
        let op = Op::MaxPool { size, stride, pad };
        let grid = self.pooled(&op, x, size, stride, pad);
        let y = self.grid_value(grid, x.channels);
        self.node(op, &[x], y)
    }

    /// Normalisation over all rows. See [`Op::InstanceNorm`].
    pub fn instance_norm(&mut self, x: Tensor, eps: f32) -> Tensor {
        let y = self.value(x.rows, x.channels, x.grid);
        self.node(Op::InstanceNorm { eps }, &[x], y)
    }

    /// Space to depth. See [`Op::Unfold`].
    pub fn unfold(&mut self, x: Tensor, block: usize) -> Tensor {
        let op = Op::Unfold { block };
        let grid = x.grid.unwrap_or(Grid {
            height: 0,
            width: 0,
        });
        let fits = block > 0
            && grid.pixels() > 0
            && grid.height.is_multiple_of(block)
            && grid.width.is_multiple_of(block);
        self.check(&op, fits, || {
            format!("picture {:?} in cells of {block}", x.grid)
        });
        let block = block.max(1);
        let grid = Grid {
            height: grid.height / block,
            width: grid.width / block,
        };
        let y = self.grid_value(grid, x.channels.saturating_mul(block).saturating_mul(block));
        self.node(op, &[x], y)
    }

    /// Softmax, dustbin dropped, depth to space. See [`Op::DetectorHeat`].
    pub fn detector_heat(&mut self, x: Tensor, block: usize) -> Tensor {
        let op = Op::DetectorHeat { block };
        let fits = x.grid.is_some()
            && block
                .checked_mul(block)
                .is_some_and(|cell| cell > 0 && x.channels == cell + 1);
        self.check(&op, fits, || format!("input {x:?} with cells of {block}"));
        let grid = x.grid.unwrap_or(Grid {
            height: 1,
            width: 1,
        });
        let grid = Grid {
            height: grid.height.saturating_mul(block),
            width: grid.width.saturating_mul(block),
        };
        let y = self.grid_value(grid, 1);
        self.node(op, &[x], y)
    }

    /// Layer norm with weights `NAME.g` and `NAME.b`. See [`Op::LayerNorm`].
    pub fn layer_norm(&mut self, x: Tensor, name: &str, eps: f32) -> Tensor {
        let gain = self.weight(&format!("{name}.g"), &[x.channels]);
        let bias = self.weight(&format!("{name}.b"), &[x.channels]);
        let y = self.value(x.rows, x.channels, x.grid);
        self.node(Op::LayerNorm { gain, bias, eps }, &[x], y)
    }

    /// Unit rows. See [`Op::L2Norm`].
    pub fn l2_norm(&mut self, x: Tensor, eps: f32) -> Tensor {
        let y = self.value(x.rows, x.channels, x.grid);
        self.node(Op::L2Norm { eps }, &[x], y)
    }

    /// Multi-head attention; `keep` is the optional `[m, 1]` mask of the keys. See [`Op::Attention`].
    pub fn attention(
        &mut self,
        [q, k, v]: [Tensor; 3],
        heads: usize,
        scale: f32,
        keep: Option<Tensor>,
    ) -> Tensor {
        let op = Op::Attention {
            heads,
            scale,
            masked: keep.is_some(),
        };
        let fits = heads > 0
            && q.channels == k.channels
            && q.channels.is_multiple_of(heads)
            && v.channels.is_multiple_of(heads)
            && k.rows == v.rows
            && keep.is_none_or(|keep| keep.rows == k.rows && keep.channels == 1);
        self.check(&op, fits, || {
            format!("{heads} heads with q {q:?}, k {k:?}, v {v:?}, mask {keep:?}")
        });
        let y = self.value(q.rows, v.channels, q.grid);
        let inputs: Vec<Tensor> = [q, k, v].into_iter().chain(keep).collect();
        self.node(op, &inputs, y)
    }

    /// One-query attention over own tokens. See [`Op::TokenPool`].
    pub fn token_pool(&mut self, u: Tensor, tokens_of: Tensor, heads: usize, scale: f32) -> Tensor {
        let times = |all: usize, of: usize| {
            if of > 0 && all.is_multiple_of(of) {
                all / of
            } else {
                0
            }
        };
        let tokens = match (u.rows, tokens_of.rows) {
            (Rows::Counted { count: a, per: of }, Rows::Counted { count: b, per }) if a == b => {
                times(per, of)
            }
            (Rows::Fixed(of), Rows::Fixed(all)) => times(all, of),
            _ => 0,
        };
        let op = Op::TokenPool {
            heads,
            tokens,
            scale,
        };
        let fits =
            tokens > 0 && heads > 0 && heads.checked_mul(tokens_of.channels) == Some(u.channels);
        self.check(&op, fits, || {
            format!("{heads} heads with u {u:?}, tokens {tokens_of:?}")
        });
        let y = self.value(u.rows, u.channels, u.grid);
        self.node(op, &[u, tokens_of], y)
    }

    /// Reads a picture at positions `[n, 2]`. See [`Op::Sample`].
    pub fn sample(
        &mut self,
        picture: Tensor,
        positions: Tensor,
        filter: Filter,
        x: AxisMap,
        y: AxisMap,
    ) -> Tensor {
        let op = Op::Sample { filter, x, y };
        let fits = picture.grid.is_some() && positions.channels == 2;
        self.check(&op, fits, || {
            format!("picture {picture:?}, positions {positions:?}")
        });
        let out = self.value(positions.rows, picture.channels, positions.grid);
        self.node(op, &[picture, positions], out)
    }

    /// Soft choice among `anchors` with weights `NAME.keys` `[anchors, channels]`, `NAME.values` `[anchors, value_channels]`
    /// and `NAME.sharpness` `[1]`. Returns the chosen value and the statistics. See [`Op::SoftChoice`].
    pub fn soft_choice(
        &mut self,
        x: Tensor,
        name: &str,
        anchors: usize,
        value_channels: usize,
    ) -> [Tensor; 2] {
        let keys = self.weight(&format!("{name}.keys"), &[anchors, x.channels]);
        let values = self.weight(&format!("{name}.values"), &[anchors, value_channels]);
        let sharpness = self.weight(&format!("{name}.sharpness"), &[1]);
        let op = Op::SoftChoice {
            keys,
            values,
            sharpness,
        };
        self.check(&op, anchors > 0, || format!("`{name}` has no anchors"));
        let chosen = self.value(x.rows, value_channels, x.grid);
        let statistics = self.value(x.rows, CHOICE_STATISTICS, x.grid);
        self.push(op, vec![x], vec![chosen, statistics], name.to_owned());
        [chosen, statistics]
    }

    /// Keeps the rows of `x` whose logit is above `min_logit`; makes a new count called `count_name`. Returns the kept rows
    /// and the row number that each had. See [`Op::Keep`].
    pub fn keep(
        &mut self,
        x: Tensor,
        logit: Tensor,
        min_logit: f32,
        count_name: &str,
    ) -> [Tensor; 2] {
        let op = Op::Keep { min_logit };
        let capacity = x.rows.at(&self.graph.capacities());
        self.check(&op, x.rows == logit.rows && logit.channels == 1, || {
            format!("x {x:?}, logit {logit:?}")
        });
        let count = self.count(count_name, capacity);
        self.graph.counts[count.0].derived = true;
        let rows = Rows::Counted { count, per: 1 };
        let kept = self.value(rows, x.channels, None);
        let index = self.value(rows, 1, None);
        self.push(op, vec![x, logit], vec![kept, index], count_name.to_owned());
        [kept, index]
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

    fn dense_node(&mut self, op: Op, x: Tensor, y: Tensor, layer: &Dense<'_>) -> Tensor {
        let mut inputs = vec![x];
        if let Some(residual) = layer.residual {
            self.check_same_size(&op, residual, y);
            inputs.push(residual);
        }
        self.push(op, inputs, vec![y], layer.name.to_owned());
        y
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

    fn pooled(&mut self, op: &Op, x: Tensor, size: usize, stride: usize, pad: usize) -> Grid {
        let side = |length: usize| {
            if size == 0 || stride == 0 || pad >= size {
                return 0;
            }
            length
                .saturating_add(2 * pad)
                .checked_sub(size)
                .map_or(0, |room| room / stride + 1)
        };
        let grid = x.grid.map_or(
            Grid {
                height: 0,
                width: 0,
            },
            |grid| Grid {
                height: side(grid.height),
                width: side(grid.width),
            },
        );
        self.check(op, grid.height > 0 && grid.width > 0, || {
            format!(
                "picture {:?} with windows of {size}, step {stride}, border {pad}",
                x.grid
            )
        });
        grid
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

    fn check_same_size(&mut self, op: &Op, a: Tensor, b: Tensor) {
        self.check(op, a.rows == b.rows && a.channels == b.channels, || {
            format!(
                "sizes differ: {:?} x {} and {:?} x {}",
                a.rows, a.channels, b.rows, b.channels
            )
        });
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
