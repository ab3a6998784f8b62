//! Networks of one operation with random shapes, weights and inputs: every executor is compared with the oracle on these,
//! natively, in wasm and on devices.
//!
//! Sizes lie around the edges of the kernels' tiles: 1, 3, 4, 5, 7, 8, 9, 15, 16, 17 and so on.

use landline::{
    math::Rng,
    nn::{
        Activation, AxisMap, CountId, Dense, Filter, Graph, GraphBuilder, NnError, Tensor,
        WeightTensor, Weights, executor::Executor, oracle::OracleExecutor,
    },
};

/// Kinds of cases for [`nn_case`] that every executor runs.
pub const NN_KINDS: [&str; 20] = [
    "linear",
    "affine",
    "conv3x3",
    "stem",
    "stem with affine layers",
    "activate",
    "add",
    "resize",
    "avg_pool",
    "max_pool",
    "instance_norm",
    "unfold",
    "detector_heat",
    "layer_norm",
    "l2_norm",
    "attention",
    "token_pool",
    "sample",
    "soft_choice",
    "keep",
];

/// Kinds for widths that no network here has; every executor runs them too.
pub const CPU_KINDS: [&str; 3] = [
    "attention of any depth",
    "soft_choice of any depth",
    "conv3x3 by patches",
];

/// Outputs of a run, by name.
type Outputs = Vec<(String, Vec<f32>)>;

/// A network with everything needed to run it once.
#[derive(Debug, Clone)]
pub struct NnCase {
    /// Operation and sizes, for messages.
    pub name: String,
    /// The network.
    pub graph: Graph,
    /// Its weights.
    pub weights: Weights,
    /// Counts to set.
    pub counts: Vec<(String, usize)>,
    /// Inputs at those counts.
    pub inputs: Vec<(String, Vec<f32>)>,
    /// Largest difference allowed on the CPU, for numbers up to one; larger ones may be off in proportion.
    pub tolerance: f64,
    /// Largest difference allowed on devices, whose functions are less exact, relative to the largest output (at least 1).
    pub device_tolerance: f64,
}

impl NnCase {
    /// Outputs of the oracle.
    ///
    /// # Errors
    /// What the oracle refuses.
    pub fn expected(&self) -> Result<Outputs, NnError> {
        let mut oracle = OracleExecutor::new(self.graph.clone(), self.weights.clone())?;
        self.run(&mut oracle)
    }

    /// Runs the case on an executor and copies its outputs.
    ///
    /// # Errors
    /// What the executor refuses.
    pub fn run(&self, executor: &mut dyn Executor) -> Result<Outputs, NnError> {
        for (name, count) in &self.counts {
            executor.set_count(name, *count)?;
        }
        for (name, data) in &self.inputs {
            executor.input(name)?.copy_from_slice(data);
        }
        executor.run()?;
        let ports = self.graph.outputs().iter();
        ports
            .map(|port| Ok((port.name.clone(), executor.output(&port.name)?.to_vec())))
            .collect()
    }

    /// The first number of a device that differs from the oracle by more than [`Self::device_tolerance`], in words.
    pub fn difference(&self, found: &[(String, Vec<f32>)]) -> Option<String> {
        let expected = match self.expected() {
            Ok(expected) => expected,
            Err(error) => return Some(format!("{}: the oracle refuses: {error}", self.name)),
        };
        self.compare(&expected, found, |_, largest| {
            self.device_tolerance * largest.max(1.0)
        })
    }

    /// The first number of the CPU that differs from the oracle's outputs by more than [`Self::tolerance`], in words.
    pub fn difference_on_cpu(
        &self,
        expected: &[(String, Vec<f32>)],
        found: &[(String, Vec<f32>)],
    ) -> Option<String> {
        self.compare(expected, found, |number, _| {
            self.tolerance * number.abs().max(1.0)
        })
    }

