//! The layers of every network in plain f64, one row at a time, from their definitions.

use super::Rows;
use crate::nn::Weights;

/// Reference layers on the file's own tensors.
pub(super) struct Long<'a>(pub(super) &'a Weights);

impl Long<'_> {
    pub(super) fn get(&self, name: &str) -> Vec<f64> {
        let t = self.0.get(name).expect("tensor of the configuration");
        t.to_f32().into_iter().map(f64::from).collect()
    }

    pub(super) fn linear(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let (w, b) = (
            self.get(&format!("{name}.w")),
            self.get(&format!("{name}.b")),
        );
        w.chunks_exact(x.len())
            .zip(b)
            .map(|(row, b)| row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b)
            .collect()
    }

    pub(super) fn mlp(&self, name: &str, num: usize, x: &[f64]) -> Vec<f64> {
        let mut y = x.to_vec();
        for i in 0..num {
            y = self.linear(&format!("{name}.{i}"), &y);
            if i + 1 < num {
                y.iter_mut().for_each(|v| *v = v.max(0.0));
            }
        }
        y
    }

    pub(super) fn layer_norm(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let n = x.len() as f64;
        let mean = x.iter().sum::<f64>() / n;
        let variance = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        let (g, b) = (
            self.get(&format!("{name}.g")),
            self.get(&format!("{name}.b")),
        );
        x.iter()
            .zip(g.iter().zip(&b))
            .map(|(v, (g, b))| (v - mean) / (variance + 1e-6).sqrt() * g + b)
            .collect()
    }

    /// Attention of every row of `x` over `source`, with all biases, before the output projection.
    pub(super) fn attend(&self, name: &str, x: &Rows, source: &Rows, heads: usize) -> Rows {
        let project = |part: &str, rows: &Rows| -> Rows {
            rows.iter()
                .map(|r| self.linear(&format!("{name}.{part}"), r))
                .collect()
        };
        let (q, k, v) = (project("q", x), project("k", source), project("v", source));
        q.iter()
            .map(|q| {
                let dh = q.len() / heads;
                let mut out = vec![0.0; q.len()];
                for h in 0..heads {
                    let block = h * dh..(h + 1) * dh;
                    let scores: Vec<f64> = k
                        .iter()
                        .map(|k| {
                            let dot = q[block.clone()].iter().zip(&k[block.clone()]);
                            dot.map(|(a, b)| a * b).sum::<f64>() / (dh as f64).sqrt()
                        })
                        .collect();
                    let p = softmax(&scores);
                    for (p, v) in p.iter().zip(&v) {
                        for c in block.clone() {
                            out[c] += p * v[c];
                        }
                    }
                }
                out
            })
            .collect()
    }

    pub(super) fn attention_layer(
        &self,
        name: &str,
        x: &Rows,
        source: &Rows,
        heads: usize,
    ) -> Rows {
        let attended = self.attend(name, x, source, heads);
        x.iter()
            .zip(attended)
            .map(|(x, a)| {
                let message = self.linear(&format!("{name}.o"), &a);
                let joined: Vec<f64> = x.iter().chain(&message).copied().collect();
                let delta = self.mlp(&format!("{name}.ffn"), 2, &joined);
                x.iter().zip(delta).map(|(a, b)| a + b).collect()
            })
            .collect()
    }

    /// One transformer layer over all tokens of a segment; the first token's output.
    pub(super) fn line_encoder(&self, tokens: &Rows, heads: usize, has_input: bool) -> Vec<f64> {
        let x: Rows = if has_input {
            tokens.iter().map(|t| self.linear("line.in", t)).collect()
        } else {
            tokens.clone()
        };
        let attended = self.attend("line.enc", &x, &x, heads);
        let all: Rows = x
            .iter()
            .zip(attended)
            .map(|(x, a)| {
                let o = self.linear("line.enc.o", &a);
                let sum: Vec<f64> = x.iter().zip(o).map(|(a, b)| a + b).collect();
                let y = self.layer_norm("line.enc.ln1", &sum);
                let hidden: Vec<f64> = self
                    .linear("line.enc.ff1", &y)
                    .into_iter()
                    .map(gelu)
                    .collect();
                let z = self.linear("line.enc.ff2", &hidden);
                let sum: Vec<f64> = y.iter().zip(z).map(|(a, b)| a + b).collect();
                self.layer_norm("line.enc.ln2", &sum)
            })
            .collect();
        all[0].clone()
    }

    /// Coordinates and reliability logit of the anchored networks for a unit descriptor.
    pub(super) fn anchored(
        &self,
        prefix: &str,
        values: &str,
        num_values: usize,
        x: &[f64],
    ) -> (Vec<f64>, f64) {
        let keys = self.get(&format!("{prefix}.anchor.keys"));
        let values = self.get(&format!("{prefix}.anchor.{values}"));
        let sharpness = self.get(&format!("{prefix}.anchor.sharpness"))[0];
        let similarities: Vec<f64> = keys
            .chunks_exact(x.len())
            .map(|k| {
                let norm = k.iter().map(|v| v * v).sum::<f64>().sqrt();
                k.iter().zip(x).map(|(a, b)| a * b).sum::<f64>() / norm
            })
            .collect();
        let p = softmax(
            &similarities
                .iter()
                .map(|s| s * sharpness)
                .collect::<Vec<_>>(),
        );
        let mut chosen = vec![0.0; num_values];
        for (p, v) in p.iter().zip(values.chunks_exact(num_values)) {
            for (c, v) in chosen.iter_mut().zip(v) {
                *c += p * v;
            }
        }
        let spread: f64 = p
            .iter()
            .zip(values.chunks_exact(num_values))
            .map(|(p, v)| {
                p * v
                    .iter()
                    .zip(&chosen)
                    .map(|(a, b)| (a - b).powi(2))
                    .sum::<f64>()
            })
            .sum();
        let mut sorted = similarities.clone();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let entropy: f64 = p.iter().filter(|p| **p > 0.0).map(|p| -p * p.ln()).sum();
        let statistics = [
            sorted[0],
            sorted[1],
            sorted[0] - sorted[1],
            entropy,
            spread.sqrt(),
        ];
        let joined: Vec<f64> = x.iter().chain(&statistics).copied().collect();
        if self.0.get(&format!("{prefix}.offset.0.w")).is_some() {
            let offset = self.mlp(&format!("{prefix}.offset"), 2, &joined);
            chosen.iter_mut().zip(offset).for_each(|(c, o)| *c += o);
        }
        (
            chosen,
            self.mlp(&format!("{prefix}.reliability"), 2, &joined)[0],
        )
    }
}

fn softmax(x: &[f64]) -> Vec<f64> {
    let largest = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let e: Vec<f64> = x.iter().map(|v| (v - largest).exp()).collect();
    let sum: f64 = e.iter().sum();
    e.iter().map(|v| v / sum).collect()
}

fn gelu(x: f64) -> f64 {
    0.5 * x * (1.0 + libm::erf(x / 2.0_f64.sqrt()))
}
