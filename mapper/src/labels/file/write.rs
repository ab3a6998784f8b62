//! Labels to a label file.

use super::super::Labels;
use super::{FORMAT, Header, ImageHeader, LabelFileError, VERSION};
use crate::files;
use half::f16;
use landline::features::FeatureSet;
use landline::geometry::CameraRecord;
use landline::geometry::Segment2;
use landline::reconstruction::Observation;
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, View, serialize_to_file};
use std::borrow::Cow;
use std::collections::HashMap;
use std::io;
use std::path::Path;

/// A tensor whose bytes are made when it is written, so that no two are in memory at once.
struct Column<'a> {
    dtype: Dtype,
    shape: [usize; 2],
    bytes: Box<dyn Fn() -> Vec<u8> + 'a>,
}

impl View for &Column<'_> {
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
) -> Column<'a> {
    let count = values().count();
    Column {
        dtype,
        shape: [count / width.max(1), width],
        bytes: Box::new(move || {
            let mut bytes = Vec::with_capacity(count * N);
            values().for_each(|v| bytes.extend_from_slice(&bytes_of(v)));
            bytes
        }),
    }
}

fn f64s<'a, I: Iterator<Item = f64>>(width: usize, values: impl Fn() -> I + 'a) -> Column<'a> {
    column(Dtype::F64, width, values, f64::to_le_bytes)
}
fn f32s<'a, I: Iterator<Item = f32>>(width: usize, values: impl Fn() -> I + 'a) -> Column<'a> {
    column(Dtype::F32, width, values, f32::to_le_bytes)
}
fn f16s<'a, I: Iterator<Item = f32>>(width: usize, values: impl Fn() -> I + 'a) -> Column<'a> {
    column(Dtype::F16, width, values, |v| {
        f16::from_f32(v).to_le_bytes()
    })
}
fn i64s<'a, I: Iterator<Item = i64>>(width: usize, values: impl Fn() -> I + 'a) -> Column<'a> {
    column(Dtype::I64, width, values, i64::to_le_bytes)
}

fn segment_numbers(s: &Segment2) -> [f64; 7] {
    [
        s.start.x,
        s.start.y,
        s.end.x,
        s.end.y,
        s.width_px,
        s.precision,
        s.neg_log10_nfa,
    ]
}

fn observation_numbers(o: &Observation) -> [i64; 2] {
    [i64::from(o.view), i64::from(o.feature)]
}

impl Labels {
    /// Writes the labels; the file appears whole or not at all.
    ///
    /// # Errors
    /// When the disk refuses, or a view has no pose.
    pub fn write(&self, path: &Path) -> Result<(), LabelFileError> {
        let io_error = |source| LabelFileError::Io {
            path: path.to_owned(),
            source,
        };
        let header = self.header().map_err(|what| LabelFileError::Content {
            path: path.to_owned(),
            what,
        })?;
        let header_json = serde_json::to_string(&header).map_err(|e| io_error(e.into()))?;
        let metadata = HashMap::from([
            ("format".to_owned(), format!("{FORMAT} {VERSION}")),
            ("labels".to_owned(), header_json),
        ]);
        let columns = self.columns();
        files::write_at_once(path, |temporary| {
            let columns = columns.iter().map(|(name, column)| (*name, column));
            serialize_to_file(columns, Some(metadata), temporary).map_err(|e| match e {
                SafeTensorError::IoError(e) => e,
                other => io::Error::other(other),
            })
        })
        .map_err(io_error)
    }

    /// Features of pictures, then of variants.
    fn feature_sets(&self) -> impl Iterator<Item = &FeatureSet> {
        let of_views = self.map.views.iter().map(|v| &v.features);
        of_views.chain(self.variants.iter().map(|v| &v.features))
    }

    fn header(&self) -> Result<Header, String> {
        let pictures = (0..self.map.views.len()).map(|i| (i, None));
        let variants = self.variants.iter();
        let images = pictures
            .chain(variants.map(|v| (v.of_view as usize, Some(v.of_view))))
            .zip(self.feature_sets())
            .map(|((of, variant_of), features)| {
                let view = self
                    .map
                    .views
                    .get(of)
                    .ok_or_else(|| format!("a variant of picture {of}, which is not there"))?;
                let cam_from_world = view
                    .cam_from_world
                    .ok_or_else(|| format!("{} has no pose", view.name))?;
                let mut rotation_row_major = [0.0; 9];
                for (i, v) in rotation_row_major.iter_mut().enumerate() {
                    *v = cam_from_world.rotation[(i / 3, i % 3)];
                }
                Ok(ImageHeader {
                    name: view.name.clone(),
                    camera: CameraRecord::from_camera(&view.camera),
                    rotation_row_major,
                    translation: cam_from_world.translation.into(),
                    num_keypoints: features.keypoints.len(),
                    num_segments: features.segments.len(),
                    variant_of,
                })
            })
            .collect::<Result<_, String>>()?;
        Ok(Header {
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

    fn columns(&self) -> [(&'static str, Column<'_>); 12] {
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
                    segments.flat_map(segment_numbers)
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