    /// `allowed` is told the expected number and the largest one of its output.
    fn compare(
        &self,
        expected: &[(String, Vec<f32>)],
        found: &[(String, Vec<f32>)],
        allowed: impl Fn(f64, f64) -> f64,
    ) -> Option<String> {
        for ((name, expected), (_, found)) in expected.iter().zip(found) {
            if expected.len() != found.len() {
                return Some(format!(
                    "{}: `{name}` has {} numbers, expected {}",
                    self.name,
                    found.len(),
                    expected.len()
                ));
            }
            let largest = expected
                .iter()
                .fold(0.0_f64, |largest, &x| largest.max(f64::from(x).abs()));
            for (at, (&e, &f)) in expected.iter().zip(found).enumerate() {
                let off = (f64::from(e) - f64::from(f)).abs();
                // Negated so that a NaN counts as a difference.
                if !(off <= allowed(f64::from(e), largest)) {
                    return Some(format!(
                        "{}: `{name}`[{at}] is {f}, expected {e}, off by {off:e}",
                        self.name
                    ));
                }
            }
        }
        None
    }
}

/// Cases of all [`NN_KINDS`], five of each kind a round, the same for the same seed.
pub fn nn_cases(seed: u64, rounds: usize) -> Vec<NnCase> {
    let per_kind = 5 * rounds as u64;
    NN_KINDS
        .iter()
        .flat_map(|kind| (0..per_kind).map(move |number| nn_case(kind, seed * 1000 + number)))
        .collect()
}

/// Random weights for a graph, in -1..1. Sharpness values are 20.
pub fn random_weights(graph: &Graph, rng: &mut Rng) -> Weights {
    let tensors = graph.weights().iter().map(|spec| {
        let count = spec.shape.iter().product();
        let numbers = if spec.name.ends_with(".sharpness") {
            vec![20.0; count]
        } else {
            random(rng, count)
        };
        let tensor = WeightTensor::f32(&spec.shape, numbers).expect("the shape's own size");
        (spec.name.clone(), tensor)
    });
    tensors.collect()
}

fn random(rng: &mut Rng, count: usize) -> Vec<f32> {
    (0..count).map(|_| rng.range(-1.0, 1.0) as f32).collect()
}

/// A graph under construction, with the count `n` that most operations have.
struct Maker {
    rng: Rng,
    g: GraphBuilder,
    n: CountId,
    counts: Vec<(String, usize)>,
}

impl Maker {
    fn between(&mut self, low: usize, high: usize) -> usize {
        low + self.rng.below((high - low + 1) as u32) as usize
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.between(0, from.len() - 1)]
    }

    fn size(&mut self) -> usize {
        self.pick(&[
            1, 2, 3, 4, 5, 7, 8, 9, 12, 13, 15, 16, 17, 24, 31, 32, 33, 48, 64, 65, 67,
        ])
    }

    fn activation(&mut self) -> Activation {
        self.pick(Activation::ALL)
    }

    /// A count of rows with its capacity; some are empty, some full.
    fn count(&mut self, name: &str, capacity: usize) -> CountId {
        let used = self.pick(&[0, 1, capacity / 2 + 1, capacity, capacity]);
        self.counts.push((name.to_owned(), used.min(capacity)));
        self.g.count(name, capacity)
    }

    /// An input of rows: a window of a wider tensor, so that strides and offsets are tried.
    fn rows(&mut self, name: &str, channels: usize) -> Tensor {
        let extra = self.pick(&[0, 0, 1, 5]);
        let first = self.between(0, extra);
        self.g
            .input_rows(name, self.n, channels + extra)
            .channel_range(first..first + channels)
    }

    fn picture(&mut self, [height, width]: [usize; 2], channels: usize) -> Tensor {
        self.g.input_grid("x", height, width, channels)
    }
}

/// How much more coarsely than the direct sums Winograd's F(4x4, 3x3) rounds: its products of independent numbers add up with
/// a standard deviation so many times that of the result at the last of a patch's four by four pixels, where it is largest.
/// Along each side that is `sqrt(sum over p of A[p]^2 |G[p]|^2 |B[p]|^2 / 3)` = 5.61, with the rows of the three transforms.
const WINOGRAD_ROUNDING: f64 = 31.5;

