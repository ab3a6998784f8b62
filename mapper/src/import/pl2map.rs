//! PL2Map (`v1`) and the paper's network (`proposed`).

use super::checkpoint::Checkpoint;
use super::{Converter, ImportError};
use landline::models::{
    AttentionLineConfig, AttentionOutput, AttentionPointConfig, LineBranchConfig,
    PointBranchConfig, RegressorConfig, V1Config,
};
use landline::nn::Weights;

/// What a checkpoint's tensors do not say.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportOptions {
    /// Attention heads.
    pub heads: usize,
    /// Samples along a segment, both ends included.
    pub tokens: usize,
    /// Confidence threshold of points; `None` for the published one.
    pub min_point_confidence: Option<f32>,
    /// Confidence threshold of segments; `None` for the published one.
    pub min_line_confidence: Option<f32>,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            heads: 4,
            tokens: 12,
            min_point_confidence: None,
            min_line_confidence: None,
        }
    }
}

/// Sizes that both networks share.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    width: usize,
    heads: usize,
    mlp_hidden: usize,
    encoder_hidden: usize,
}

impl Sizes {
    fn read(c: &Converter, layer: &str, encoder: &str, heads: usize) -> Result<Self, ImportError> {
        let [width, _] = c.matrix_size(&format!("{layer}.attn.merge.weight"))?;
        let [mlp_hidden, _] = c.matrix_size(&format!("{layer}.mlp.0.weight"))?;
        let [encoder_hidden, _] = c.matrix_size(&format!("{encoder}.pos_ffn.w_1.weight"))?;
        if heads == 0 || width == 0 || !width.is_multiple_of(heads) {
            return Err(ImportError::Heads { heads, width });
        }
        Ok(Self {
            width,
            heads,
            mlp_hidden,
            encoder_hidden,
        })
    }
}

/// Joint network.
pub(super) fn convert_v1(
    checkpoint: Checkpoint,
    options: &ImportOptions,
) -> Result<(RegressorConfig, Weights), ImportError> {
    let mut c = Converter::new("PL2Map", checkpoint);
    let encoder = "line_encoder.desc_layers.0";
    let sizes = Sizes::read(&c, "gnn.layers.0", encoder, options.heads)?;
    let num_layers = count_layers(&c, "gnn.layers");
    line_encoder(&mut c, encoder, sizes)?;
    for i in 0..num_layers {
        attention(
            &mut c,
            &format!("gnn.layers.{i}"),
            &format!("joint.attn.{i}"),
            sizes,
        )?;
    }
    let point_head_hidden = mlp(&mut c, "mapping_p", "point.head", sizes.width, 4)?;
    let line_head_hidden = mlp(&mut c, "mapping_l", "line.head", sizes.width, 7)?;
    let published = V1Config::paper();
    let config = RegressorConfig::V1(V1Config {
        descriptor_channels: sizes.width,
        tokens: options.tokens,
        width: sizes.width,
        heads: sizes.heads,
        encoder_hidden: sizes.encoder_hidden,
        num_layers,
        mlp_hidden: sizes.mlp_hidden,
        point_head_hidden,
        line_head_hidden,
        min_point_confidence: options
            .min_point_confidence
            .unwrap_or(published.min_point_confidence),
        min_line_confidence: options
            .min_line_confidence
            .unwrap_or(published.min_line_confidence),
    });
    let weights = c.finish(&[])?;
    config.check_weights(&weights)?;
    Ok((config, weights))
}

/// Two branches.
pub(super) fn convert_proposed(
    checkpoint: Checkpoint,
    options: &ImportOptions,
) -> Result<(RegressorConfig, Weights), ImportError> {
    let mut c = Converter::new("PL2Map++", checkpoint);
    let encoder = "l2s.line_encoder.desc_layers.0";
    let p = Sizes::read(&c, "d2s.gnn_rest.layers.0", encoder, options.heads)?;
    let l = Sizes::read(&c, "l2s.gnn1.layers.0", encoder, options.heads)?;
    let point_layers = count_layers(&c, "d2s.gnn_rest.layers");
    let line_layers = count_layers(&c, "l2s.gnn1.layers");
    for i in 0..point_layers {
        attention(
            &mut c,
            &format!("d2s.gnn_rest.layers.{i}"),
            &format!("point.attn.{i}"),
            p,
        )?;
    }
    let point_prune = prune(&mut c, "d2s.predict_mask", "point.prune", p.width)?;
    let point_head = mlp(&mut c, "d2s.mapping_p", "point.head", p.width, 3)?;
    line_encoder(&mut c, encoder, l)?;
    for i in 0..line_layers {
        attention(
            &mut c,
            &format!("l2s.gnn1.layers.{i}"),
            &format!("line.attn.{i}"),
            l,
        )?;
    }
    let line_prune = prune(&mut c, "l2s.predict_mask", "line.prune", l.width)?;
    let line_head = mlp(&mut c, "l2s.mapping_l", "line.head", l.width, 6)?;
    let config = RegressorConfig::Branches {
        point: PointBranchConfig::Attention(AttentionPointConfig {
            descriptor_channels: p.width,
            width: p.width,
            heads: p.heads,
            num_layers: point_layers,
            mlp_hidden: p.mlp_hidden,
            prune_hidden: point_prune,
            head_hidden: point_head,
            min_confidence: options.min_point_confidence.unwrap_or(0.8),
            output: AttentionOutput::Linear,
        }),
        line: Some(LineBranchConfig::Attention(AttentionLineConfig {
            descriptor_channels: l.width,
            tokens: options.tokens,
            width: l.width,
            heads: l.heads,
            encoder_hidden: l.encoder_hidden,
            num_layers: line_layers,
            mlp_hidden: l.mlp_hidden,
            prune_hidden: line_prune,
            head_hidden: line_head,
            min_confidence: options.min_line_confidence.unwrap_or(0.01),
            output: AttentionOutput::Linear,
        })),
    };
    let weights = c.finish(&[])?;
    config.check_weights(&weights)?;
    Ok((config, weights))
}

