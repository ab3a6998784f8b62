//! Features of pictures on disk: extracted once, resumable picture by picture.
//!
//! One safetensors file a picture. Its header names what made it; a file of another extractor, another configuration or
//! another version of the picture is not used and made again.

use crate::files;
use half::f16;
use landline::features::{FeatureSet, Keypoint};
use landline::geometry::{Pixel, Segment2};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

const FORMAT: &str = "landline features 1";

/// Why features could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FeatureCacheError {
    /// The operating system refused.
    #[error("feature cache: {0}")]
    Io(#[from] std::io::Error),
    /// The file is damaged.
    #[error("feature cache file {path}: {what}; delete it to have it made again")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What disagrees.
        what: String,
    },
}

/// A folder of feature files.
#[derive(Debug, Clone)]
pub struct FeatureCache {
    folder: PathBuf,
    maker: String,
}

impl FeatureCache {
    /// A cache in `folder` for features made by `maker`: the extractor's identity and every setting that matters.
    pub fn new(folder: impl Into<PathBuf>, maker: impl Into<String>) -> Self {
        Self {
            folder: folder.into(),
            maker: maker.into(),
        }
    }

    /// Identity of what makes the features.
    pub fn maker(&self) -> &str {
        &self.maker
    }

    fn path(&self, name: &str) -> PathBuf {
        // Folders in a name stay folders, steps upwards do not leave the cache.
        let safe: PathBuf = name
            .split(['/', '\\'])
            .filter(|part| !part.is_empty() && *part != "." && *part != "..")
            .collect();
        let mut file = safe.into_os_string();
        file.push(".features");
        self.folder.join(file)
    }

    /// Features of a picture; `None` when they have to be made.
    ///
    /// # Errors
    /// When the file is there but damaged or unreadable.
    pub fn read(&self, name: &str) -> Result<Option<FeatureSet>, FeatureCacheError> {
        let path = self.path(name);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(e.into()),
        };
        decode(&bytes, &self.maker).map_err(|what| FeatureCacheError::Damaged { path, what })
    }

    /// Stores the features of a picture; the file appears whole or not at all.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, name: &str, features: &FeatureSet) -> Result<(), FeatureCacheError> {
        let path = self.path(name);
        let damaged = |what: String| FeatureCacheError::Damaged {
            path: path.clone(),
            what,
        };
        let bytes = encode(features, &self.maker).map_err(|e| damaged(e.to_string()))?;
        Ok(files::write_bytes(&path, &bytes)?)
    }

    /// Where the files lie.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

fn encode(features: &FeatureSet, maker: &str) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let (n, m, d) = (
        features.keypoints.len(),
        features.segments.len(),
        features.descriptor_channels,
    );
    let keypoints: Vec<u8> = features
        .keypoints
        .iter()
        .flat_map(|k| [k.pixel.x as f32, k.pixel.y as f32, k.score])
        .flat_map(f32::to_le_bytes)
        .collect();
    let halves = |values: &[f32]| -> Vec<u8> {
        values
            .iter()
            .flat_map(|v| f16::from_f32(*v).to_le_bytes())
            .collect()
    };
    let descriptors = halves(&features.descriptors_nd);
    let segment_descriptors = halves(&features.segment_descriptors_nsd);
    let segments: Vec<u8> = features
        .segments
        .iter()
        .flat_map(Segment2::to_numbers)
        .flat_map(f64::to_le_bytes)
        .collect();
    let rows = m * features.tokens;
    let tensors = [
        (
            "keypoints",
            TensorView::new(Dtype::F32, vec![n, 3], &keypoints)?,
        ),
        (
            "descriptors",
            TensorView::new(Dtype::F16, vec![n, d], &descriptors)?,
        ),
        (
            "segments",
            TensorView::new(Dtype::F64, vec![m, 7], &segments)?,
        ),
        (
            "segment_descriptors",
            TensorView::new(Dtype::F16, vec![rows, d], &segment_descriptors)?,
        ),
    ];
    let metadata = HashMap::from([
        ("format".to_owned(), FORMAT.to_owned()),
        ("extractor".to_owned(), maker.to_owned()),
        ("tokens".to_owned(), features.tokens.to_string()),
    ]);
    serialize(tensors, Some(metadata))
}

