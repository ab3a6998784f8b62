//! Weights as the device holds them: one run of 32-bit words, matrices in 16 bits where that changes no number.
//!
//! Files come in 16 bits (the packaged extractor does, scene files may), so such matrices go to the device as they are in
//! the file, at half the bytes. Those of 8-bit files are no 16-bit numbers and take 32.
//! WebGPU widens 16-bit numbers exactly on every device (`unpack2x16float`); no optional feature is needed.

use half::f16;

use crate::nn::{Graph, NnError, Op, Weights};

/// Which matrices are stored in 16 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WeightStorage {
    /// None: for devices whose self-test fails with the others.
    Single,
    /// Those whose numbers all are 16-bit numbers already: every result stays as it is.
    #[default]
    Exact,
}

/// Where a weight lies among the words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct WeightPlace {
    /// Its first word.
    pub(super) word: usize,
    /// Two numbers to a word.
    pub(super) is_half: bool,
    /// Bytes of it.
    pub(super) bytes: usize,
}

/// All weights of a graph.
#[derive(Debug, Clone, Default)]
pub(super) struct PackedWeights {
    pub(super) words: Vec<u32>,
    /// By [`crate::nn::shape::WeightId`].
    pub(super) places: Vec<WeightPlace>,
}

/// How an operation reads a weight.
#[derive(Debug, Clone, Copy, Default)]
struct Use {
    is_conv: bool,
    is_matrix: bool,
}

fn uses(graph: &Graph) -> Vec<Use> {
    let mut uses = vec![Use::default(); graph.weights().len()];
    for node in graph.nodes() {
        match &node.op {
            Op::Conv3x3 { weight, .. } => {
                uses[weight.0] = Use {
                    is_conv: true,
                    is_matrix: true,
                };
            }
            // One number a channel is no matrix: its kernels read 32 bits.
            Op::Linear { weight, .. } => {
                uses[weight.0].is_matrix = graph.weight(*weight).shape.last() != Some(&1);
            }
            Op::SoftChoice { keys, values, .. } => {
                uses[keys.0].is_matrix = true;
                uses[values.0].is_matrix = true;
            }
            _ => {}
        }
    }
    uses
}

/// Weights of a convolution from `[out, in, 3, 3]` to `[out, 3 * 3, in]`: the order in which the kernels walk them.
fn tap_major(weight: &[f32], in_channels: usize) -> Vec<f32> {
    let mut packed = Vec::with_capacity(weight.len());
    for of_output in weight.chunks_exact(9 * in_channels) {
        for tap in 0..9 {
            packed.extend((0..in_channels).map(|channel| of_output[channel * 9 + tap]));
        }
    }
    packed
}

fn is_exact(numbers: &[f32]) -> bool {
    numbers
        .iter()
        .all(|x| f16::from_f32(*x).to_f32().to_bits() == x.to_bits())
}

impl PackedWeights {
    /// Takes the weights that a graph needs.
    ///
    /// # Errors
    /// Those of [`Weights::take_f32`].
    pub(super) fn new(
        graph: &Graph,
        mut weights: Weights,
        storage: WeightStorage,
    ) -> Result<Self, NnError> {
        let mut packed = Self::default();
        for (spec, how) in graph.weights().iter().zip(uses(graph)) {
            let mut numbers = weights.take_f32(&spec.name, &spec.shape)?;
            if how.is_conv {
                numbers = tap_major(&numbers, spec.shape[1]);
            }
            let is_half = how.is_matrix && storage == WeightStorage::Exact && is_exact(&numbers);
            let word = packed.words.len();
            if is_half {
                packed.words.extend(numbers.chunks(2).map(|pair| {
                    let bits = |x: Option<&f32>| {
                        u32::from(f16::from_f32(x.copied().unwrap_or(0.0)).to_bits())
                    };
                    bits(pair.first()) | (bits(pair.get(1)) << 16)
                }));
            } else {
                packed.words.extend(numbers.iter().map(|x| x.to_bits()));
            }
            packed.places.push(WeightPlace {
                word,
                is_half,
                bytes: 4 * (packed.words.len() - word),
            });
        }
        Ok(packed)
    }

    /// Bytes of all words.
    pub(super) fn bytes(&self) -> u64 {
        4 * self.words.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Dense, GraphBuilder, WeightTensor};

    #[test]
    fn convolution_weights_are_packed_tap_by_tap() {
        let weight: Vec<f32> = (0..18).map(|n| n as f32).collect();
        let packed = tap_major(&weight, 2);
        assert_eq!(packed[..6], [0.0, 9.0, 1.0, 10.0, 2.0, 11.0]);
    }

    fn one_layer(numbers: Vec<f32>) -> (Graph, Weights) {
        let mut g = GraphBuilder::new("one");
        let n = g.count("n", 1);
        let x = g.input_rows("x", n, 3);
        let y = g.linear(x, Dense::new("l", 1));
        g.output("y", y);
        let mut weights = Weights::new();
        weights.insert(
            "l.w",
            WeightTensor::f32(&[1, 3], numbers).expect("lengths agree"),
        );
        weights.insert(
            "l.b",
            WeightTensor::f32(&[1], vec![0.5]).expect("lengths agree"),
        );
        (g.finish().expect("a valid graph"), weights)
    }

    #[test]
    fn only_matrices_that_lose_nothing_take_half_the_room() {
        let layer = |numbers: [f32; 3], storage| {
            let (graph, weights) = one_layer(numbers.to_vec());
            let packed = PackedWeights::new(&graph, weights, storage).expect("fits");
            (packed.places[0].is_half, packed.words)
        };
        let exact = [1.0, -0.25, 6.1e-5];
        let exact = exact.map(|x: f32| f16::from_f32(x).to_f32());
        let (is_half, words) = layer(exact, WeightStorage::Exact);
        assert!(is_half);
        assert_eq!(words.len(), 3);
        assert_eq!(words[0], 0xb400_3c00);
        assert_eq!(words[2], 0.5_f32.to_bits());
        assert!(!layer(exact, WeightStorage::Single).0);
        assert!(!layer([1.0, 0.1, 2.0], WeightStorage::Exact).0);
        assert!(!layer([1.0, 1e6, 2.0], WeightStorage::Exact).0);
    }
}
