//! One-operation networks of random shapes with random weights and inputs: every executor is compared with the oracle on
//! these.

use landline::{
    math::Rng,
    nn::{
        Activation, AxisMap, Dense, Filter, Graph, GraphBuilder, NnError, Rows, Tensor,
        WeightTensor, Weights, executor::Executor, oracle::OracleExecutor,
    },
};

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
    /// Largest difference allowed for an f32 executor, relative to the largest output of the oracle (at least 1).
    pub tolerance: f64,
}

impl NnCase {
    /// Outputs of the oracle.
    ///
    /// # Errors
    /// What the oracle refuses.
    pub fn expected(&self) -> Result<Vec<(String, Vec<f32>)>, NnError> {
        let mut oracle = OracleExecutor::new(self.graph.clone(), self.weights.clone())?;
        self.run(&mut oracle)
    }

    /// Runs the case on an executor and copies its outputs.
    ///
    /// # Errors
    /// What the executor refuses.
    pub fn run(&self, executor: &mut dyn Executor) -> Result<Vec<(String, Vec<f32>)>, NnError> {
        for (name, count) in &self.counts {
            executor.set_count(name, *count)?;
        }
        for (name, data) in &self.inputs {
            executor.input(name)?.copy_from_slice(data);
        }
        executor.run()?;
        let names: Vec<String> = self
            .graph
            .outputs()
            .iter()
            .map(|port| port.name.clone())
            .collect();
        names
            .into_iter()
            .map(|name| Ok((name.clone(), executor.output(&name)?.to_vec())))
            .collect()
    }

