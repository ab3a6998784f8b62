//! Random networks of one operation each, and the comparison of an executor with the reference.
//!
//! Native and wasm tests run the same cases. Sizes lie around the edges of tiles: 1, 3, 4, 5, 7, 8, 9, 15, 16, 17 and so on.

use landline::nn::{
    Activation, AxisMap, Dense, Executor, Filter, Graph, GraphBuilder, NnError, Tensor,
    WeightTensor, Weights, oracle::OracleExecutor,
};

/// A small generator (SplitMix64); the same numbers on every target.
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// A generator with a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number in `low..=high`.
    pub fn between(&mut self, low: usize, high: usize) -> usize {
        low + (self.bits() % (high - low + 1) as u64) as usize
    }

    /// A number in -1..1.
    pub fn number(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    /// One of several.
    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.between(0, from.len() - 1)]
    }

    fn size(&mut self) -> usize {
        self.pick(&[
            1, 2, 3, 4, 5, 7, 8, 9, 12, 13, 15, 16, 17, 24, 31, 33, 48, 65, 67,
        ])
    }

    fn activation(&mut self) -> Activation {
        self.pick(&[
            Activation::None,
            Activation::Relu,
            Activation::Gelu,
            Activation::Sigmoid,
        ])
    }
}

/// A network with its weights and inputs.
#[derive(Debug, Clone)]
pub struct Case {
    /// Operation and sizes, for messages.
    pub label: String,
    /// The network.
    pub graph: Graph,
    /// Its weights.
    pub weights: Weights,
    /// Values of the counts.
    pub counts: Vec<(String, usize)>,
    /// Largest difference allowed, for outputs of size one.
    pub tolerance: f32,
    seed: u64,
}

