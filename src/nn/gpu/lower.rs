//! From an operation of a graph to the dispatches that compute it.

use super::{
    error::GpuError,
    fuse::{StemLayer, Unit},
    pipelines::Params,
    storage::WeightPlace,
};
use crate::nn::{
    Activation, Filter, Graph, Node, Op,
    plan::Plan,
    shape::{Grid, Rows, Tensor, WeightId},
};

/// Marks a row number that is the same in every run; see `wgsl/common.wgsl`.
const FIXED: usize = u32::MAX as usize;

/// Workgroups along one axis at most.
const MAX_GROUPS: usize = 65535;

/// Most tokens per element that `wgsl/token_pool.wgsl` has room for.
const MAX_TOKENS: usize = 64;

/// Widest head or descriptor: a thread keeps its query in registers, and beyond this they do not suffice anywhere.
const MAX_WIDTH: usize = 256;

/// Bytes of workgroup memory that WebGPU guarantees.
const WORKGROUP_BYTES: usize = 16384;

/// One kernel call.
#[derive(Debug, Clone)]
pub(super) struct Dispatch {
    pub(super) kernel: &'static str,
    /// WGSL constants put before the kernel.
    pub(super) constants: String,
    pub(super) params: Params,
    pub(super) groups: [usize; 3],
}

/// What lowering needs to know of a network: where activations and weights lie.
pub(super) struct Lowering<'a> {
    pub(super) graph: &'a Graph,
    pub(super) plan: &'a Plan,
    /// Where each weight lies in the weight buffer.
    pub(super) places: &'a [WeightPlace],
}

/// The number by which kernels know an activation.
fn code(activation: Activation) -> usize {
    activation as usize
}

/// `fn activate` of the kernels: one case for each activation, none by default.
pub(super) fn activate_wgsl() -> String {
    let cases = Activation::ALL.iter().map(|&activation| {
        let y = match activation {
            Activation::None => "x",
            Activation::Relu => "max(x, 0.0)",
            Activation::Gelu => "0.5 * x * (1.0 + erf_of(x * 0.70710678))",
            Activation::Sigmoid => "1.0 / (1.0 + exp(-x))",
        };
        format!("        case {}u: {{ return {y}; }}\n", code(activation))
    });
    let cases: String = cases.collect();
    // No code but these is ever written; a number that no activation gives would show as a failed comparison.
    format!(
        "fn activate(x: f32, kind: u32) -> f32 {{\n    switch kind {{\n{cases}        default: {{ return LOWEST; }}\n    }}\n}}\n"
    )
}

/// Rows of keys and values that fit into workgroup memory at once, with one more word for each.
fn tile(numbers_a_row: usize) -> usize {
    (WORKGROUP_BYTES / (4 * (numbers_a_row + 1))).clamp(1, 16)
}

/// Spreads workgroups over two axes, because one holds at most [`MAX_GROUPS`].
fn spread(total: usize) -> (usize, usize) {
    let total = total.max(1);
    let x = total.min(MAX_GROUPS);
    (x, total.div_ceil(x))
}

