//! Labels as a file: what training starts from, one safetensors file, all pictures' rows concatenated, descriptors as f16.
//!
//! Counts per picture and track say where rows belong; names, cameras and where the labels are from are JSON in the header.
//! The native tool reads it (`landline train`) and writes it; pages write it of their films.

use super::scene::Origin;
use crate::features::FeatureSet;
use crate::geometry::{CameraRecord, Segment2};
use crate::reconstruction::{Observation, Reconstruction};
use half::f16;
use safetensors::tensor::{Dtype, View, serialize};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::HashMap;

/// Before the version in the container's `format`.
pub const LABEL_FORMAT: &str = "landline labels";
/// The version that is written, and the only one that is read: files of versions 1 and 2 say neither what their units are
/// nor which checkpoint their features are of.
pub const LABEL_VERSION: u32 = 3;

/// The header's entry `labels`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LabelHeader {
    /// Name of the extractor.
    pub extractor: String,
    /// Of its checkpoint.
    pub extractor_sha256: String,
    /// Longest side of the working image, pixels.
    pub working_max_side: u32,
    /// Of the world's lengths.
    pub units: String,
    /// Direction of gravity in the world, a unit vector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gravity: Option<[f64; 3]>,
    /// Which pictures, in words.
    pub source: String,
    /// Descriptors of a segment.
    pub samples_per_segment: usize,
    /// In the order of the rows.
    pub images: Vec<LabelledPicture>,
}

/// A picture of the header.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LabelledPicture {
    /// As the data set calls it.
    pub name: String,
    /// Intrinsics.
    pub camera: CameraRecord,
    /// World to camera.
    pub rotation_row_major: [f64; 9],
    /// World to camera.
    pub translation: [f64; 3],
    /// Rows of keypoints.
    pub num_keypoints: usize,
    /// Rows of segments.
    pub num_segments: usize,
    /// Index of the picture that this one is a variant of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant_of: Option<u32>,
}

/// Why there is no label file.
#[derive(Debug, thiserror::Error)]
pub enum LabelSourceError {
    /// A picture that was not placed teaches nothing.
    #[error("{0} has no pose")]
    NoPose(String),
    /// A changed copy of nothing.
    #[error("a variant of picture {0}, which is not there")]
    NoPicture(u32),
    /// The header or the container cannot be written.
    #[error("the file cannot be written: {0}")]
    Container(String),
}

/// What a label file is made of.
#[derive(Debug, Clone)]
pub struct LabelSource<'a> {
    /// What made the features.
    pub origin: &'a Origin,
    /// Pictures with poses, points and lines.
    pub map: &'a Reconstruction,
    /// Features of changed copies of pictures, each with the picture's index.
    pub variants: Vec<(u32, &'a FeatureSet)>,
}

/// A tensor whose bytes are made when it is written, so that no two are in memory at once.
pub struct LabelTensor<'a> {
    dtype: Dtype,
    shape: [usize; 2],
    bytes: Box<dyn Fn() -> Vec<u8> + 'a>,
}

impl View for &LabelTensor<'_> {
    fn dtype(&self) -> Dtype {
        self.dtype
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Owned((self.bytes)())
    }
    fn data_len(&self) -> usize {
        self.shape[0] * self.shape[1] * self.dtype.bitsize() / 8
    }
}

fn column<'a, const N: usize, T, I: Iterator<Item = T>>(
    dtype: Dtype,
    width: usize,
    values: impl Fn() -> I + 'a,
    bytes_of: impl Fn(T) -> [u8; N] + Copy + 'a,
) -> LabelTensor<'a> {
    let count = values().count();
    LabelTensor {
        dtype,
        shape: [count / width.max(1), width],
        bytes: Box::new(move || {
            let mut bytes = Vec::with_capacity(count * N);
            values().for_each(|v| bytes.extend_from_slice(&bytes_of(v)));
            bytes
        }),
    }
}

fn f64s<'a, I: Iterator<Item = f64>>(width: usize, values: impl Fn() -> I + 'a) -> LabelTensor<'a> {
    column(Dtype::F64, width, values, f64::to_le_bytes)
}
fn f32s<'a, I: Iterator<Item = f32>>(width: usize, values: impl Fn() -> I + 'a) -> LabelTensor<'a> {
    column(Dtype::F32, width, values, f32::to_le_bytes)
}
fn f16s<'a, I: Iterator<Item = f32>>(width: usize, values: impl Fn() -> I + 'a) -> LabelTensor<'a> {
    column(Dtype::F16, width, values, |v| {
        f16::from_f32(v).to_le_bytes()
    })
}
fn i64s<'a, I: Iterator<Item = i64>>(width: usize, values: impl Fn() -> I + 'a) -> LabelTensor<'a> {
    column(Dtype::I64, width, values, i64::to_le_bytes)
}

fn observation_numbers(o: &Observation) -> [i64; 2] {
    [i64::from(o.view), i64::from(o.feature)]
}