/// The kinds of cases that [`case`] makes.
pub const KINDS: [&str; 17] = [
    "linear",
    "conv3x3",
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

/// Random weights for a graph, in -1..1. Sharpness values are 20.
pub fn random_weights(graph: &Graph, random: &mut Random) -> Weights {
    let tensors = graph.weights().iter().map(|spec| {
        let count = spec.shape.iter().product();
        let numbers = (0..count)
            .map(|_| {
                if spec.name.ends_with(".sharpness") {
                    20.0
                } else {
                    random.number()
                }
            })
            .collect();
        let tensor = WeightTensor::f32(&spec.shape, numbers).expect("the shape's own size");
        (spec.name.clone(), tensor)
    });
    tensors.collect()
}

/// A random case of a kind.
pub fn case(kind: &str, seed: u64) -> Case {
    let mut random = Random::new(seed.wrapping_mul(KINDS.len() as u64 + 1));
    let random = &mut random;
    let mut g = GraphBuilder::new(format!("{kind} {seed}"));
    let capacity = random.size() + random.size();
    let n = g.count("n", capacity);
    let mut counts = vec![(
        "n".to_owned(),
        random.pick(&[0, 1, capacity / 2, capacity, capacity]),
    )];
    let channels = random.size();
    let [height, width] = [random.between(1, 13), random.between(1, 21)];
    // Rounding of a sum of this many products of numbers below one.
    let dot_tolerance = |depth: usize| 4.0 * (depth as f32).sqrt() * f32::EPSILON;
    let mut tolerance = 2e-6;
    // A window of a wider tensor, so that strides and offsets are tried.
    let rows = |g: &mut GraphBuilder, random: &mut Random, name: &str, channels: usize| -> Tensor {
        let extra = random.pick(&[0, 0, 1, 5]);
        let first = random.between(0, extra);
        g.input_rows(name, n, channels + extra)
            .channel_range(first..first + channels)
    };
    match kind {
        "linear" => {
            let groups = random.pick(&[1, 1, 1, 2, 4]);
            let [inner, out] = [random.size() * groups, random.size() * groups];
            let x = rows(&mut g, random, "x", inner);
            let mut layer = Dense::new("layer", out)
                .activation(random.activation())
                .groups(groups);
            if random.between(0, 1) == 1 {
                layer = layer.residual(rows(&mut g, random, "residual", out));
            }
            if random.between(0, 2) == 0 {
                layer = layer.without_bias();
            }
            let y = g.linear(x, layer);
            g.output("y", y);
            tolerance += dot_tolerance(inner);
        }
        "conv3x3" => {
            let extra = random.pick(&[0, 0, 3]);
            let x = g
                .input_grid("x", height, width, channels + extra)
                .channel_range(extra..extra + channels);
            let stride = random.between(1, 2);
            let out = random.size();
            let mut layer = Dense::new("layer", out)
                .activation(random.activation())
                .stride(stride);
            if random.between(0, 2) == 0 {
                let [height, width] = [height.div_ceil(stride), width.div_ceil(stride)];
                layer = layer.residual(g.input_grid("residual", height, width, out));
            }
            let y = g.conv3x3(x, layer);
            g.output("y", y);
            tolerance += dot_tolerance(9 * channels);
        }
        "activate" => {
            let x = rows(&mut g, random, "x", channels);
            let y = g.activate(x, random.activation());
            g.output("y", y);
        }
        "add" => {
            let a = rows(&mut g, random, "a", channels);
            let b = rows(&mut g, random, "b", channels);
            let y = g.add(a, b, random.activation());
            g.output("y", y);
        }
        "resize" => {
            let x = g.input_grid("x", height, width, channels);
            let [height, width] = [random.between(1, 17), random.between(1, 17)];
            let y = if random.between(0, 1) == 1 {
                let addend = g.input_grid("addend", height, width, channels);
                g.resize_add(x, addend)
            } else {
                g.resize(x, height, width)
            };
            g.output("y", y);
        }
        "avg_pool" | "max_pool" => {
            let size = random.between(1, 5);
            let x = g.input_grid("x", height + 5, width + 5, channels);
            let y = if kind == "avg_pool" {
                g.avg_pool(x, size)
            } else {
                let [stride, pad] = [random.between(1, 3), random.between(0, size - 1)];
                g.max_pool(x, size, stride, pad)
            };
            g.output("y", y);
        }
        "instance_norm" => {
            let x = g.input_grid("x", height, width + 1, random.pick(&[1, 1, 3]));
            let y = g.instance_norm(x, 1e-5);
            g.output("y", y);
            tolerance = 2e-5;
        }
        "unfold" => {
            let block = random.between(1, 8);
            let x = g.input_grid("x", height * block, width * block, random.pick(&[1, 1, 3]));
            let y = g.unfold(x, block);
            g.output("y", y);
            tolerance = 0.0;
        }
        "detector_heat" => {
            let block = random.between(1, 8);
            let x = g.input_grid("x", height, width, block * block + 1);
            let y = g.detector_heat(x, block);
            g.output("y", y);
        }
        "layer_norm" => {
            let x = rows(&mut g, random, "x", channels + 8);
            let y = g.layer_norm(x, "norm", 1e-6);
            g.output("y", y);
            tolerance = 1e-5;
        }
        "l2_norm" => {
            let x = rows(&mut g, random, "x", channels);
            let y = g.l2_norm(x, 1e-12);
            g.output("y", y);
        }
        "attention" => {
            let heads = random.pick(&[1, 2, 4]);
            let [depth, width] = [
                random.pick(&[4, 8, 16, 17, 64]),
                random.pick(&[4, 7, 16, 32, 64]),
            ];
            // Some cases need several tiles of keys and blocks of queries.
            let capacity = random.pick(&[1, 9, 60, 300, 600]);
            let m = g.count("m", capacity);
            counts.push((
                "m".to_owned(),
                random.pick(&[0, 1, capacity / 2 + 1, capacity]),
            ));
            let q = rows(&mut g, random, "q", heads * depth);
            let both = g.input_rows("kv", m, heads * (depth + width));
            let k = both.channel_range(0..heads * depth);
            let v = both.channel_range(heads * depth..heads * (depth + width));
            let keep = (random.between(0, 2) == 0).then(|| g.input_rows("keep", m, 1));
            let y = g.attention([q, k, v], heads, 1.0 / (depth as f32).sqrt(), keep);
            g.output("y", y);
            tolerance = 4e-6;
        }
        "token_pool" => {
            let heads = random.pick(&[1, 2, 4]);
            let tokens = random.pick(&[1, 5, 12]);
            let u = rows(&mut g, random, "u", heads * channels);
            let tokens_of = g.input_tokens("tokens", n, tokens, channels);
            let y = g.token_pool(u, tokens_of, heads, 0.125);
            g.output("y", y);
            tolerance = 4e-6;
        }
        "sample" => {
            let x = g.input_grid("x", height, width, channels);
            let positions = g.input_rows("positions", n, 2);
            let filter = random.pick(&[Filter::Bilinear, Filter::Bicubic]);
            let map = |size: usize| AxisMap {
                scale: 0.7 * size as f32,
                offset: 0.5 * size as f32 - 0.5,
            };
            let y = g.sample(x, positions, filter, map(width), map(height));
            g.output("y", y);
            tolerance = 4e-6;
        }
        "soft_choice" => {
            let x = rows(&mut g, random, "x", random.clone().pick(&[5, 16, 64]));
            let anchors = random.pick(&[1, 2, 15, 16, 17, 100, 333]);
            let [chosen, statistics] = g.soft_choice(x, "anchor", anchors, random.pick(&[1, 3, 6]));
            g.output("chosen", chosen);
            g.output("statistics", statistics);
            // A similarity of up to 64 products times the sharpness goes through an exponential.
            tolerance = 3e-4;
        }
        "keep" => {
            let x = rows(&mut g, random, "x", channels);
            let logit = g.input_rows("logit", n, 1);
            let [kept, index] = g.keep(x, logit, random.pick(&[-2.0, -0.3, 0.0, 0.3, 2.0]), "kept");
            let doubled = g.add(kept, kept, Activation::None);
            g.output("kept", doubled);
            g.output("index", index);
            tolerance = 0.0;
        }
        other => panic!("no such kind: {other}"),
    }
    let graph = g.finish().expect("the cases are valid networks");
    let weights = random_weights(&graph, random);
    let label = format!("{kind} {seed}: {:?} counts {counts:?}", graph.nodes()[0]);
    Case {
        label,
        graph,
        weights,
        counts,
        tolerance,
        seed,
    }
}

impl Case {
    /// Sets the counts, fills the inputs with random numbers and runs.
    ///
    /// # Errors
    /// Those of the executor.
    pub fn run(&self, executor: &mut dyn Executor) -> Result<Vec<Vec<f32>>, NnError> {
        let mut random = Random::new(self.seed ^ 0x5eed);
        for (name, count) in &self.counts {
            executor.set_count(name, *count)?;
        }
        for port in self.graph.inputs() {
            executor.input(&port.name)?.fill_with(|| random.number());
        }
        executor.run()?;
        let outputs = self.graph.outputs().iter();
        outputs
            .map(|port| executor.output(&port.name).map(<[f32]>::to_vec))
            .collect()
    }

    /// The reference's outputs.
    pub fn expected(&self) -> Vec<Vec<f32>> {
        let mut oracle =
            OracleExecutor::new(self.graph.clone(), self.weights.clone()).expect("fitting weights");
        self.run(&mut oracle)
            .expect("the reference runs every case")
    }

    /// Says what is different, if anything is.
    pub fn difference(&self, expected: &[Vec<f32>], found: &[Vec<f32>]) -> Option<String> {
        for (port, (expected, found)) in expected.iter().zip(found).enumerate() {
            if expected.len() != found.len() {
                return Some(format!(
                    "{}: {} numbers, expected {}",
                    self.label,
                    found.len(),
                    expected.len()
                ));
            }
            for (index, (&e, &f)) in expected.iter().zip(found).enumerate() {
                let allowed = self.tolerance * e.abs().max(1.0);
                if !((e - f).abs() <= allowed) {
                    return Some(format!(
                        "{}: output {port} number {index} is {f}, expected {e} within {allowed}",
                        self.label
                    ));
                }
            }
        }
        None
    }
}