impl Lowering<'_> {
    fn offset(&self, tensor: &Tensor) -> usize {
        self.plan.offsets[tensor.value.0] + tensor.offset
    }

    fn weight(&self, id: WeightId) -> usize {
        self.places[id.0].word
    }

    /// The WGSL constant that says how a matrix is stored.
    fn is_half(&self, name: &str, id: WeightId) -> String {
        format!("const {name}: bool = {};\n", self.places[id.0].is_half)
    }

    fn most_rows(&self, tensor: &Tensor) -> usize {
        tensor.rows.at(&self.graph.capacities())
    }

    /// `{name}_offset` and `{name}_stride` of a tensor.
    fn place(&self, params: Params, name: &str, tensor: &Tensor) -> Params {
        params
            .u(&format!("{name}_offset"), self.offset(tensor))
            .u(&format!("{name}_stride"), tensor.row_stride)
    }

    /// The same for a tensor that may be missing, with `has_{name}`.
    fn place_optional(
        &self,
        params: Params,
        name: &str,
        flag: &str,
        tensor: Option<&Tensor>,
    ) -> Params {
        let params = params.u(flag, usize::from(tensor.is_some()));
        match tensor {
            Some(tensor) => self.place(params, name, tensor),
            None => params
                .u(&format!("{name}_offset"), 0)
                .u(&format!("{name}_stride"), 0),
        }
    }

    fn bias(&self, params: Params, bias: Option<WeightId>) -> Params {
        params
            .u("has_bias", usize::from(bias.is_some()))
            .u("bias_offset", bias.map_or(0, |id| self.weight(id)))
    }

    fn unsupported(&self, op: &'static str, problem: String) -> GpuError {
        GpuError::Unsupported {
            network: self.graph.name().to_owned(),
            op,
            problem,
        }
    }

    fn grid(&self, op: &'static str, tensor: &Tensor) -> Result<Grid, GpuError> {
        tensor
            .grid
            .ok_or_else(|| self.unsupported(op, "its picture has no size".to_owned()))
    }

    /// The width of a head or descriptor, if its kernel has room for it.
    fn width(&self, op: &'static str, width: usize) -> Result<usize, GpuError> {
        if !(1..=MAX_WIDTH).contains(&width) {
            let problem = format!("a width of {width}, at most {MAX_WIDTH}");
            return Err(self.unsupported(op, problem));
        }
        Ok(width)
    }

    /// The kernel calls of one operation or of several fused ones, in order.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] for sizes beyond a kernel's.
    pub(super) fn lower(&self, unit: &Unit) -> Result<Vec<Dispatch>, GpuError> {
        match unit {
            Unit::One(node) => self.lower_node(node),
            Unit::Stem {
                node,
                layers,
                hidden_channels,
            } => self.stem(node, layers, *hidden_channels),
        }
    }

    fn stem(
        &self,
        node: &Node,
        [a, b]: &[StemLayer; 2],
        hidden: usize,
    ) -> Result<Vec<Dispatch>, GpuError> {
        let (x, y) = (&node.inputs[0], &node.outputs[0]);
        let to = self.grid("stem", y)?;
        let params = self.place(self.place(Params::default(), "x", x), "y", y);
        let mut params = sizes(params, self.grid("stem", x)?, to)
            .u("hidden_channels", hidden)
            .u("columns", y.channels);
        for (name, layer) in [("a", a), ("b", b)] {
            params = params
                .u(&format!("{name}_offset"), self.weight(layer.weight))
                .u(&format!("{name}_bias"), self.weight(layer.bias))
                .u(&format!("{name}_post"), usize::from(layer.post.is_some()))
                .u(
                    &format!("{name}_post_scale"),
                    layer.post.map_or(0, |(scale, _)| self.weight(scale)),
                )
                .u(
                    &format!("{name}_post_bias"),
                    layer.post.map_or(0, |(_, bias)| self.weight(bias)),
                );
        }
        let groups = [to.width.div_ceil(4), to.height.div_ceil(4), 1];
        Ok(vec![Dispatch {
            kernel: "stem",
            constants: self.is_half("A_HALF", a.weight) + &self.is_half("B_HALF", b.weight),
            params,
            groups,
        }])
    }

    fn lower_node(&self, node: &Node) -> Result<Vec<Dispatch>, GpuError> {
        let name = node.op.name();
        let x = &node.inputs[0];
        let second = node.inputs.get(1);
        let y = &node.outputs[0];
        let one = |kernel, params, groups| {
            Ok(vec![Dispatch {
                kernel,
                constants: String::new(),
                params,
                groups,
            }])
        };
        // A kernel with one thread for each number of the output.
        let by_number = |kernel, params: Params| {
            let (gx, gy) = spread((self.most_rows(y) * y.channels).div_ceil(64));
            one(kernel, params.u("tiles_x", gx), [gx, gy, 1])
        };
        match &node.op {
            // One channel a group: no product, a factor for each number.
            Op::Linear {
                weight,
                bias,
                groups,
                activation,
            } if *groups == x.channels && *groups == y.channels => {
                let params = rows(Params::default(), "rows", y.rows);
                let params = self.place(self.place(params, "x", x), "y", y);
                let params = self.place_optional(params, "r", "has_residual", second);
                let params = self
                    .bias(params, *bias)
                    .u("w_offset", self.weight(*weight))
                    .u("channels", y.channels)
                    .u("activation", code(*activation));
                by_number("affine", params)
            }
            Op::Linear {
                weight,
                bias,
                groups,
                activation,
            } => {
                let params = rows(Params::default(), "rows", y.rows);
                let params = self.place(self.place(params, "x", x), "y", y);
                let params = self.place_optional(params, "r", "has_residual", second);
                let params = self.bias(params, *bias);
                let depth = x.channels / groups;
                Ok(vec![self.product(
                    "linear",
                    params,
                    (*weight, *groups, depth, code(*activation)),
                    y,
                )])
            }
            Op::Conv3x3 {
                weight,
                bias,
                stride,
                activation,
            } => {
                let (from, to) = (self.grid(name, x)?, self.grid(name, y)?);
                let params = self.place(self.place(Params::default(), "x", x), "y", y);
                let params = self.place_optional(params, "r", "has_residual", second);
                let params = self
                    .bias(sizes(params, from, to), *bias)
                    .u("in_channels", x.channels)
                    .u("stride", *stride);
                let activation = code(*activation);
                if x.channels > 4 {
                    let product = (*weight, 1, 9 * x.channels, activation);
                    return Ok(vec![self.product("conv3x3", params, product, y)]);
                }
                let (tiles_y, tiles_z) = spread(to.pixels().div_ceil(64));
                let params = params
                    .u("w_offset", self.weight(*weight))
                    .u("columns", y.channels)
                    .u("tiles_y", tiles_y)
                    .u("activation", activation);
                Ok(vec![Dispatch {
                    kernel: "conv3x3_small",
                    constants: self.is_half("W_HALF", *weight),
                    params,
                    groups: [y.channels.div_ceil(8), tiles_y, tiles_z],
                }])
            }
            Op::Activate { activation } | Op::Add { activation } => {
                let params = rows(Params::default(), "rows", y.rows);
                let params = self.place(self.place(params, "a", x), "y", y);
                let params = self.place_optional(params, "b", "has_b", second);
                by_number(
                    "map",
                    params
                        .u("channels", y.channels)
                        .u("activation", code(*activation)),
                )
            }
            Op::Resize => {
                let params = self.place(self.place(Params::default(), "x", x), "y", y);
                let params = self.place_optional(params, "r", "has_residual", second);
                let params = sizes(params, self.grid(name, x)?, self.grid(name, y)?);
                by_number("resize", params.u("channels", y.channels))
            }
            Op::AvgPool { size } => by_number("pool", self.pool(node, *size, *size, 0, false)?),
            Op::MaxPool { size, stride, pad } => {
                by_number("pool", self.pool(node, *size, *stride, *pad, true)?)
            }
            Op::InstanceNorm { eps } => {
                let params = self.place(
                    self.place(rows(Params::default(), "rows", x.rows), "x", x),
                    "y",
                    y,
                );
                one("instance_norm", params.f("eps", *eps), [x.channels, 1, 1])
            }
            Op::Unfold { block } => {
                let params = self.place(self.place(Params::default(), "x", x), "y", y);
                let params = sizes(params, self.grid(name, x)?, self.grid(name, y)?);
                let params = params
                    .u("in_channels", x.channels)
                    .u("channels", y.channels)
                    .u("block", *block);
                by_number("unfold", params)
            }
            Op::DetectorHeat { block } => {
                let from = self.grid(name, x)?;
                let params = self.place(self.place(Params::default(), "x", x), "y", y);
                let (gx, gy) = spread(from.pixels().div_ceil(64));
                let params = sizes(params, from, self.grid(name, y)?)
                    .u("block", *block)
                    .u("tiles_x", gx);
                one("detector_heat", params, [gx, gy, 1])
            }
            Op::LayerNorm { gain, bias, eps } => self.norm(node, Some((*gain, *bias)), *eps),
            Op::L2Norm { eps } => self.norm(node, None, *eps),
            Op::Attention {
                heads,
                scale,
                masked,
            } => {
                let (k, v) = (&node.inputs[1], &node.inputs[2]);
                let d = self.width(name, k.channels / heads)?;
                let e = self.width(name, v.channels / heads)?;
                let tile = tile(d.next_multiple_of(4) + e.next_multiple_of(4));
                let params = rows(rows(Params::default(), "rows", x.rows), "keys", k.rows);
                let params = self.place(self.place(params, "q", x), "k", k);
                let params = self.place(self.place(params, "v", v), "y", y);
                let params =
                    self.place_optional(params, "m", "masked", masked.then(|| &node.inputs[3]));
                let params = params
                    .u("keys_capacity", self.most_rows(k))
                    .f("scale", *scale);
                Ok(vec![Dispatch {
                    kernel: "attention",
                    constants: format!(
                        "const D: u32 = {d}u;\nconst E: u32 = {e}u;\nconst TILE: u32 = {tile}u;\n"
                    ),
                    params,
                    groups: [self.most_rows(x).div_ceil(64).max(1), *heads, 1],
                }])
            }
            Op::TokenPool {
                heads,
                tokens,
                scale,
            } => {
                if *tokens > MAX_TOKENS {
                    return Err(
                        self.unsupported(name, format!("{tokens} tokens, at most {MAX_TOKENS}"))
                    );
                }
                let t = &node.inputs[1];
                let params = self.place(rows(Params::default(), "rows", x.rows), "u", x);
                let params = self.place(self.place(params, "t", t), "y", y);
                let params = params
                    .u("channels", t.channels)
                    .u("tokens", *tokens)
                    .f("scale", *scale);
                one("token_pool", params, [self.most_rows(x).max(1), *heads, 1])
            }
            Op::Sample {
                filter,
                x: map_x,
                y: map_y,
            } => {
                let at = &node.inputs[1];
                let grid = self.grid(name, x)?;
                let params = self.place(rows(Params::default(), "rows", y.rows), "x", x);
                let params = self.place(self.place(params, "at", at), "y", y);
                let params = sizes(params, grid, grid)
                    .u("channels", y.channels)
                    .u("bicubic", usize::from(*filter == Filter::Bicubic))
                    .f("scale_x", map_x.scale)
                    .f("offset_x", map_x.offset)
                    .f("scale_y", map_y.scale)
                    .f("offset_y", map_y.offset);
                by_number("sample", params)
            }
            Op::SoftChoice {
                keys,
                values,
                sharpness,
            } => {
                let d = self.width(name, x.channels)?;
                let v = self.width(name, y.channels)?;
                let tile = tile(d.next_multiple_of(4) + v);
                let shape = &self.graph.weight(*keys).shape;
                let params = self.place(rows(Params::default(), "rows", x.rows), "x", x);
                let params = self.place(self.place(params, "y", y), "s", &node.outputs[1]);
                let params = params
                    .u("keys_offset", self.weight(*keys))
                    .u("values_offset", self.weight(*values))
                    .u("sharpness_offset", self.weight(*sharpness))
                    .u("anchors", shape.first().copied().unwrap_or(0));
                Ok(vec![Dispatch {
                    kernel: "soft_choice",
                    constants: format!(
                        "const D: u32 = {d}u;\nconst V: u32 = {v}u;\nconst TILE: u32 = {tile}u;\n"
                    ) + &self.is_half("KEYS_HALF", *keys)
                        + &self.is_half("VALUES_HALF", *values),
                    params,
                    groups: [self.most_rows(x).div_ceil(64).max(1), 1, 1],
                }])
            }
            Op::Keep { min_logit } => self.keep(node, *min_logit),
        }
    }

    /// A product of rows with a matrix; `params` say where its operands lie.
    fn product(
        &self,
        kernel: &'static str,
        params: Params,
        (weight, groups, depth, activation): (WeightId, usize, usize, usize),
        y: &Tensor,
    ) -> Dispatch {
        let columns = y.channels / groups;
        let tiles = self.most_rows(y).div_ceil(32).max(1);
        let tiles_y = tiles.min(MAX_GROUPS);
        let params = params
            .u("w_offset", self.weight(weight))
            .u("groups", groups)
            .u("depth", depth)
            .u("columns", columns)
            .u("tiles_y", tiles_y)
            .u("activation", activation);
        Dispatch {
            kernel,
            constants: self.is_half("W_HALF", weight),
            params,
            groups: [
                columns.div_ceil(32),
                tiles_y,
                groups * tiles.div_ceil(tiles_y),
            ],
        }
    }

    fn pool(
        &self,
        node: &Node,
        size: usize,
        stride: usize,
        pad: usize,
        maximum: bool,
    ) -> Result<Params, GpuError> {
        let name = node.op.name();
        let (x, y) = (&node.inputs[0], &node.outputs[0]);
        let params = self.place(self.place(Params::default(), "x", x), "y", y);
        Ok(sizes(params, self.grid(name, x)?, self.grid(name, y)?)
            .u("channels", y.channels)
            .u("size", size)
            .u("stride", stride)
            .u("pad", pad)
            .u("maximum", usize::from(maximum)))
    }

    fn norm(
        &self,
        node: &Node,
        affine: Option<(WeightId, WeightId)>,
        eps: f32,
    ) -> Result<Vec<Dispatch>, GpuError> {
        let (x, y) = (&node.inputs[0], &node.outputs[0]);
        let (gx, gy) = spread(self.most_rows(x));
        let params = self.place(
            self.place(rows(Params::default(), "rows", x.rows), "x", x),
            "y",
            y,
        );
        let params = params
            .u("channels", x.channels)
            .u("tiles_x", gx)
            .u("centred", usize::from(affine.is_some()))
            .u(
                "gain_offset",
                affine.map_or(0, |(gain, _)| self.weight(gain)),
            )
            .u(
                "bias_offset",
                affine.map_or(0, |(_, bias)| self.weight(bias)),
            )
            .f("eps", eps);
        Ok(vec![Dispatch {
            kernel: "norm",
            constants: String::new(),
            params,
            groups: [gx, gy, 1],
        }])
    }

    fn keep(&self, node: &Node, min_logit: f32) -> Result<Vec<Dispatch>, GpuError> {
        let (x, logit) = (&node.inputs[0], &node.inputs[1]);
        let (kept, index) = (&node.outputs[0], &node.outputs[1]);
        let Rows::Counted { count, .. } = kept.rows else {
            return Err(self.unsupported(
                node.op.name(),
                "its output has a fixed number of rows".to_owned(),
            ));
        };
        let scan = self.place(rows(Params::default(), "rows", x.rows), "l", logit);
        let scan = self
            .place(scan, "i", index)
            .u("rows_capacity", self.most_rows(x))
            .u("kept_count", count.0)
            .f("min_logit", min_logit);
        let gather = self.place(
            self.place(self.place(Params::default(), "x", x), "y", kept),
            "i",
            index,
        );
        let (gx, gy) = spread((self.most_rows(x) * x.channels).div_ceil(64));
        let gather = gather
            .u("channels", x.channels)
            .u("kept_count", count.0)
            .u("tiles_x", gx);
        Ok(vec![
            Dispatch {
                kernel: "keep_scan",
                constants: String::new(),
                params: scan,
                groups: [1, 1, 1],
            },
            Dispatch {
                kernel: "keep_gather",
                constants: String::new(),
                params: gather,
                groups: [gx, gy, 1],
            },
        ])
    }
}

/// `{name}_count` and `{name}_per` of a number of rows.
fn rows(params: Params, name: &str, rows: Rows) -> Params {
    let (count, per) = match rows {
        Rows::Fixed(rows) => (FIXED, rows),
        Rows::Counted { count, per } => (count.0, per),
    };
    params
        .u(&format!("{name}_count"), count)
        .u(&format!("{name}_per"), per)
}

/// Sizes of the picture read and the one written.
fn sizes(params: Params, from: Grid, to: Grid) -> Params {
    params
        .u("in_width", from.width)
        .u("in_height", from.height)
        .u("out_width", to.width)
        .u("out_height", to.height)
}