impl LabelSource<'_> {
    /// Metadata of the container.
    ///
    /// # Errors
    /// [`LabelSourceError`] when a picture has no pose.
    pub fn metadata(&self) -> Result<HashMap<String, String>, LabelSourceError> {
        let header = serde_json::to_string(&self.header()?);
        let header = header.map_err(|e| LabelSourceError::Container(e.to_string()))?;
        Ok(HashMap::from([
            (
                "format".to_owned(),
                format!("{LABEL_FORMAT} {LABEL_VERSION}"),
            ),
            ("labels".to_owned(), header),
        ]))
    }

    /// The whole file.
    ///
    /// # Errors
    /// [`LabelSourceError`] when a picture has no pose.
    pub fn to_bytes(&self) -> Result<Vec<u8>, LabelSourceError> {
        let tensors = self.tensors();
        let named = tensors.iter().map(|(name, tensor)| (*name, tensor));
        serialize(named, Some(self.metadata()?))
            .map_err(|e| LabelSourceError::Container(e.to_string()))
    }

    /// Features of pictures, then of variants.
    fn feature_sets(&self) -> impl Iterator<Item = &FeatureSet> {
        let of_views = self.map.views.iter().map(|v| &v.features);
        of_views.chain(self.variants.iter().map(|(_, features)| *features))
    }

    fn header(&self) -> Result<LabelHeader, LabelSourceError> {
        let pictures = (0..self.map.views.len()).map(|i| (i, None));
        let variants = self.variants.iter();
        let images = pictures
            .chain(variants.map(|(of, _)| (*of as usize, Some(*of))))
            .zip(self.feature_sets())
            .map(|((of, variant_of), features)| {
                let view = self
                    .map
                    .views
                    .get(of)
                    .ok_or(LabelSourceError::NoPicture(of as u32))?;
                let cam_from_world = view
                    .cam_from_world
                    .ok_or_else(|| LabelSourceError::NoPose(view.name.clone()))?;
                let mut rotation_row_major = [0.0; 9];
                for (i, v) in rotation_row_major.iter_mut().enumerate() {
                    *v = cam_from_world.rotation[(i / 3, i % 3)];
                }
                Ok(LabelledPicture {
                    name: view.name.clone(),
                    camera: CameraRecord::from_camera(&view.camera),
                    rotation_row_major,
                    translation: cam_from_world.translation.into(),
                    num_keypoints: features.keypoints.len(),
                    num_segments: features.segments.len(),
                    variant_of,
                })
            })
            .collect::<Result<_, LabelSourceError>>()?;
        Ok(LabelHeader {
            extractor: self.origin.extractor.name().to_owned(),
            extractor_sha256: self.origin.extractor_sha256.clone(),
            working_max_side: self.origin.working_max_side,
            units: self.map.units.name().to_owned(),
            gravity: self.map.gravity.map(Into::into),
            source: self.origin.source.clone(),
            samples_per_segment: self.map.tokens(),
            images,
        })
    }

    /// Every tensor by its name.
    pub fn tensors(&self) -> [(&'static str, LabelTensor<'_>); 12] {
        let d = self.map.descriptor_channels();
        let map = &self.map;
        [
            (
                "keypoints",
                f32s(3, || {
                    let keypoints = self.feature_sets().flat_map(|f| &f.keypoints);
                    keypoints.flat_map(|k| [k.pixel.x as f32, k.pixel.y as f32, k.score])
                }),
            ),
            (
                "descriptors",
                f16s(d, || {
                    self.feature_sets()
                        .flat_map(|f| f.descriptors_nd.iter().copied())
                }),
            ),
            (
                "segments",
                f64s(7, || {
                    let segments = self.feature_sets().flat_map(|f| &f.segments);
                    segments.flat_map(Segment2::to_numbers)
                }),
            ),
            (
                "segment_descriptors",
                f16s(d, || {
                    self.feature_sets()
                        .flat_map(|f| f.segment_descriptors_nsd.iter().copied())
                }),
            ),
            (
                "points",
                f64s(4, || {
                    map.points.iter().flat_map(|p| {
                        let x = p.point_in_world;
                        [x.x, x.y, x.z, f64::from(p.mean_error_px)]
                    })
                }),
            ),
            (
                "point_descriptors",
                f16s(d, || {
                    map.points.iter().flat_map(|p| p.descriptor.iter().copied())
                }),
            ),
            (
                "point_track_lengths",
                i64s(1, || map.points.iter().map(|p| p.observations.len() as i64)),
            ),
            (
                "point_observations",
                i64s(2, || {
                    let seen = map.points.iter().flat_map(|p| &p.observations);
                    seen.flat_map(observation_numbers)
                }),
            ),
            (
                "lines",
                f64s(7, || {
                    map.lines.iter().flat_map(|l| {
                        let (a, b) = (l.start_in_world, l.end_in_world);
                        [a.x, a.y, a.z, b.x, b.y, b.z, f64::from(l.mean_error_px)]
                    })
                }),
            ),
            (
                "line_descriptors",
                f16s(d, || {
                    map.lines.iter().flat_map(|l| l.descriptor.iter().copied())
                }),
            ),
            (
                "line_track_lengths",
                i64s(1, || map.lines.iter().map(|l| l.observations.len() as i64)),
            ),
            (
                "line_observations",
                i64s(2, || {
                    let seen = map.lines.iter().flat_map(|l| &l.observations);
                    seen.flat_map(observation_numbers)
                }),
            ),
        ]
    }
}
