//! The executor to use on the CPU: packed weights, one arena, SIMD kernels.
//!
//! * **In and out**: as every [`Executor`].
//! * **Method**: weights are packed once for the tiles of the machine's instruction set ([`Level`]); activations live in
//!   one arena at the places of a [`Plan`]; bias, residual and ReLU are applied while a tile is in registers.
//! * **Invariants**: results do not depend on the capacities, nor on the number of threads; a run allocates nothing. Levels
//!   agree with the reference ([`super::oracle`]) to rounding; [`Level::Portable`] gives the same bits on every target.
//!   With the feature `parallel` large operations are split over the threads of the `rayon` pool that the call comes from.
//! * **Cost**: [`CpuExecutor::memory`] gives the bytes held.

mod kernels;
mod mutual;
mod prepare;
mod split;

use std::ops::Range;

use kernels::{
    arena::Arena,
    attention::{self, Attention, TokenPool},
    conv3x3::{self, Convolution},
    elementwise::{self, Picture, Sampling, Windows},
    gemm::{self, Packed, Product},
    norm,
    soft_choice::{self, SoftChoice},
    winograd,
};

pub use crate::simd::Level;
pub use mutual::{MutualNearest, MutualPair};

use prepare::{grid_of, is_winograd, last_weight_uses, pack, scratch_len};

use super::{
    error::NnError,
    executor::Executor,
    graph::Graph,
    op::{Activation, Op},
    plan::Plan,
    shape::{Rows, Tensor, WeightId},
    weights::Weights,
};

/// What an operation needs of its weights.
#[derive(Debug, Clone)]
enum Prepared {
    /// Nothing.
    None,
    /// One matrix per group: index of the first one, and how many.
    Matrices(Range<usize>),
    /// Gain and bias.
    Norm(Vec<f32>, Vec<f32>),
    /// Keys, values by channel, and sharpness.
    Anchors(Box<Packed>, Vec<f32>, f32),
}

/// Bytes that an executor holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    /// Packed weights.
    pub weights: usize,
    /// Activations.
    pub arena: usize,
    /// Working room of the kernels.
    pub scratch: usize,
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct CpuExecutor {
    graph: Graph,
    level: Level,
    plan: Plan,
    arena: Arena,
    prepared: Vec<Prepared>,
    matrices: Vec<Packed>,
    counts: Vec<usize>,
    threads: usize,
    /// For each thread the room that the hungriest operation needs.
    scratch: Vec<f32>,
}

/// Weight, bias, groups, whether it is for Winograd's tiles, and the matrices that it became.
type PackedWeight = (WeightId, Option<WeightId>, usize, bool, Range<usize>);

impl CpuExecutor {
    /// An executor for the best instruction set of this machine. Takes the weights out of `weights` one by one and frees
    /// them when packed.
    ///
    /// # Errors
    /// A weight that is missing, has another shape, or is not finite.
    pub fn new(graph: Graph, weights: Weights) -> Result<Self, NnError> {
        Self::with_level(graph, weights, Level::best())
    }

