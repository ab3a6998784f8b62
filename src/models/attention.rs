//! Building blocks shared by `proposed` and `v1`: the attention layer, the line encoder, the MLP.
//!
//! Attention layer: `x + MLP([x ; merge(attention(x, source))])`, ReLU inside, no normalisation ([pl2map2025], SuperGlue's
//! layer). Heads are contiguous channel blocks. Line encoder: one post-norm transformer layer over the tokens of a segment,
//! of which only the first token's output is used.

use super::config::Specs;
use super::error::ModelError;
use super::fold::{Matrix, add, to_f32, to_f64};
use crate::nn::{Activation, Dense, GraphBuilder, NnError, Tensor, WeightTensor, Weights};

/// Epsilon of the line encoder's layer norms in the reference.
pub(super) const LAYER_NORM_EPS: f32 = 1e-6;

/// Takes `NAME.w` and `NAME.b` out of the file's tensors.
pub(super) fn take_linear(
    weights: &mut Weights,
    name: &str,
    out: usize,
    input: usize,
) -> Result<(Matrix, Vec<f64>), ModelError> {
    let w = weights.take_f32(&format!("{name}.w"), &[out, input])?;
    let b = weights.take_f32(&format!("{name}.b"), &[out])?;
    Ok((Matrix::from_f32(out, input, &w), to_f64(&b)))
}

/// Puts a matrix among the graph's weights.
pub(super) fn put_matrix(
    made: &mut Weights,
    name: &str,
    matrix: &Matrix,
) -> Result<(), ModelError> {
    let tensor = WeightTensor::f32(&[matrix.rows, matrix.cols], to_f32(&matrix.data))?;
    made.insert(name, tensor);
    Ok(())
}

/// Puts a vector among the graph's weights.
pub(super) fn put_vector(made: &mut Weights, name: &str, v: &[f64]) -> Result<(), ModelError> {
    made.insert(name, WeightTensor::f32(&[v.len()], to_f32(v))?);
    Ok(())
}

/// Moves a tensor that the graph uses as it is, in the precision that it has. The executor checks that it is finite.
pub(super) fn pass(
    weights: &mut Weights,
    made: &mut Weights,
    name: &str,
    shape: &[usize],
) -> Result<(), ModelError> {
    let Some(tensor) = weights.remove(name) else {
        return Err(NnError::MissingWeight {
            name: name.to_owned(),
            expected: shape.to_vec(),
        }
        .into());
    };
    if tensor.shape() != shape {
        return Err(NnError::WeightShape {
            name: name.to_owned(),
            found: tensor.shape().to_vec(),
            expected: shape.to_vec(),
        }
        .into());
    }
    made.insert(name, tensor);
    Ok(())
}

/// Moves `NAME.w` and `NAME.b`.
pub(super) fn pass_linear(
    weights: &mut Weights,
    made: &mut Weights,
    name: &str,
    out: usize,
    input: usize,
) -> Result<(), ModelError> {
    pass(weights, made, &format!("{name}.w"), &[out, input])?;
    pass(weights, made, &format!("{name}.b"), &[out])
}

/// Linear layers with ReLU between them, none after the last.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mlp<'a> {
    pub(super) name: &'a str,
    pub(super) widths: &'a [usize],
}

impl Mlp<'_> {
    pub(super) fn pass(&self, weights: &mut Weights, made: &mut Weights) -> Result<(), ModelError> {
        for (i, pair) in self.widths.windows(2).enumerate() {
            pass_linear(
                weights,
                made,
                &format!("{}.{i}", self.name),
                pair[1],
                pair[0],
            )?;
        }
        Ok(())
    }

    pub(super) fn graph(&self, g: &mut GraphBuilder, x: Tensor) -> Tensor {
        self.graph_onto(g, x, None)
    }

    /// The MLP's output added to `base`.
    pub(super) fn graph_onto(
        &self,
        g: &mut GraphBuilder,
        x: Tensor,
        base: Option<Tensor>,
    ) -> Tensor {
        let last = self.widths.len() - 2;
        let mut y = x;
        for (i, width) in self.widths[1..].iter().enumerate() {
            let name = format!("{}.{i}", self.name);
            let layer = Dense::new(&name, *width);
            let layer = match base {
                _ if i < last => layer.activation(Activation::Relu),
                Some(base) => layer.residual(base),
                None => layer,
            };
            y = g.linear(y, layer);
        }
        y
    }
}

/// Widths of an MLP: input, hidden ones, output.
pub(super) fn widths(input: usize, hidden: &[usize], out: usize) -> Vec<usize> {
    let mut all = vec![input];
    all.extend_from_slice(hidden);
    all.push(out);
    all
}

