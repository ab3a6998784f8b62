//! Labels to a label file.

use super::super::{LabelledImage, Labels, Observation};
use super::{FORMAT, Header, ImageHeader, LabelFileError, NO_TARGET};
use crate::files;
use half::f16;
use landline::geometry::CameraRecord;
use landline::geometry::Segment2;
use safetensors::tensor::{Dtype, View, serialize};
use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

struct Column {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl View for &Column {
    fn dtype(&self) -> Dtype {
        self.dtype
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

fn column<const N: usize, T>(
    dtype: Dtype,
    width: usize,
    values: impl Iterator<Item = T>,
    bytes_of: impl Fn(T) -> [u8; N],
) -> Column {
    let bytes: Vec<u8> = values.flat_map(bytes_of).collect();
    Column {
        dtype,
        shape: vec![bytes.len() / N / width.max(1), width],
        bytes,
    }
}

fn f64s(width: usize, values: impl Iterator<Item = f64>) -> Column {
    column(Dtype::F64, width, values, f64::to_le_bytes)
}
fn f32s(width: usize, values: impl Iterator<Item = f32>) -> Column {
    column(Dtype::F32, width, values, f32::to_le_bytes)
}
fn f16s(width: usize, values: impl Iterator<Item = f32>) -> Column {
    column(Dtype::F16, width, values, |v| {
        f16::from_f32(v).to_le_bytes()
    })
}
fn i64s(width: usize, values: impl Iterator<Item = i64>) -> Column {
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

fn observations<'a>(all: impl Iterator<Item = &'a Vec<Observation>>) -> Column {
    i64s(
        2,
        all.flatten()
            .flat_map(|o| [i64::from(o.image), i64::from(o.feature)]),
    )
}

impl Labels {
    /// Writes the labels; the file appears whole or not at all.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, path: &Path) -> Result<(), LabelFileError> {
        let io_error = |source| LabelFileError::Io {
            path: path.to_owned(),
            source,
        };
        let d = self.descriptor_len;
        let variants = self.variants.iter();
        let (images, variant_of): (Vec<&LabelledImage>, Vec<Option<u32>>) = self
            .images
            .iter()
            .map(|image| (image, None))
            .chain(variants.map(|v| (&v.image, Some(v.of_image))))
            .unzip();
        let header = Header {
            extractor: self.extractor.clone(),
            samples_per_segment: self.samples_per_segment,
            images: images
                .iter()
                .zip(variant_of)
                .map(|(image, variant_of)| {
                    let mut rotation_row_major = [0.0; 9];
                    for (i, v) in rotation_row_major.iter_mut().enumerate() {
                        *v = image.cam_from_world.rotation[(i / 3, i % 3)];
                    }
                    ImageHeader {
                        name: image.name.clone(),
                        camera: CameraRecord::from_camera(&image.camera),
                        rotation_row_major,
                        translation: image.cam_from_world.translation.into(),
                        num_keypoints: image.pixels.len(),
                        num_segments: image.segments.len(),
                        variant_of,
                    }
                })
                .collect(),
        };
        let columns = [
            (
                "keypoints",
                f32s(
                    3,
                    images.iter().flat_map(|i| {
                        i.pixels
                            .iter()
                            .zip(&i.scores)
                            .flat_map(|(p, s)| [p.x as f32, p.y as f32, *s])
                    }),
                ),
            ),
            (
                "descriptors",
                f16s(
                    d,
                    images.iter().flat_map(|i| i.descriptors_nd.iter().copied()),
                ),
            ),
            (
                "point_targets",
                i64s(
                    1,
                    images.iter().flat_map(|i| {
                        i.point_targets
                            .iter()
                            .map(|t| t.map_or(NO_TARGET, i64::from))
                    }),
                ),
            ),
            (
                "segments",
                f64s(
                    7,
                    images
                        .iter()
                        .flat_map(|i| i.segments.iter().flat_map(segment_numbers)),
                ),
            ),
            (
                "segment_descriptors",
                f16s(
                    d,
                    images
                        .iter()
                        .flat_map(|i| i.segment_descriptors_nsd.iter().copied()),
                ),
            ),
            (
                "segment_targets",
                i64s(
                    2,
                    images.iter().flat_map(|i| {
                        i.segment_targets.iter().flat_map(|t| match t {
                            Some(t) => [i64::from(t.track), i64::from(t.reversed)],
                            None => [NO_TARGET, 0],
                        })
                    }),
                ),
            ),
            (
                "points",
                f64s(
                    4,
                    self.points.iter().flat_map(|p| {
                        let x = p.point_in_world;
                        [x.x, x.y, x.z, f64::from(p.mean_error_px)]
                    }),
                ),
            ),
            (
                "point_descriptors",
                f16s(
                    d,
                    self.points
                        .iter()
                        .flat_map(|p| p.descriptor.iter().copied()),
                ),
            ),
            (
                "point_track_lengths",
                i64s(1, self.points.iter().map(|p| p.observations.len() as i64)),
            ),
            (
                "point_observations",
                observations(self.points.iter().map(|p| &p.observations)),
            ),
            (
                "lines",
                f64s(
                    7,
                    self.lines.iter().flat_map(|l| {
                        let (a, b) = (l.start_in_world, l.end_in_world);
                        [a.x, a.y, a.z, b.x, b.y, b.z, f64::from(l.mean_error_px)]
                    }),
                ),
            ),
            (
                "line_descriptors",
                f16s(
                    d,
                    self.lines.iter().flat_map(|l| l.descriptor.iter().copied()),
                ),
            ),
            (
                "line_track_lengths",
                i64s(1, self.lines.iter().map(|l| l.observations.len() as i64)),
            ),
            (
                "line_observations",
                observations(self.lines.iter().map(|l| &l.observations)),
            ),
        ];
        let header_json = serde_json::to_string(&header).map_err(|e| io_error(e.into()))?;
        let metadata = HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("labels".to_owned(), header_json),
        ]);
        let bytes =
            serialize(columns.iter().map(|(n, c)| (*n, c)), Some(metadata)).map_err(|source| {
                LabelFileError::Container {
                    path: path.to_owned(),
                    source,
                }
            })?;
        files::write_atomic(path, |out| out.write_all(&bytes)).map_err(io_error)
    }
}