    /// An executor for one of [`Level::available`].
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_level(graph: Graph, mut weights: Weights, level: Level) -> Result<Self, NnError> {
        let mut matrices = Vec::new();
        // Operations that share a weight share its packed form.
        let mut packed: Vec<PackedWeight> = Vec::new();
        let mut taken: Vec<Option<Vec<f32>>> = vec![None; graph.weights().len()];
        let last_use = last_weight_uses(&graph);
        let mut prepared = Vec::with_capacity(graph.nodes().len());
        for (step, node) in graph.nodes().iter().enumerate() {
            for id in node.op.weights() {
                if taken[id.0].is_none() {
                    let spec = graph.weight(id);
                    taken[id.0] = Some(weights.take_f32(&spec.name, &spec.shape)?);
                }
            }
            let numbers = |id: WeightId| taken[id.0].as_deref().unwrap_or(&[]);
            let entry = match &node.op {
                Op::Conv3x3 { weight, bias, .. } | Op::Linear { weight, bias, .. } => {
                    let groups = if let Op::Linear { groups, .. } = node.op {
                        groups
                    } else {
                        1
                    };
                    let tiled = is_winograd(level, node);
                    let found = packed
                        .iter()
                        .find(|(w, b, g, t, _)| (w, b, *g, *t) == (weight, bias, groups, tiled));
                    let range = if let Some((.., range)) = found {
                        range.clone()
                    } else {
                        let first = matrices.len();
                        let shape = &graph.weight(*weight).shape;
                        let bias_numbers = bias.map(&numbers);
                        let from = numbers(*weight);
                        if tiled {
                            let [out, inner] = [shape[0], shape[1]];
                            matrices.push(winograd::pack(level, inner, out, bias_numbers, from));
                        } else {
                            pack(level, shape, from, bias_numbers, groups, &mut matrices);
                        }
                        let range = first..matrices.len();
                        packed.push((*weight, *bias, groups, tiled, range.clone()));
                        range
                    };
                    Prepared::Matrices(range)
                }
                Op::LayerNorm { gain, bias, .. } => {
                    Prepared::Norm(numbers(*gain).to_vec(), numbers(*bias).to_vec())
                }
                Op::SoftChoice {
                    keys,
                    values,
                    sharpness,
                } => {
                    let [anchors, channels] =
                        [graph.weight(*keys).shape[0], graph.weight(*keys).shape[1]];
                    let key_numbers = numbers(*keys);
                    let matrix = Packed::new(level, channels, anchors, None, |k, n| {
                        key_numbers[n * channels + k]
                    });
                    let width = graph.weight(*values).shape[1];
                    let mut by_channel = vec![0.0; width * soft_choice::padded(anchors)];
                    for (anchor, value) in numbers(*values).chunks_exact(width).enumerate() {
                        for (channel, &number) in value.iter().enumerate() {
                            by_channel[channel * soft_choice::padded(anchors) + anchor] = number;
                        }
                    }
                    let sharpness = numbers(*sharpness).first().copied().unwrap_or(1.0);
                    Prepared::Anchors(Box::new(matrix), by_channel, sharpness)
                }
                Op::Activate { .. }
                | Op::Add { .. }
                | Op::Resize
                | Op::AvgPool { .. }
                | Op::MaxPool { .. }
                | Op::InstanceNorm { .. }
                | Op::Unfold { .. }
                | Op::DetectorHeat { .. }
                | Op::L2Norm { .. }
                | Op::Attention { .. }
                | Op::TokenPool { .. }
                | Op::Sample { .. }
                | Op::Keep { .. } => Prepared::None,
            };
            prepared.push(entry);
            for id in node.op.weights() {
                if last_use[id.0] == step {
                    taken[id.0] = None;
                }
            }
        }
        let plan = Plan::new(&graph);
        let arena = Arena::new(plan.arena_len);
        let counts = graph.capacities();
        let scratch = graph
            .nodes()
            .iter()
            .map(|node| scratch_len(level, &graph, node, &counts))
            .max()
            .unwrap_or(0);
        let threads = split::threads();
        Ok(Self {
            graph,
            level,
            plan,
            arena,
            prepared,
            matrices,
            counts,
            threads,
            scratch: vec![0.0; scratch * threads],
        })
    }

    /// The instruction set in use.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Where the values lie.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Bytes held.
    pub fn memory(&self) -> Memory {
        let matrices: usize = self.matrices.iter().map(Packed::bytes).sum();
        let others: usize = self
            .prepared
            .iter()
            .map(|prepared| match prepared {
                Prepared::None | Prepared::Matrices(_) => 0,
                Prepared::Norm(gain, bias) => (gain.len() + bias.len()) * size_of::<f32>(),
                Prepared::Anchors(keys, values, _) => {
                    keys.bytes() + values.len() * size_of::<f32>()
                }
            })
            .sum();
        Memory {
            weights: matrices + others,
            arena: self.plan.arena_bytes(),
            scratch: self.scratch.len() * size_of::<f32>(),
        }
    }