/// Sizes of an attention layer.
#[derive(Debug, Clone, Copy)]
pub(super) struct AttentionLayer {
    pub(super) width: usize,
    pub(super) heads: usize,
    pub(super) mlp_hidden: usize,
}

impl AttentionLayer {
    pub(super) fn tensors(&self, specs: &mut Specs, name: &str) {
        let d = self.width;
        for part in ["q", "k", "v", "o"] {
            specs.linear(&format!("{name}.{part}"), d, d);
        }
        specs.linear(&format!("{name}.ffn.0"), self.mlp_hidden, 2 * d);
        specs.linear(&format!("{name}.ffn.1"), d, self.mlp_hidden);
    }

    /// Stacks q, k and v into one product; drops the key bias (it shifts all scores of a query alike); folds the merge `o`
    /// into the message half of the first MLP layer.
    pub(super) fn prepare(
        &self,
        weights: &mut Weights,
        made: &mut Weights,
        name: &str,
    ) -> Result<(), ModelError> {
        let d = self.width;
        let (wq, bq) = take_linear(weights, &format!("{name}.q"), d, d)?;
        let (wk, _) = take_linear(weights, &format!("{name}.k"), d, d)?;
        let (wv, bv) = take_linear(weights, &format!("{name}.v"), d, d)?;
        let (wo, bo) = take_linear(weights, &format!("{name}.o"), d, d)?;
        let (w0, b0) = take_linear(weights, &format!("{name}.ffn.0"), self.mlp_hidden, 2 * d)?;
        put_matrix(
            made,
            &format!("{name}.qkv.w"),
            &wq.stacked(&wk).stacked(&wv),
        )?;
        let bias: Vec<f64> = bq.iter().copied().chain(vec![0.0; d]).chain(bv).collect();
        put_vector(made, &format!("{name}.qkv.b"), &bias)?;
        put_matrix(made, &format!("{name}.own.w"), &w0.columns(0, d))?;
        let message = w0.columns(d, 2 * d);
        put_matrix(made, &format!("{name}.message.w"), &message.mul(&wo))?;
        put_vector(
            made,
            &format!("{name}.message.b"),
            &add(&b0, &message.mul_vec(&bo)),
        )?;
        pass_linear(weights, made, &format!("{name}.ffn.1"), d, self.mlp_hidden)
    }

    /// Query, keys and values of one stream.
    pub(super) fn project(&self, g: &mut GraphBuilder, name: &str, x: Tensor) -> [Tensor; 3] {
        let d = self.width;
        let qkv = g.linear(x, Dense::new(&format!("{name}.qkv"), 3 * d));
        [
            qkv.channel_range(0..d),
            qkv.channel_range(d..2 * d),
            qkv.channel_range(2 * d..3 * d),
        ]
    }

    /// The layer's output for `x`, given its query and the source's keys and values, and which of these take part.
    pub(super) fn update(
        &self,
        g: &mut GraphBuilder,
        name: &str,
        x: Tensor,
        qkv: [Tensor; 3],
        keep: Option<Tensor>,
    ) -> Tensor {
        let scale = 1.0 / ((self.width / self.heads) as f32).sqrt();
        let message = g.attention(qkv, self.heads, scale, keep);
        let own = g.linear(
            x,
            Dense::new(&format!("{name}.own"), self.mlp_hidden).without_bias(),
        );
        let hidden = g.linear(
            message,
            Dense::new(&format!("{name}.message"), self.mlp_hidden)
                .residual(own)
                .activation(Activation::Relu),
        );
        g.linear(
            hidden,
            Dense::new(&format!("{name}.ffn.1"), self.width).residual(x),
        )
    }

    /// Self-attention; `keep` is positive for rows that others attend to.
    pub(super) fn graph(
        &self,
        g: &mut GraphBuilder,
        name: &str,
        x: Tensor,
        keep: Option<Tensor>,
    ) -> Tensor {
        let qkv = self.project(g, name, x);
        self.update(g, name, x, qkv, keep)
    }
}

/// Sizes of the line encoder. `input` differs from `width` when there is an input layer.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineEncoder {
    pub(super) input: usize,
    pub(super) width: usize,
    pub(super) heads: usize,
    pub(super) hidden: usize,
    pub(super) tokens: usize,
}

impl LineEncoder {
    pub(super) fn has_input_layer(&self) -> bool {
        self.input != self.width
    }

