//! Finds the keypoints and segments of a picture and compares two pictures by their descriptors.
//!
//! ```sh
//! cargo xtask web    # makes the extractor's file, once
//! cargo run --release --example extract_features -- dist/npm/landline/xfeat.safetensors PICTURE PICTURE
//! ```

use landline::features::FeatureSet;
use landline::front_end::{FrontEnd, FrontEndOptions};
use landline::image::{FrameView, PixelFormat};
use landline::scene_file::ExtractorFile;
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let (Some(weights), Some(first), Some(second)) = (words.next(), words.next(), words.next())
    else {
        return Err("give the extractor's file and two pictures".into());
    };
    let extractor = ExtractorFile::from_bytes(&std::fs::read(weights)?)?;
    let options = FrontEndOptions::new(extractor.kind);
    let mut front_end = FrontEnd::new(extractor, options)?;
    // The front end owns its result and overwrites it with the next picture, so the first one is copied.
    let first = features(&mut front_end, &first)?;
    let second = features(&mut front_end, &second)?;

    // Mutual nearest neighbours; descriptors have unit length, so their product is the cosine.
    let forward = nearest(&first, &second);
    let backward = nearest(&second, &first);
    let matches = forward
        .iter()
        .enumerate()
        .filter(|(i, (j, cosine))| *cosine > 0.82 && backward.get(*j).is_some_and(|b| b.0 == *i));
    println!("{} keypoints agree", matches.count());
    Ok(())
}

fn features(front_end: &mut FrontEnd, path: &str) -> Result<FeatureSet, Box<dyn Error>> {
    let picture = image::open(path)?.into_luma8();
    let frame = FrameView::tight(
        picture.as_raw(),
        picture.width(),
        picture.height(),
        PixelFormat::Luma8,
    );
    let set = front_end.run(&frame)?.clone();
    println!(
        "{path}: {} keypoints, {} segments, descriptors of {} numbers",
        set.keypoints.len(),
        set.segments.len(),
        set.descriptor_channels
    );
    Ok(set)
}

/// For each keypoint of `from` the index and cosine of the most similar one of `to`.
fn nearest(from: &FeatureSet, to: &FeatureSet) -> Vec<(usize, f32)> {
    let rows = |set: &FeatureSet| -> Vec<Vec<f32>> {
        (0..set.keypoints.len())
            .filter_map(|i| set.descriptor(i).map(<[f32]>::to_vec))
            .collect()
    };
    let candidates = rows(to);
    let cosine = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f32>();
    rows(from)
        .iter()
        .map(|row| {
            candidates
                .iter()
                .enumerate()
                .map(|(j, other)| (j, cosine(row, other)))
                .fold((usize::MAX, f32::MIN), |best, new| {
                    if new.1 > best.1 { new } else { best }
                })
        })
        .collect()
}