    /// Runs one operation of the graph; for profiles. [`Executor::run`] runs all of them in order.
    pub fn run_node(&mut self, step: usize) {
        let Some(node) = self.graph.nodes.get(step) else {
            return;
        };
        let read = |index: usize| {
            node.inputs
                .get(index)
                .map_or(0..0, |tensor| span(&self.plan, tensor, &self.counts))
        };
        let reads = [read(0), read(1), read(2), read(3)];
        let write = |index: usize| {
            node.outputs.get(index).map_or(0..0, |tensor| {
                // A derived count is not known yet: lend the whole value.
                let start = self.plan.offsets[tensor.value.0];
                start..start + self.graph.value_sizes[tensor.value.0]
            })
        };
        let writes = [write(0), write(1)];
        let (inputs, [out, second_out]) = self.arena.split(reads, writes);
        let rows = |index: usize| -> gemm::Rows<'_> {
            let tensor = &node.inputs[index];
            gemm::Rows {
                data: inputs[index],
                rows: tensor.rows.at(&self.counts),
                channels: tensor.channels,
                stride: tensor.row_stride,
            }
        };
        let picture = || {
            let grid = grid_of(&node.inputs[0]);
            Picture {
                pixels: rows(0),
                height: grid.height,
                width: grid.width,
            }
        };
        let residual = (node.inputs.len() > 1).then(|| rows(1));
        let out_tensor = node.outputs[0];
        let out_grid = grid_of(&out_tensor);
        let second_width = node.outputs.get(1).map_or(0, |tensor| tensor.channels);
        let scratch = &mut self.scratch[..];
        let parts = split::parts(self.threads, self.graph.node_macs(node, &self.counts));
        let widths = [out_tensor.channels, second_width];
        let level = self.level;
        let matrices = match &self.prepared[step] {
            Prepared::Matrices(range) => &self.matrices[range.clone()],
            _ => &[],
        };
        match (&node.op, &self.prepared[step]) {
            (
                Op::Conv3x3 {
                    stride, activation, ..
                },
                _,
            ) => {
                let in_grid = grid_of(&node.inputs[0]);
                let (x, width) = (rows(0), out_grid.width);
                let strides = widths.map(|channels| channels * width);
                let outs = [out, second_out];
                split::by_rows(parts, out_grid.height, strides, outs, scratch, &|part| {
                    let [out, _] = part.outs;
                    let pixels = part.rows.start * width..part.rows.end * width;
                    let filled = pixels.len() * out_tensor.channels;
                    let convolution = if is_winograd(level, node) {
                        winograd::convolution
                    } else {
                        conv3x3::convolution
                    };
                    convolution(Convolution {
                        x,
                        in_size: [in_grid.height, in_grid.width],
                        first_row: part.rows.start,
                        out_size: [part.rows.len(), width],
                        step: *stride,
                        matrix: &matrices[0],
                        residual: residual.map(|residual| residual.part(pixels)),
                        relu: *activation == Activation::Relu,
                        out,
                        band: part.scratch,
                    });
                    finish_activation(level, *activation, &mut out[..filled]);
                });
            }
            (Op::Linear { activation, .. }, _) => {
                let x = rows(0);
                let depth = x.channels / matrices.len().max(1);
                let outs = [out, second_out];
                split::by_rows(parts, x.rows, widths, outs, scratch, &|part| {
                    let [out, _] = part.outs;
                    let filled = part.rows.len() * out_tensor.channels;
                    let x = x.part(part.rows.clone());
                    let residual = residual.map(|residual| residual.part(part.rows));
                    for (group, matrix) in matrices.iter().enumerate() {
                        let first = group * matrix.columns();
                        gemm::product(Product {
                            x: x.window(group * depth, depth),
                            matrix,
                            residual: residual
                                .map(|residual| residual.window(first, matrix.columns())),
                            relu: *activation == Activation::Relu,
                            out: &mut out[first..],
                            out_stride: out_tensor.channels,
                        });
                    }
                    finish_activation(level, *activation, &mut out[..filled]);
                });
            }
            (Op::Activate { activation }, _) => {
                elementwise::add(level, rows(0), None, *activation, out)
            }
            (Op::Add { activation }, _) => {
                elementwise::add(level, rows(0), residual, *activation, out)
            }
            (Op::Resize, _) => {
                elementwise::resize(
                    level,
                    picture(),
                    residual,
                    out_grid.height,
                    out_grid.width,
                    out,
                );
            }
            (Op::AvgPool { size }, _) => {
                elementwise::avg_pool(
                    level,
                    picture(),
                    *size,
                    out_grid.height,
                    out_grid.width,
                    out,
                );
            }
            (&Op::MaxPool { size, stride, pad }, _) => {
                let windows = Windows { size, stride, pad };
                elementwise::max_pool(
                    level,
                    picture(),
                    windows,
                    out_grid.height,
                    out_grid.width,
                    out,
                );
            }
            (Op::InstanceNorm { eps }, _) => norm::instance_norm(level, rows(0), *eps, out),
            (Op::Unfold { block }, _) => elementwise::unfold(picture(), *block, out),
            (Op::DetectorHeat { block }, _) => {
                elementwise::detector_heat(level, picture(), *block, out, scratch);
            }
            (Op::LayerNorm { eps, .. }, Prepared::Norm(gain, bias)) => {
                norm::layer_norm(level, rows(0), gain, bias, *eps, out);
            }
            (Op::L2Norm { eps }, _) => norm::l2_norm(level, rows(0), *eps, out),
            (
                Op::Attention {
                    heads,
                    scale,
                    masked,
                },
                _,
            ) => {
                let (q, k, v) = (rows(0), rows(1), rows(2));
                let keep = masked.then(|| rows(3));
                let outs = [out, second_out];
                split::by_rows(parts, q.rows, widths, outs, scratch, &|part| {
                    let [out, _] = part.outs;
                    attention::attention(
                        level,
                        Attention {
                            q: q.part(part.rows),
                            k,
                            v,
                            keep,
                            heads: *heads,
                            scale: *scale,
                            out,
                            scratch: part.scratch,
                        },
                    );
                });
            }
            (
                Op::TokenPool {
                    heads,
                    tokens,
                    scale,
                },
                _,
            ) => attention::token_pool(
                level,
                TokenPool {
                    u: rows(0),
                    tokens_of: rows(1),
                    heads: *heads,
                    tokens: *tokens,
                    scale: *scale,
                    out,
                    scratch,
                },
            ),
            (&Op::Sample { filter, x, y }, _) => {
                elementwise::sample(level, picture(), rows(1), Sampling { filter, x, y }, out);
            }
            (Op::SoftChoice { .. }, Prepared::Anchors(keys, values, sharpness)) => {
                let x = rows(0);
                let outs = [out, second_out];
                split::by_rows(parts, x.rows, widths, outs, scratch, &|part| {
                    let [chosen, statistics] = part.outs;
                    soft_choice::soft_choice(SoftChoice {
                        x: x.part(part.rows),
                        keys,
                        values,
                        sharpness: *sharpness,
                        chosen,
                        statistics,
                        scratch: part.scratch,
                    });
                });
            }
            (Op::Keep { min_logit }, _) => {
                let kept = elementwise::keep(rows(0), rows(1), *min_logit, out, second_out);
                if let Rows::Counted { count, .. } = out_tensor.rows {
                    self.counts[count.0] = kept;
                }
            }
            (Op::LayerNorm { .. } | Op::SoftChoice { .. }, _) => {
                unreachable!("`with_level` prepares {}", node.op.name())
            }
        }
    }
}

impl Executor for CpuExecutor {
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
        let range = span(&self.plan, &self.graph.input(name)?, &self.counts);
        Ok(self.arena.part_mut(range))
    }

    fn run(&mut self) -> Result<(), NnError> {
        for step in 0..self.graph.nodes.len() {
            self.run_node(step);
        }
        Ok(())
    }

    fn output(&self, name: &str) -> Result<&[f32], NnError> {
        let range = span(&self.plan, &self.graph.output(name)?, &self.counts);
        Ok(self.arena.part(range))
    }
}

/// Part of the arena that a tensor's rows cover.
fn span(plan: &Plan, tensor: &Tensor, counts: &[usize]) -> Range<usize> {
    let start = plan.offsets[tensor.value.0] + tensor.offset;
    match tensor.rows.at(counts) {
        0 => start..start,
        rows => start..start + (rows - 1) * tensor.row_stride + tensor.channels,
    }
}

/// Functions that the matrix kernel does not apply itself.
fn finish_activation(level: Level, activation: Activation, numbers: &mut [f32]) {
    match activation {
        Activation::None | Activation::Relu => {}
        Activation::Gelu | Activation::Sigmoid => {
            elementwise::activate(level, activation, numbers);
        }
    }
}