    pub(super) fn tensors(&self, specs: &mut Specs) {
        let d = self.width;
        if self.has_input_layer() {
            specs.linear("line.in", d, self.input);
        }
        for part in ["q", "k", "v", "o"] {
            specs.linear(&format!("line.enc.{part}"), d, d);
        }
        for norm in ["ln1", "ln2"] {
            specs.add(format!("line.enc.{norm}.g"), &[d]);
            specs.add(format!("line.enc.{norm}.b"), &[d]);
        }
        specs.linear("line.enc.ff1", self.hidden, d);
        specs.linear("line.enc.ff2", d, self.hidden);
    }

    /// Only the first token asks, so its score with token `j` is `(Wk_h^T q_h) . x_j` and the values can be averaged before
    /// they are projected. The input layer folds into both, so the tokens keep the descriptor's own size. The value bias
    /// folds into the output (probabilities sum to one) and the key bias drops out.
    pub(super) fn prepare(
        &self,
        weights: &mut Weights,
        made: &mut Weights,
    ) -> Result<(), ModelError> {
        let (d, heads) = (self.width, self.heads);
        let dh = d / heads;
        let input = if self.has_input_layer() {
            let (w, b) = take_linear(weights, "line.in", d, self.input)?;
            put_matrix(made, "line.in.w", &w)?;
            put_vector(made, "line.in.b", &b)?;
            Some((w, b))
        } else {
            None
        };
        let fold = |w: Matrix, b: Vec<f64>| match &input {
            Some((w_in, b_in)) => (w.mul(w_in), add(&w.mul_vec(b_in), &b)),
            None => (w, b),
        };
        let (wq, bq) = take_linear(weights, "line.enc.q", d, d)?;
        let (wq, bq) = fold(wq, bq);
        put_matrix(made, "line.enc.query.w", &wq)?;
        put_vector(made, "line.enc.query.b", &bq)?;

        let (wk, bk) = take_linear(weights, "line.enc.k", d, d)?;
        let (wk, _) = fold(wk, bk);
        let mut key = Matrix::zeros(0, dh);
        for h in 0..heads {
            key = key.stacked(&wk.row_range(h * dh, (h + 1) * dh).transposed());
        }
        put_matrix(made, "line.enc.key.w", &key)?;

        let (wv, bv) = take_linear(weights, "line.enc.v", d, d)?;
        let (wv, bv) = fold(wv, bv);
        put_matrix(made, "line.enc.value.w", &wv)?;
        let (wo, bo) = take_linear(weights, "line.enc.o", d, d)?;
        put_matrix(made, "line.enc.o.w", &wo)?;
        put_vector(made, "line.enc.o.b", &add(&wo.mul_vec(&bv), &bo))?;
        for norm in ["ln1", "ln2"] {
            pass(weights, made, &format!("line.enc.{norm}.g"), &[d])?;
            pass(weights, made, &format!("line.enc.{norm}.b"), &[d])?;
        }
        pass_linear(weights, made, "line.enc.ff1", self.hidden, d)?;
        pass_linear(weights, made, "line.enc.ff2", d, self.hidden)
    }

    /// From the tokens of each segment to one descriptor of `width`.
    pub(super) fn graph(&self, g: &mut GraphBuilder, tokens: Tensor) -> Tensor {
        let (d, heads) = (self.width, self.heads);
        let scale = 1.0 / ((d / heads) as f32).sqrt();
        let first = g.join_rows(tokens, self.tokens);
        let first = if first.channels >= self.input {
            first.channel_range(0..self.input)
        } else {
            first
        };
        let own = if self.has_input_layer() {
            g.linear(first, Dense::new("line.in", d))
        } else {
            first
        };
        let query = g.linear(first, Dense::new("line.enc.query", d));
        let asked = g.linear(
            query,
            Dense::new("line.enc.key", heads * self.input)
                .groups(heads)
                .without_bias(),
        );
        let mean = g.token_pool(asked, tokens, heads, scale);
        let value = g.linear(
            mean,
            Dense::new("line.enc.value", d).groups(heads).without_bias(),
        );
        let merged = g.linear(value, Dense::new("line.enc.o", d).residual(own));
        let normed = g.layer_norm(merged, "line.enc.ln1", LAYER_NORM_EPS);
        let hidden = g.linear(
            normed,
            Dense::new("line.enc.ff1", self.hidden).activation(Activation::Gelu),
        );
        let out = g.linear(hidden, Dense::new("line.enc.ff2", d).residual(normed));
        g.layer_norm(out, "line.enc.ln2", LAYER_NORM_EPS)
    }
}

/// The logit above which an element's probability exceeds `probability`; all are kept at zero.
pub(super) fn min_logit(probability: f32) -> f32 {
    if probability <= 0.0 {
        return f32::MIN;
    }
    let p = f64::from(probability);
    libm::log(p / (1.0 - p)) as f32
}