fn decode(bytes: &[u8], maker: &str) -> Result<Option<FeatureSet>, String> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| e.to_string())?;
    let entries = metadata.metadata().clone().unwrap_or_default();
    let is = |key: &str, value: &str| entries.get(key).is_some_and(|v| v == value);
    if !is("format", FORMAT) || !is("extractor", maker) {
        return Ok(None);
    }
    let file = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
    let data = |name: &str, dtype: Dtype| {
        let tensor = file.tensor(name).map_err(|e| e.to_string())?;
        if tensor.dtype() != dtype {
            return Err(format!(
                "`{name}` is {:?}, expected {dtype:?}",
                tensor.dtype()
            ));
        }
        Ok((tensor.data(), tensor.shape().to_vec()))
    };
    let halves = |bytes: &[u8]| -> Vec<f32> {
        bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|b| f16::from_le_bytes(*b).to_f32())
            .collect()
    };
    let (keypoints, _) = data("keypoints", Dtype::F32)?;
    let (descriptors, shape) = data("descriptors", Dtype::F16)?;
    let (segments, _) = data("segments", Dtype::F64)?;
    let (segment_descriptors, _) = data("segment_descriptors", Dtype::F16)?;
    let keypoints: Vec<f32> = keypoints
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| f32::from_le_bytes(*b))
        .collect();
    let (triples, _) = keypoints.as_chunks::<3>();
    let segments: Vec<f64> = segments
        .as_chunks::<8>()
        .0
        .iter()
        .map(|b| f64::from_le_bytes(*b))
        .collect();
    let d = shape.last().copied().unwrap_or(0);
    let segments: Vec<Segment2> = segments
        .as_chunks::<7>()
        .0
        .iter()
        .map(|numbers| Segment2::from_numbers(*numbers))
        .collect();
    let segment_descriptors_nsd = halves(segment_descriptors);
    // Files that do not say it have it in the number of rows.
    let tokens = match entries.get("tokens") {
        Some(text) => text
            .parse()
            .map_err(|_| format!("`tokens` is {text:?}, which is no number"))?,
        None => (segments.len().checked_mul(d))
            .and_then(|row| segment_descriptors_nsd.len().checked_div(row))
            .unwrap_or(0),
    };
    let features = FeatureSet {
        keypoints: triples
            .iter()
            .map(|[x, y, score]| Keypoint {
                pixel: Pixel::new(f64::from(*x), f64::from(*y)),
                score: *score,
            })
            .collect(),
        descriptors_nd: halves(descriptors),
        segments,
        segment_descriptors_nsd,
        descriptor_channels: d,
        tokens,
    };
    let n = features.keypoints.len();
    // The numbers are the file's own: their product may be none.
    let product = |factors: &[usize]| factors.iter().try_fold(1, |a: usize, b| a.checked_mul(*b));
    let rows = [features.segments.len(), features.tokens, d];
    if product(&[n, d]) != Some(features.descriptors_nd.len())
        || product(&rows) != Some(features.segment_descriptors_nsd.len())
    {
        return Err(format!(
            "{n} keypoints and {} segments do not fit {} and {} descriptor values of length {d}",
            features.segments.len(),
            features.descriptors_nd.len(),
            features.segment_descriptors_nsd.len()
        ));
    }
    let of_keypoints = (features.keypoints.iter())
        .flat_map(|k| [k.pixel.x, k.pixel.y, f64::from(k.score)])
        .chain(features.segments.iter().flat_map(Segment2::to_numbers));
    let of_descriptors = [&features.descriptors_nd, &features.segment_descriptors_nsd];
    if !of_keypoints.into_iter().all(f64::is_finite)
        || !of_descriptors.into_iter().flatten().all(|v| v.is_finite())
    {
        return Err("it holds a number that is not finite".to_owned());
    }
    Ok(Some(features))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features() -> FeatureSet {
        FeatureSet {
            keypoints: [(0.5, 1.25, 0.5), (3.0, 2.0, 0.25)]
                .map(|(x, y, score)| Keypoint {
                    pixel: Pixel::new(x, y),
                    score,
                })
                .to_vec(),
            descriptor_channels: 2,
            tokens: 12,
            descriptors_nd: vec![1.0, 0.0, 0.0, -1.0],
            segments: vec![Segment2 {
                start: Pixel::new(1.0, 2.0),
                end: Pixel::new(30.0, 4.0),
                width_px: 2.0,
                precision: 0.125,
                neg_log10_nfa: 7.5,
            }],
            segment_descriptors_nsd: vec![0.5; 24],
        }
    }

    #[test]
    fn features_survive_the_disk_and_others_are_made_again() {
        let folder = std::env::temp_dir().join(format!("landline-cache-{}", std::process::id()));
        let cache = FeatureCache::new(&folder, "a");
        let features = features();
        assert_eq!(cache.read("seq/a.png").expect("absent is no error"), None);
        cache.write("../seq/a.png", &features).expect("writable");
        assert_eq!(cache.read("seq/a.png").expect("readable"), Some(features));
        let other = FeatureCache::new(&folder, "b");
        assert_eq!(other.read("seq/a.png").expect("readable"), None);
        std::fs::write(cache.path("seq/a.png"), b"cut").expect("writable");
        assert!(matches!(
            cache.read("seq/a.png"),
            Err(FeatureCacheError::Damaged { .. })
        ));
        std::fs::remove_dir_all(&folder).expect("exists");
    }

    #[test]
    fn numbers_that_are_none_and_sizes_beyond_memory_are_refused() {
        type Change = fn(&mut FeatureSet);
        let changes: [(&str, Change); 5] = [
            ("score", |f| f.keypoints[0].score = f32::NAN),
            ("pixel", |f| f.keypoints[1].pixel.x = f64::INFINITY),
            ("descriptor", |f| f.descriptors_nd[2] = f32::NAN),
            ("segment", |f| f.segments[0].end.y = f64::NAN),
            ("sample", |f| f.segment_descriptors_nsd[23] = f32::INFINITY),
        ];
        for (name, change) in changes {
            let mut changed = features();
            change(&mut changed);
            let bytes = encode(&changed, "a").expect("writes");
            let told = decode(&bytes, "a").expect_err(name);
            assert!(told.contains("not finite"), "{name}: {told}");
        }

        // Rows of no length, so that an empty tensor holds any number of them: one product wraps to the right one, one panics.
        for (d, tokens) in [
            (1_usize << 63, "2"),
            (1 << 62, "4"),
            (2, "18446744073709551615"),
        ] {
            let segments = [0_u8; 56];
            let view = |dtype, shape: &[usize], data| TensorView::new(dtype, shape.to_vec(), data);
            let tensors = [
                ("keypoints", view(Dtype::F32, &[0, 3], &[])),
                ("descriptors", view(Dtype::F16, &[0, d], &[])),
                ("segments", view(Dtype::F64, &[1, 7], &segments)),
                ("segment_descriptors", view(Dtype::F16, &[0, d], &[])),
            ];
            let tensors = tensors.map(|(name, tensor)| (name, tensor.expect("empty")));
            let metadata = [("format", FORMAT), ("extractor", "a"), ("tokens", tokens)];
            let metadata = metadata.map(|(k, v)| (k.to_owned(), v.to_owned()));
            let bytes = serialize(tensors, Some(HashMap::from(metadata))).expect("writes");
            let told = decode(&bytes, "a").expect_err("one segment has no samples");
            assert!(told.contains("do not fit"), "{told}");
        }
    }
}