/// [`WINOGRAD_ROUNDING`] for channels of which the CPU may take that algorithm, else one.
fn rounding_of_conv(inner: usize, out: usize) -> f64 {
    if inner.min(out) >= 16 {
        WINOGRAD_ROUNDING
    } else {
        1.0
    }
}

/// Rounding of a sum of so many products of numbers below one.
fn dot_tolerance(depth: usize) -> f64 {
    4.0 * (depth as f64).sqrt() * f64::from(f32::EPSILON)
}

/// A random case of one of [`NN_KINDS`] or [`CPU_KINDS`].
///
/// # Panics
/// For another kind.
pub fn nn_case(kind: &str, seed: u64) -> NnCase {
    let mut rng = Rng::from_seed(seed);
    // Kinds do not share their random numbers.
    for byte in kind.bytes() {
        rng = Rng::from_seed(rng.next_u64() ^ u64::from(byte));
    }
    let mut g = GraphBuilder::new(format!("{kind} {seed}"));
    let capacity = 1 + rng.below(134) as usize;
    let n = g.count("n", capacity);
    let mut m = Maker {
        rng,
        g,
        n,
        counts: Vec::new(),
    };
    let used = m.pick(&[0, 1, capacity / 2, capacity, capacity]);
    m.counts.push(("n".to_owned(), used));
    let channels = m.size();
    let size = [m.between(1, 13), m.between(1, 21)];
    let (tolerance, device_tolerance) = match kind {
        "linear"
        | "affine"
        | "conv3x3"
        | "conv3x3 by patches"
        | "stem"
        | "stem with affine layers" => dense(kind, &mut m, channels, size),
        "resize" | "avg_pool" | "max_pool" | "instance_norm" | "unfold" | "detector_heat"
        | "sample" => picture(kind, &mut m, channels, size),
        _ => rows(kind, &mut m, channels),
    };
    let Maker {
        mut rng, g, counts, ..
    } = m;
    let graph = g.finish().expect("the cases are valid networks");
    let weights = random_weights(&graph, &mut rng);
    let at: Vec<usize> = counts.iter().map(|(_, count)| *count).collect();
    let inputs = graph
        .inputs()
        .iter()
        .map(|port| {
            let count = port.tensor.rows.at(&at) * port.tensor.channels;
            (port.name.clone(), random(&mut rng, count))
        })
        .collect();
    NnCase {
        name: format!("{kind} {seed}: {:?} counts {counts:?}", graph.nodes()[0]),
        graph,
        weights,
        counts,
        inputs,
        tolerance,
        device_tolerance,
    }
}

