//! `landline features`: keypoints, segments and descriptors of one picture as a safetensors file.

use crate::files::write_bytes;
use crate::picture;
use crate::weights::load_extractor;
use anyhow::{Context as _, Result, bail};
use landline::features::FeatureSet;
use landline::front_end::{FrontEnd, FrontEndOptions};
use landline::models::{ExtractorKind, Sampler};
use landline::nn::{WeightTensor, Weights};
use landline::scene_file::{Element, serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Extract keypoints, line segments and descriptors of a picture.
///
/// The file has `keypoints` [n, 2], `scores` [n], `descriptors` [n, d], `segments` [l, 4] (start and end) and
/// `segment_descriptors` [l, samples, d]. Positions are corner-based pixels of the picture: the centre of the first pixel is
/// (0.5, 0.5).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The picture.
    image: PathBuf,
    /// The weights: a converted file or an original checkpoint.
    #[arg(long)]
    weights: PathBuf,
    /// Refuse weights of another extractor: xfeat, superpoint (either), superpoint-v1 or superpoint-open.
    #[arg(long, value_name = "NAME")]
    extractor: Option<String>,
    /// Most keypoints.
    #[arg(long, default_value_t = 1024)]
    top_k: usize,
    /// Most segments; the longest are kept.
    #[arg(long, default_value_t = 512)]
    max_segments: usize,
    /// Shorter segments are left out; pixels of the picture that is looked at.
    #[arg(long, default_value_t = 0.0)]
    min_segment_px: f64,
    /// Longest side of the picture that is looked at; larger pictures are reduced.
    #[arg(long, default_value_t = 1024)]
    max_side: usize,
    /// How descriptors are read: xfeat, legacy or exact. Default: the extractor's own.
    #[arg(long)]
    sampler: Option<String>,
    /// The file to write.
    #[arg(long, short)]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// When the picture or the weights cannot be read, or the file cannot be written.
pub fn run(args: Args) -> Result<()> {
    let file = load_extractor(&args.weights)?;
    if let Some(expected) = &args.extractor {
        let superpoint = expected == "superpoint" && file.kind != ExtractorKind::Xfeat;
        if file.kind.name() != expected && !superpoint {
            bail!(
                "{} holds {}, not {expected}",
                args.weights.display(),
                file.kind.name()
            );
        }
    }
    let mut options = FrontEndOptions::new(file.kind);
    options.keypoints.max_keypoints = args.top_k;
    options.max_segments = args.max_segments;
    options.max_side = args.max_side;
    options.min_segment_px = args.min_segment_px;
    if let Some(name) = &args.sampler {
        options.sampler = Sampler::from_name(name).with_context(|| {
            format!("unknown sampler {name:?}; there are xfeat, legacy and exact")
        })?;
    }
    let gray = picture::read_gray(&args.image)?;
    let frame = gray.frame();
    let (kind, sha256) = (file.kind, file.source_sha256.clone());
    let mut front_end = FrontEnd::new(file, options)?;
    let mut features = front_end
        .run(&frame)
        .with_context(|| format!("picture {}", args.image.display()))?
        .clone();
    features.map_pixels(&front_end.working_from_sensor().inverse());

    let metadata: BTreeMap<String, String> = [
        ("extractor", kind.name().to_owned()),
        ("extractor_sha256", sha256),
        ("sampler", options.sampler.name().to_owned()),
        ("image_size", format!("{}x{}", gray.width, gray.height)),
        ("pixels", "corner-based".to_owned()),
    ]
    .into_iter()
    .map(|(key, value)| (key.to_owned(), value))
    .collect();
    let bytes = serialize(&metadata, &tensors(&features)?, |_, _| Element::F32)?;
    write_bytes(&args.out, &bytes)?;
    println!(
        "{}: {} keypoints, {} segments",
        args.out.display(),
        features.keypoints.len(),
        features.segments.len()
    );
    Ok(())
}

fn tensors(f: &FeatureSet) -> Result<Weights> {
    let (n, l, d) = (f.keypoints.len(), f.segments.len(), f.descriptor_channels);
    let pixels = f.keypoints.iter().flat_map(|k| [k.pixel.x, k.pixel.y]);
    let ends = f
        .segments
        .iter()
        .flat_map(|s| [s.start.x, s.start.y, s.end.x, s.end.y]);
    let mut out = Weights::new();
    let mut put = |name: &str, shape: &[usize], data: Vec<f32>| -> Result<()> {
        out.insert(name, WeightTensor::f32(shape, data)?);
        Ok(())
    };
    put("keypoints", &[n, 2], pixels.map(|x| x as f32).collect())?;
    put(
        "scores",
        &[n],
        f.keypoints.iter().map(|k| k.score).collect(),
    )?;
    put("descriptors", &[n, d], f.descriptors_nd.clone())?;
    put("segments", &[l, 4], ends.map(|x| x as f32).collect())?;
    put(
        "segment_descriptors",
        &[l, f.tokens, d],
        f.segment_descriptors_nsd.clone(),
    )?;
    Ok(out)
}