fn count_layers(c: &Converter, prefix: &str) -> usize {
    (0..64)
        .take_while(|i| {
            c.tensors
                .contains_key(&format!("{prefix}.{i}.attn.merge.weight"))
        })
        .count()
}

/// The reference interleaves heads (`channel = 4 d + head`); ours are contiguous (`channel = d_head * head + d`).
fn contiguous_from_interleaved(width: usize, heads: usize) -> Vec<usize> {
    let dh = width / heads;
    (0..width)
        .map(|new| (new % dh) * heads + new / dh)
        .collect()
}

fn attention(c: &mut Converter, foreign: &str, ours: &str, s: Sizes) -> Result<(), ImportError> {
    let d = s.width;
    let order = contiguous_from_interleaved(d, s.heads);
    for (theirs, part) in [("proj.0", "q"), ("proj.1", "k"), ("proj.2", "v")] {
        let w = c.take_shaped(&format!("{foreign}.attn.{theirs}.weight"), &[d, d])?;
        let b = c.take_shaped(&format!("{foreign}.attn.{theirs}.bias"), &[d])?;
        let rows = order
            .iter()
            .flat_map(|old| w[old * d..(old + 1) * d].iter().copied())
            .collect();
        c.put(format!("{ours}.{part}.w"), &[d, d], rows)?;
        c.put(
            format!("{ours}.{part}.b"),
            &[d],
            order.iter().map(|old| b[*old]).collect(),
        )?;
    }
    let w = c.take_shaped(&format!("{foreign}.attn.merge.weight"), &[d, d])?;
    let columns = w
        .chunks_exact(d)
        .flat_map(|row| order.iter().map(|old| row[*old]))
        .collect();
    c.put(format!("{ours}.o.w"), &[d, d], columns)?;
    let b = c.take_shaped(&format!("{foreign}.attn.merge.bias"), &[d])?;
    c.put(format!("{ours}.o.b"), &[d], b)?;
    c.linear(
        &format!("{foreign}.mlp.0"),
        &format!("{ours}.ffn.0"),
        s.mlp_hidden,
        2 * d,
    )?;
    c.linear(
        &format!("{foreign}.mlp.2"),
        &format!("{ours}.ffn.1"),
        d,
        s.mlp_hidden,
    )
}

/// The line encoder's heads are contiguous already.
fn line_encoder(c: &mut Converter, foreign: &str, s: Sizes) -> Result<(), ImportError> {
    let d = s.width;
    for (theirs, ours) in [("w_qs", "q"), ("w_ks", "k"), ("w_vs", "v"), ("fc", "o")] {
        c.linear(
            &format!("{foreign}.slf_attn.{theirs}"),
            &format!("line.enc.{ours}"),
            d,
            d,
        )?;
    }
    for (theirs, ours) in [("slf_attn", "ln1"), ("pos_ffn", "ln2")] {
        for (part, name) in [("weight", "g"), ("bias", "b")] {
            let v = c.take_shaped(&format!("{foreign}.{theirs}.layer_norm.{part}"), &[d])?;
            c.put(format!("line.enc.{ours}.{name}"), &[d], v)?;
        }
    }
    c.linear(
        &format!("{foreign}.pos_ffn.w_1"),
        "line.enc.ff1",
        s.encoder_hidden,
        d,
    )?;
    c.linear(
        &format!("{foreign}.pos_ffn.w_2"),
        "line.enc.ff2",
        d,
        s.encoder_hidden,
    )
}

fn prune(c: &mut Converter, foreign: &str, ours: &str, width: usize) -> Result<usize, ImportError> {
    let hidden = mlp(c, foreign, ours, width, 1)?;
    Ok(hidden.first().copied().unwrap_or(0))
}

/// Layers with even indices (activations lie between). Returns the hidden widths.
fn mlp(
    c: &mut Converter,
    foreign: &str,
    ours: &str,
    input: usize,
    out: usize,
) -> Result<Vec<usize>, ImportError> {
    let mut hidden = Vec::new();
    let mut width = input;
    for i in 0..16 {
        let name = format!("{foreign}.{}", 2 * i);
        let last = !c
            .tensors
            .contains_key(&format!("{foreign}.{}.weight", 2 * i + 2));
        let [rows, _] = c.matrix_size(&format!("{name}.weight"))?;
        let rows = if last { out } else { rows };
        c.linear(&name, &format!("{ours}.{i}"), rows, width)?;
        if last {
            break;
        }
        hidden.push(rows);
        width = rows;
    }
    Ok(hidden)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn head_order_is_a_permutation_that_gathers_each_head() {
        let order = contiguous_from_interleaved(12, 4);
        assert_eq!(order, [0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11]);
    }
}