/// Builds a case of products; returns its tolerances, as the next two functions do.
fn dense(kind: &str, m: &mut Maker, channels: usize, size: [usize; 2]) -> (f64, f64) {
    match kind {
        "linear" => {
            let groups = m.pick(&[1, 1, 1, 2, 4]);
            let [inner, out] = [m.size() * groups, m.size() * groups];
            let x = m.rows("x", inner);
            let mut layer = Dense::new("layer", out)
                .activation(m.activation())
                .groups(groups);
            if m.between(0, 1) == 1 {
                layer = layer.residual(m.rows("residual", out));
            }
            if m.between(0, 2) == 0 {
                layer = layer.without_bias();
            }
            let y = m.g.linear(x, layer);
            m.g.output("y", y);
            (
                2e-6 + dot_tolerance(inner),
                4e-6 + 2.0 * dot_tolerance(inner),
            )
        }
        "affine" => {
            let x = m.rows("x", channels);
            let layer = Dense::new("l", channels)
                .groups(channels)
                .activation(m.activation());
            let y = m.g.linear(x, layer);
            m.g.output("y", y);
            (2e-6, 4e-6)
        }
        "conv3x3" => {
            let extra = m.pick(&[0, 0, 3]);
            let x = m
                .picture(size, channels + extra)
                .channel_range(extra..extra + channels);
            let stride = m.between(1, 2);
            let out = m.size();
            let mut layer = Dense::new("layer", out)
                .activation(m.activation())
                .stride(stride);
            if m.between(0, 2) == 0 {
                let [height, width] = size.map(|side| side.div_ceil(stride));
                layer = layer.residual(m.g.input_grid("residual", height, width, out));
            }
            let y = m.g.conv3x3(x, layer);
            m.g.output("y", y);
            let coarse = if stride == 1 {
                rounding_of_conv(channels, out)
            } else {
                1.0
            };
            (2e-6 + coarse * dot_tolerance(9 * channels), 2e-5)
        }
        "conv3x3 by patches" => {
            // Whole and broken vectors of every level; more patches than are transformed at once.
            let [channels, out] = [(); 2].map(|()| m.pick(&[16, 20, 24, 32, 36, 48, 64]));
            let size = [(); 2].map(|()| m.between(8, 37));
            let extra = m.pick(&[0, 3]);
            let x = m
                .picture(size, channels + extra)
                .channel_range(extra..extra + channels);
            let mut layer = Dense::new("layer", out).activation(m.activation());
            if m.between(0, 1) == 0 {
                layer = layer.residual(m.g.input_grid("residual", size[0], size[1], out));
            }
            let y = m.g.conv3x3(x, layer);
            m.g.output("y", y);
            (2e-6 + WINOGRAD_ROUNDING * dot_tolerance(9 * channels), 2e-5)
        }
        _ => {
            let post = kind != "stem";
            let size = size.map(|side| 2 * side);
            let (hidden, out) = (m.pick(&[16, 64]), m.pick(&[4, 24, 64]));
            let x = m.picture(size, 1);
            let relu = |name| Dense::new(name, hidden).activation(Activation::Relu);
            let mut y = m.g.conv3x3(x, relu("a"));
            if post {
                y = m.g.linear(y, Dense::new("a.post", hidden).groups(hidden));
            }
            let layer = Dense::new("b", out).activation(Activation::Relu);
            let mut y = m.g.conv3x3(y, layer);
            if post {
                y = m.g.linear(y, Dense::new("b.post", out).groups(out));
            }
            let y = m.g.max_pool(y, 2, 2, 0);
            m.g.output("y", y);
            // The hidden numbers are up to ten, those of the second layer up to a thousand.
            let coarse = rounding_of_conv(hidden, out);
            (1e-5 + 10.0 * coarse * dot_tolerance(9 * hidden), 2e-5)
        }
    }
}

fn picture(kind: &str, m: &mut Maker, channels: usize, size: [usize; 2]) -> (f64, f64) {
    let few = m.pick(&[1, 1, 3]);
    let (y, tolerance) = match kind {
        "resize" => {
            let x = m.picture(size, channels);
            let [height, width] = [m.between(1, 17), m.between(1, 17)];
            let y = if m.between(0, 1) == 1 {
                let addend = m.g.input_grid("addend", height, width, channels);
                m.g.resize_add(x, addend)
            } else {
                m.g.resize(x, height, width)
            };
            (y, 2e-6)
        }
        "avg_pool" => {
            let x = m.picture(size.map(|side| side + 5), channels);
            let side = m.between(1, 5);
            (m.g.avg_pool(x, side), 2e-6)
        }
        "max_pool" => {
            let x = m.picture(size.map(|side| side + 5), channels);
            let side = m.between(1, 5);
            let [stride, pad] = [m.between(1, 3), m.between(0, side - 1)];
            (m.g.max_pool(x, side, stride, pad), 0.0)
        }
        "instance_norm" => {
            let x = m.picture([size[0], size[1] + 1], few);
            (m.g.instance_norm(x, 1e-5), 2e-5)
        }
        "unfold" => {
            let block = m.between(1, 8);
            let x = m.picture(size.map(|side| side * block), few);
            (m.g.unfold(x, block), 0.0)
        }
        "detector_heat" => {
            let block = m.between(1, 8);
            let x = m.picture(size, block * block + 1);
            (m.g.detector_heat(x, block), 2e-6)
        }
        _ => {
            let x = m.picture(size, channels);
            let positions = m.g.input_rows("positions", m.n, 2);
            let filter = m.pick(&[Filter::Bilinear, Filter::Bicubic]);
            // Positions in -1..1 reach over every border.
            let map = |side: usize| AxisMap {
                scale: 0.7 * side as f32,
                offset: 0.5 * side as f32 - 0.5,
            };
            let y = m.g.sample(x, positions, filter, map(size[1]), map(size[0]));
            (y, 4e-6)
        }
    };
    m.g.output("y", y);
    (tolerance, f64::max(tolerance, 1e-5))
}

