//! Teaches and evaluates one scene, or takes the result of an earlier run.

use crate::dataset::{Dataset, DatasetImage, Split};
use crate::eval::{EvalOptions, Evaluator, Landmarks, baseline_size};
use crate::extract::Extraction;
use crate::files::write_bytes;
use crate::import::sha256_hex;
use crate::progress::Progress;
use crate::scene::relocalizer;
use crate::teach::{Observer, Request, teach};
use anyhow::{Context, Result};
use landline::scene_file::SceneFile;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Instant;

/// Figures of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Of what they were measured: pictures, poses, extractor, options.
    pub identity: String,
    /// Pictures that taught.
    pub num_train: usize,
    /// Pictures that tested.
    pub num_test: usize,
    /// Name of each method; median position in centimetres and rotation in degrees, none where half of the pictures were not
    /// located; recall at 5 cm and 5 degrees in percent. The scene's own way comes first.
    pub methods: Vec<(String, [Option<f64>; 3])>,
    /// Mean time from a picture to 3D points and lines.
    pub forward_ms: f64,
    /// Mean time from those to the pose, second look included.
    pub pose_ms: f64,
    /// Size of the scene file.
    pub num_bytes: usize,
    /// Time of teaching, features included where they were not there.
    pub teaching_s: f64,
}

impl Measured {
    /// What results are known by: a change of any of it asks for a new one.
    pub fn identity(dataset: &Dataset, extractor_sha256: &str, options: &str) -> String {
        let mut text = format!(
            "{} {extractor_sha256} {options}\n",
            env!("CARGO_PKG_VERSION")
        );
        for image in &dataset.images {
            let pose = image.cam_from_world.map(|t| t.to_row_major());
            let size = std::fs::metadata(&image.path).map_or(0, |m| m.len());
            text += &format!(
                "{} {size} {:?} {pose:?} {:?}\n",
                image.name, image.split, image.camera
            );
        }
        sha256_hex(text.as_bytes())
    }
}

/// The result in a file, where it is of this identity; else `make`'s, which is written there.
///
/// # Errors
/// Of `make`, or when the file cannot be written.
pub fn resumed(
    path: &Path,
    identity: &str,
    make: impl FnOnce() -> Result<Measured>,
) -> Result<Measured> {
    let known = std::fs::read(path)
        .ok()
        .and_then(|bytes| serde_json::from_slice::<Measured>(&bytes).ok())
        .filter(|known| known.identity == identity);
    if let Some(known) = known {
        println!("{}: measured before", path.display());
        return Ok(known);
    }
    let measured = make()?;
    write_bytes(path, &serde_json::to_vec_pretty(&measured)?)?;
    Ok(measured)
}

/// Teaches the scene, writes it to `out`, and locates its test pictures.
///
/// # Errors
/// When pictures cannot be read, nothing can be taught, or the disk refuses.
pub fn measure(
    request: &Request<'_>,
    identity: String,
    out: &Path,
    observer: &mut dyn Observer,
) -> Result<Measured> {
    let (dataset, extraction): (&Dataset, &Extraction) = (request.dataset, request.extraction);
    let start = Instant::now();
    let taught = teach(request, observer).with_context(|| format!("teaching {}", out.display()))?;
    let teaching_s = start.elapsed().as_secs_f64();
    // What is evaluated is the file, as others get it.
    let bytes = taught.scene.to_bytes(request.scene.precision)?;
    write_bytes(out, &bytes)?;
    let scene = SceneFile::from_bytes(&bytes)?;
    let map = &taught.labels.map;
    let num_landmarks = baseline_size(bytes.len(), map.descriptor_channels());
    let landmarks = Landmarks::from_map(map, num_landmarks);
    let mut relocalizer = relocalizer(scene, extraction.extractor().clone(), |_| {})?;
    let positions = dataset.of_split(Split::Test);
    let tests: Vec<&DatasetImage> = positions.iter().map(|i| &dataset.images[*i]).collect();
    let bar = Progress::Terminal.bar("locating", tests.len());
    let options = EvalOptions {
        extraction: Some(extraction),
        baseline: Some(&landmarks),
        units: dataset.units,
        ..EvalOptions::default()
    };
    let evaluation = Evaluator::new(&mut relocalizer, options).run(&tests, |_| bar.inc(1))?;
    bar.finish();
    let finite = |v: f64| v.is_finite().then_some(v);
    let methods = evaluation.methods.iter().map(|(name, s)| {
        let recall = s.recall_at(0.05).map(|share| 100.0 * share);
        let position = finite(100.0 * s.median_position);
        (
            name.clone(),
            [position, finite(s.median_rotation_deg), recall],
        )
    });
    let mean = |stages: std::ops::Range<usize>| {
        let of_image = |stages_ms: &[f64; 6]| stages_ms[stages.clone()].iter().sum::<f64>();
        let sum: f64 = evaluation
            .images
            .iter()
            .map(|i| of_image(&i.stages_ms))
            .sum();
        sum / tests.len().max(1) as f64
    };
    Ok(Measured {
        identity,
        num_train: dataset.of_split(Split::Train).len(),
        num_test: tests.len(),
        methods: methods.collect(),
        forward_ms: mean(0..4),
        pose_ms: mean(4..6),
        num_bytes: bytes.len(),
        teaching_s,
    })
}
