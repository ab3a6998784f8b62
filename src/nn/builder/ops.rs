//! One method per operation.

use super::{Dense, GraphBuilder};
use crate::nn::{
    op::{Activation, AxisMap, CHOICE_STATISTICS, Filter, Op},
    shape::{Grid, Rows, Tensor},
};

impl GraphBuilder {
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

    fn dense_node(&mut self, op: Op, x: Tensor, y: Tensor, layer: &Dense<'_>) -> Tensor {
        let mut inputs = vec![x];
        if let Some(residual) = layer.residual {
            self.check_same_size(&op, residual, y);
            inputs.push(residual);
        }
        self.push(op, inputs, vec![y], layer.name.to_owned());
        y
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

    fn check_same_size(&mut self, op: &Op, a: Tensor, b: Tensor) {
        self.check(op, a.rows == b.rows && a.channels == b.channels, || {
            format!(
                "sizes differ: {:?} x {} and {:?} x {}",
                a.rows, a.channels, b.rows, b.channels
            )
        });
    }
}