fn rows(kind: &str, m: &mut Maker, channels: usize) -> (f64, f64) {
    let activation = m.activation();
    let (y, tolerance) = match kind {
        "activate" => {
            let x = m.rows("x", channels);
            (m.g.activate(x, activation), 2e-6)
        }
        "add" => {
            let (a, b) = (m.rows("a", channels), m.rows("b", channels));
            (m.g.add(a, b, activation), 2e-6)
        }
        "layer_norm" => {
            let x = m.rows("x", channels + 8);
            (m.g.layer_norm(x, "norm", 1e-6), 1e-5)
        }
        "l2_norm" => {
            let x = m.rows("x", channels);
            (m.g.l2_norm(x, 1e-12), 2e-6)
        }
        "attention" | "attention of any depth" => {
            let heads = m.pick(&[1, 2, 4]);
            let [depth, width] = if kind == "attention" {
                [m.pick(&[4, 8, 16, 64]), m.pick(&[4, 16, 32, 64])]
            } else {
                [m.pick(&[3, 17, 30]), m.pick(&[1, 7, 33])]
            };
            // Some cases need several tiles of keys and blocks of queries.
            let capacity = m.pick(&[1, 9, 60, 300, 600]);
            let keys = m.count("m", capacity);
            let q = m.rows("q", heads * depth);
            let both = m.g.input_rows("kv", keys, heads * (depth + width));
            let k = both.channel_range(0..heads * depth);
            let v = both.channel_range(heads * depth..heads * (depth + width));
            let masked = m.between(0, 2) == 0;
            let keep = masked.then(|| m.g.input_rows("keep", keys, 1));
            let scale = 1.0 / (depth as f32).sqrt();
            (m.g.attention([q, k, v], heads, scale, keep), 4e-6)
        }
        "token_pool" => {
            let (heads, tokens) = (m.pick(&[1, 2, 4]), m.pick(&[1, 5, 12]));
            let u = m.rows("u", heads * channels);
            let tokens_of = m.g.input_tokens("tokens", m.n, tokens, channels);
            (m.g.token_pool(u, tokens_of, heads, 0.125), 4e-6)
        }
        "soft_choice" | "soft_choice of any depth" => {
            let depth = if kind == "soft_choice" {
                m.pick(&[4, 16, 64])
            } else {
                m.pick(&[1, 5, 30])
            };
            let x = m.rows("x", depth);
            let anchors = m.pick(&[1, 2, 15, 16, 17, 100, 333]);
            let values = m.pick(&[1, 3, 6]);
            let [chosen, statistics] = m.g.soft_choice(x, "anchor", anchors, values);
            m.g.output("statistics", statistics);
            // A similarity of up to 64 products times the sharpness goes through an exponential.
            (chosen, 3e-4)
        }
        "keep" => {
            let x = m.rows("x", channels);
            let logit = m.g.input_rows("logit", m.n, 1);
            let min_logit = m.pick(&[-2.0, -0.3, 0.0, 0.3, 2.0]);
            let [kept, index] = m.g.keep(x, logit, min_logit, "kept");
            m.g.output("index", index);
            // The new count goes on to the next operation.
            (m.g.add(kept, kept, Activation::None), 0.0)
        }
        other => panic!("no such kind: {other}"),
    };
    m.g.output("y", y);
    (tolerance, f64::max(tolerance, 1e-5))
}