    /// The first output that differs from the oracle by more than the tolerance, in words.
    pub fn difference(&self, found: &[(String, Vec<f32>)]) -> Option<String> {
        let expected = match self.expected() {
            Ok(expected) => expected,
            Err(error) => return Some(format!("{}: the oracle refuses: {error}", self.name)),
        };
        for ((name, expected), (_, found)) in expected.iter().zip(found) {
            if expected.len() != found.len() {
                return Some(format!(
                    "{}: `{name}` has {} numbers, expected {}",
                    self.name,
                    found.len(),
                    expected.len()
                ));
            }
            let scale = expected
                .iter()
                .fold(1.0_f64, |largest, &x| largest.max(f64::from(x).abs()));
            for (at, (&e, &f)) in expected.iter().zip(found).enumerate() {
                let off = (f64::from(e) - f64::from(f)).abs();
                // Negated so that a NaN counts as a difference.
                if !(off <= self.tolerance * scale) {
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

struct Maker<'a> {
    rng: &'a mut Rng,
    inputs: Vec<(String, usize)>,
    counts: Vec<(String, usize)>,
    g: GraphBuilder,
}

impl Maker<'_> {
    fn picture(&mut self, name: &str, height: usize, width: usize, channels: usize) -> Tensor {
        self.inputs
            .push((name.to_owned(), height * width * channels));
        self.g.input_grid(name, height, width, channels)
    }

    /// An input with a run-time number of rows: capacity and the number used.
    fn rows(
        &mut self,
        name: &str,
        capacity: usize,
        used: usize,
        per: usize,
        channels: usize,
    ) -> Tensor {
        let count = self.g.count(&format!("num_{name}"), capacity);
        self.counts.push((format!("num_{name}"), used));
        self.inputs.push((name.to_owned(), used * per * channels));
        self.g.input_tokens(name, count, per, channels)
    }

    fn finish(self, name: String, tolerance: f64) -> NnCase {
        let graph = self
            .g
            .finish()
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut weights = Weights::new();
        for spec in graph.weights() {
            let len = spec.shape.iter().product();
            let data = if spec.name.ends_with(".sharpness") {
                vec![9.0]
            } else {
                random(self.rng, len)
            };
            let tensor = WeightTensor::f32(&spec.shape, data)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            weights.insert(spec.name.clone(), tensor);
        }
        let inputs = self
            .inputs
            .into_iter()
            .map(|(input, len)| (input, random(self.rng, len)))
            .collect();
        NnCase {
            name,
            graph,
            weights,
            counts: self.counts,
            inputs,
            tolerance,
        }
    }
}

fn random(rng: &mut Rng, len: usize) -> Vec<f32> {
    (0..len).map(|_| rng.range(-1.0, 1.0) as f32).collect()
}

/// Sizes around the edges of the kernels' tiles, and primes.
fn pick(rng: &mut Rng, sizes: &[usize]) -> usize {
    sizes[rng.below(sizes.len() as u32) as usize]
}

const ACTIVATIONS: [Activation; 4] = [
    Activation::None,
    Activation::Relu,
    Activation::Gelu,
    Activation::Sigmoid,
];

/// About a dozen cases of every operation, `rounds` times over, the same for the same seed.
pub fn nn_cases(seed: u64, rounds: usize) -> Vec<NnCase> {
    let mut rng = Rng::from_seed(seed);
    let mut cases = Vec::new();
    for _ in 0..rounds {
        dense_cases(&mut rng, &mut cases);
        picture_cases(&mut rng, &mut cases);
        row_cases(&mut rng, &mut cases);
    }
    cases
}

fn maker<'a>(rng: &'a mut Rng, name: &str) -> Maker<'a> {
    Maker {
        rng,
        inputs: Vec::new(),
        counts: Vec::new(),
        g: GraphBuilder::new(name),
    }
}

fn dense_cases(rng: &mut Rng, cases: &mut Vec<NnCase>) {
    for activation in ACTIVATIONS {
        let used = pick(rng, &[0, 1, 2, 31, 32, 33, 67]);
        let capacity = used + pick(rng, &[1, 5, 40]);
        let (depth, out) = (
            pick(rng, &[1, 3, 15, 16, 17, 64, 96]),
            pick(rng, &[1, 4, 8, 31, 33, 65, 128]),
        );
        let groups = pick(rng, &[1, 1, 2, 4]);
        let residual = rng.below(2) == 1;
        let mut m = maker(rng, "linear");
        let x = m.rows("x", capacity, used, 1, depth * groups);
        let mut layer = Dense::new("l", out * groups)
            .activation(activation)
            .groups(groups);
        if residual {
            let Rows::Counted { count, .. } = x.rows else {
                unreachable!("rows are counted")
            };
            m.inputs.push(("r".to_owned(), used * out * groups));
            layer = layer.residual(m.g.input_rows("r", count, out * groups));
        } else {
            layer = layer.without_bias();
        }
        let y = m.g.linear(x, layer);
        m.g.output("y", y);
        cases.push(m.finish(
            format!("linear {used}x{depth}x{out} groups {groups} {activation:?}"),
            2e-6 * (depth as f64).sqrt(),
        ));
    }
    for post in [false, true] {
        let (h, w) = (pick(rng, &[2, 7, 16, 26]), pick(rng, &[2, 9, 24, 34]));
        let (hidden, out) = (pick(rng, &[16, 64]), pick(rng, &[4, 24, 64]));
        let mut m = maker(rng, "stem");
        let x = m.picture("x", h, w, 1);
        let mut y =
            m.g.conv3x3(x, Dense::new("a", hidden).activation(Activation::Relu));
        if post {
            y = m.g.linear(y, Dense::new("a.post", hidden).groups(hidden));
        }
        let mut y =
            m.g.conv3x3(y, Dense::new("b", out).activation(Activation::Relu));
        if post {
            y = m.g.linear(y, Dense::new("b.post", out).groups(out));
        }
        let y = m.g.max_pool(y, 2, 2, 0);
        m.g.output("y", y);
        cases.push(m.finish(
            format!("stem {h}x{w} to {hidden} to {out} post {post}"),
            2e-5,
        ));

        let used = pick(rng, &[0, 1, 65]);
        let mut m = maker(rng, "affine");
        let x = m.rows("x", used + 2, used, 1, out);
        let y = m.g.linear(
            x,
            Dense::new("l", out)
                .groups(out)
                .activation(Activation::Sigmoid),
        );
        m.g.output("y", y);
        cases.push(m.finish(format!("affine {used}x{out}"), 2e-6));
    }
    for stride in [1, 2] {
        for channels in [1, 4, 5, 24] {
            let (h, w) = (pick(rng, &[1, 2, 7, 12, 33]), pick(rng, &[1, 3, 8, 17, 40]));
            let out = pick(rng, &[1, 4, 8, 24, 35, 64]);
            let mut m = maker(rng, "conv3x3");
            let x = m.picture("x", h, w, channels);
            let mut layer = Dense::new("c", out)
                .stride(stride)
                .activation(Activation::Relu);
            if stride == 1 {
                layer = layer.residual(m.picture("r", h, w, out));
            }
            let y = m.g.conv3x3(x, layer);
            m.g.output("y", y);
            cases.push(m.finish(
                format!("conv3x3 {h}x{w}x{channels} to {out} stride {stride}"),
                2e-5,
            ));
        }
    }
}

fn picture_cases(rng: &mut Rng, cases: &mut Vec<NnCase>) {
    for _ in 0..3 {
        let (h, w, c) = (
            pick(rng, &[8, 16, 24]),
            pick(rng, &[8, 24, 40]),
            pick(rng, &[1, 3, 8]),
        );
        for kind in 0..7 {
            let mut m = maker(rng, "picture");
            let x = m.picture("x", h, w, c);
            let y = match kind {
                0 => {
                    let addend = m.picture("addend", h * 2 + 1, w + 3, c);
                    m.g.resize_add(x, addend)
                }
                1 => m.g.resize(x, h / 2 + 1, w * 2),
                2 => m.g.avg_pool(x, 4),
                3 => m.g.max_pool(x, 5, 1, 2),
                4 => m.g.max_pool(x, 2, 2, 0),
                5 => m.g.instance_norm(x, 1e-5),
                _ => m.g.unfold(x, 8),
            };
            m.g.output("y", y);
            cases.push(m.finish(format!("picture operation {kind} on {h}x{w}x{c}"), 1e-5));
        }
        let mut m = maker(rng, "heat");
        let x = m.picture("x", h / 4, w / 4, 65);
        let y = m.g.detector_heat(x, 8);
        m.g.output("y", y);
        cases.push(m.finish(format!("detector_heat {h}x{w}"), 1e-6));
        for filter in [Filter::Bilinear, Filter::Bicubic] {
            let used = pick(rng, &[0, 1, 63, 65]);
            let mut m = maker(rng, "sample");
            let x = m.picture("x", h, w, c);
            let at = m.rows("at", used + 3, used, 1, 2);
            // Positions in -1..1 reach over every border.
            let map = |size: usize| AxisMap {
                scale: 0.6 * size as f32,
                offset: 0.5 * size as f32 - 0.5,
            };
            let y = m.g.sample(x, at, filter, map(w), map(h));
            m.g.output("y", y);
            cases.push(m.finish(format!("sample {filter:?} {used} of {h}x{w}x{c}"), 1e-5));
        }
    }
}

fn row_cases(rng: &mut Rng, cases: &mut Vec<NnCase>) {
    for used in [
        0,
        1,
        pick(rng, &[2, 15, 16, 17]),
        pick(rng, &[63, 64, 65, 129]),
    ] {
        let capacity = used + pick(rng, &[1, 7, 64]);
        let channels = pick(rng, &[4, 32, 64, 100, 256]);
        for centred in [false, true] {
            let mut m = maker(rng, "norm");
            let x = m.rows("x", capacity, used, 1, channels);
            let y = if centred {
                m.g.layer_norm(x, "n", 1e-6)
            } else {
                m.g.l2_norm(x, 1e-12)
            };
            m.g.output("y", y);
            cases.push(m.finish(format!("norm centred {centred} {used}x{channels}"), 1e-5));
        }
        for activation in ACTIVATIONS {
            let mut m = maker(rng, "elementwise");
            let x = m.rows("x", capacity, used, 1, 2 * channels);
            let (a, b) = (
                x.channel_range(0..channels),
                x.channel_range(channels..2 * channels),
            );
            let sum = m.g.add(a, b, activation);
            let y = m.g.activate(sum, activation);
            m.g.output("y", y);
            cases.push(m.finish(
                format!("add and activate {activation:?} {used}x{channels}"),
                2e-6,
            ));
        }
        for masked in [false, true] {
            let (heads, d) = (pick(rng, &[1, 2, 4]), pick(rng, &[4, 16, 64]));
            let num_keys = pick(rng, &[0, 1, 15, 16, 33, 70]);
            let mut m = maker(rng, "attention");
            let q = m.rows("q", capacity, used, 1, heads * d);
            let kv = m.rows("kv", num_keys + 5, num_keys, 1, 2 * heads * d);
            let (k, v) = (
                kv.channel_range(0..heads * d),
                kv.channel_range(heads * d..2 * heads * d),
            );
            let Rows::Counted { count, .. } = kv.rows else {
                unreachable!("rows are counted")
            };
            let keep = masked.then(|| {
                m.inputs.push(("keep".to_owned(), num_keys));
                m.g.input_rows("keep", count, 1)
            });
            let y =
                m.g.attention([q, k, v], heads, 1.0 / (d as f32).sqrt(), keep);
            m.g.output("y", y);
            cases.push(m.finish(
                format!("attention {used}x{num_keys} {heads} heads of {d} masked {masked}"),
                1e-5,
            ));
        }
        let (heads, c) = (pick(rng, &[1, 4]), pick(rng, &[8, 64, 100]));
        let mut m = maker(rng, "token_pool");
        let tokens = m.rows("tokens", capacity, used, 12, c);
        let Rows::Counted { count, .. } = tokens.rows else {
            unreachable!("rows are counted")
        };
        m.inputs.push(("u".to_owned(), used * heads * c));
        let u = m.g.input_rows("u", count, heads * c);
        let y = m.g.token_pool(u, tokens, heads, 0.3);
        m.g.output("y", y);
        cases.push(m.finish(format!("token_pool {used}x{heads}x{c}"), 1e-5));

        let (anchors, values, d) = (
            pick(rng, &[1, 2, 16, 33, 200]),
            pick(rng, &[3, 6]),
            pick(rng, &[4, 32, 64]),
        );
        let mut m = maker(rng, "soft_choice");
        let x = m.rows("x", capacity, used, 1, d);
        let [chosen, statistics] = m.g.soft_choice(x, "a", anchors, values);
        m.g.output("chosen", chosen);
        m.g.output("statistics", statistics);
        cases.push(m.finish(format!("soft_choice {used} of {anchors}x{d}"), 2e-5));

        let mut m = maker(rng, "keep");
        let x = m.rows("x", capacity + 300, used + 250, 1, channels + 1);
        let [kept, index] = m.g.keep(
            x.channel_range(0..channels),
            x.channel_range(channels..channels + 1),
            0.2,
            "num_kept",
        );
        m.g.output("kept", kept);
        m.g.output("index", index);
        cases.push(m.finish(format!("keep of {} x {channels}", used + 250), 0.0));
    }
}
