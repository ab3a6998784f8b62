//! Labels on disk: one safetensors file, all pictures' rows concatenated, descriptors as f16.
//!
//! Counts per picture and track say where rows belong; names and cameras are JSON in the header.

use super::{
    LabelledImage, LabelledVariant, Labels, LineTrack, Observation, PointTrack, SegmentTarget,
};
use crate::dataset::camera::CameraRecord;
use crate::files;
use half::f16;
use landline::geometry::{CamFromWorld, Pixel, Segment2};
use nalgebra::{Matrix3, Vector3};
use safetensors::tensor::{Dtype, SafeTensors, View, serialize};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const FORMAT: &str = "landline labels 1";
/// In `point_targets` and `segment_targets`: no target.
const NO_TARGET: i64 = -1;

/// Why a label file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LabelFileError {
    /// The operating system refused.
    #[error("label file {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not a safetensors file, or cut short.
    #[error("label file {path} is damaged or no label file: {source}")]
    Container {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        source: safetensors::SafeTensorError,
    },
    /// The container is sound, its content is not what this version writes.
    #[error("label file {path}: {what}; make it again with `landline labels`")]
    Content {
        /// The file.
        path: PathBuf,
        /// What disagrees.
        what: String,
    },
}

#[derive(Serialize, Deserialize)]
struct Header {
    extractor: String,
    samples_per_segment: usize,
    images: Vec<ImageHeader>,
}

#[derive(Serialize, Deserialize)]
struct ImageHeader {
    name: String,
    camera: CameraRecord,
    rotation_row_major: [f64; 9],
    translation: [f64; 3],
    num_keypoints: usize,
    num_segments: usize,
    /// Index of the picture that this one is a variant of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    variant_of: Option<u32>,
}

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

    /// Reads what [`Labels::write`] wrote.
    ///
    /// # Errors
    /// When the file is missing, damaged, or of another format.
    pub fn read(path: &Path) -> Result<Self, LabelFileError> {
        let bytes = std::fs::read(path).map_err(|source| LabelFileError::Io {
            path: path.to_owned(),
            source,
        })?;
        let container = |source| LabelFileError::Container {
            path: path.to_owned(),
            source,
        };
        let content = |what: String| LabelFileError::Content {
            path: path.to_owned(),
            what,
        };
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(container)?;
        let entries = metadata.metadata().clone().unwrap_or_default();
        if entries.get("format").map(String::as_str) != Some(FORMAT) {
            return Err(content(format!("its format is not `{FORMAT}`")));
        }
        let header: Header = entries
            .get("labels")
            .ok_or_else(|| content("its header has no entry `labels`".to_owned()))
            .and_then(|json| serde_json::from_str(json).map_err(|e| content(e.to_string())))?;
        let file = SafeTensors::deserialize(&bytes).map_err(container)?;
        Columns { file: &file }.labels(header).map_err(content)
    }
}

struct Columns<'a> {
    file: &'a SafeTensors<'a>,
}

impl Columns<'_> {
    fn values<const N: usize, T>(
        &self,
        name: &str,
        dtype: Dtype,
        read: impl Fn([u8; N]) -> T,
    ) -> Result<(Vec<T>, usize), String> {
        let tensor = self.file.tensor(name).map_err(|e| e.to_string())?;
        if tensor.dtype() != dtype {
            return Err(format!(
                "`{name}` is {:?}, expected {dtype:?}",
                tensor.dtype()
            ));
        }
        let (chunks, _) = tensor.data().as_chunks::<N>();
        let width = tensor.shape().last().copied().unwrap_or(0);
        Ok((chunks.iter().map(|c| read(*c)).collect(), width))
    }
    fn f64s(&self, name: &str) -> Result<Rows<f64>, String> {
        self.values(name, Dtype::F64, f64::from_le_bytes)
            .map(|(v, _)| Rows::new(name, v))
    }
    fn f32s(&self, name: &str) -> Result<Rows<f32>, String> {
        self.values(name, Dtype::F32, f32::from_le_bytes)
            .map(|(v, _)| Rows::new(name, v))
    }
    fn f16s(&self, name: &str) -> Result<Rows<f32>, String> {
        self.values(name, Dtype::F16, |b| f16::from_le_bytes(b).to_f32())
            .map(|(v, _)| Rows::new(name, v))
    }
    fn i64s(&self, name: &str) -> Result<Rows<i64>, String> {
        self.values(name, Dtype::I64, i64::from_le_bytes)
            .map(|(v, _)| Rows::new(name, v))
    }

    fn labels(&self, header: Header) -> Result<Labels, String> {
        let d = self
            .file
            .tensor("descriptors")
            .map_err(|e| e.to_string())?
            .shape()
            .last()
            .copied()
            .unwrap_or(0);
        let s = header.samples_per_segment;
        let mut keypoints = self.f32s("keypoints")?;
        let mut descriptors = self.f16s("descriptors")?;
        let mut point_targets = self.i64s("point_targets")?;
        let mut segments = self.f64s("segments")?;
        let mut segment_descriptors = self.f16s("segment_descriptors")?;
        let mut segment_targets = self.i64s("segment_targets")?;
        let points = self.points(d)?;
        let lines = self.lines(d)?;
        let mut images = Vec::with_capacity(header.images.len());
        let mut variants = Vec::new();
        for image in header.images {
            let n = image.num_keypoints;
            let m = image.num_segments;
            let mut pixels = Vec::with_capacity(n);
            let mut scores = Vec::with_capacity(n);
            for row in keypoints.take(n, 3)?.chunks_exact(3) {
                pixels.push(Pixel::new(f64::from(row[0]), f64::from(row[1])));
                scores.push(row[2]);
            }
            let targets = point_targets.take(n, 1)?;
            let point_targets = targets
                .iter()
                .map(|t| index_below(*t, points.len(), "point_targets"))
                .collect::<Result<_, _>>()?;
            let segments = segments
                .take(m, 7)?
                .chunks_exact(7)
                .map(|v| Segment2 {
                    start: Pixel::new(v[0], v[1]),
                    end: Pixel::new(v[2], v[3]),
                    width_px: v[4],
                    precision: v[5],
                    neg_log10_nfa: v[6],
                })
                .collect();
            let segment_targets = segment_targets
                .take(m, 2)?
                .chunks_exact(2)
                .map(|v| {
                    Ok(
                        index_below(v[0], lines.len(), "segment_targets")?.map(|track| {
                            SegmentTarget {
                                track,
                                reversed: v[1] != 0,
                            }
                        }),
                    )
                })
                .collect::<Result<_, String>>()?;
            let labelled = LabelledImage {
                name: image.name,
                camera: image.camera.to_camera().map_err(|e| e.to_string())?,
                cam_from_world: CamFromWorld::new(
                    Matrix3::from_row_slice(&image.rotation_row_major),
                    Vector3::from(image.translation),
                ),
                pixels,
                scores,
                descriptors_nd: descriptors.take(n, d)?.to_vec(),
                point_targets,
                segments,
                segment_descriptors_nsd: segment_descriptors.take(m * s, d)?.to_vec(),
                segment_targets,
            };
            match image.variant_of {
                None => images.push(labelled),
                Some(of_image) if (of_image as usize) < images.len() => {
                    variants.push(LabelledVariant {
                        of_image,
                        image: labelled,
                    });
                }
                Some(of) => return Err(format!("a variant of picture {of}, which is not there")),
            }
        }
        Ok(Labels {
            descriptor_len: d,
            samples_per_segment: s,
            extractor: header.extractor,
            points,
            lines,
            images,
            variants,
        })
    }

    fn points(&self, d: usize) -> Result<Vec<PointTrack>, String> {
        let mut rows = self.f64s("points")?;
        let mut descriptors = self.f16s("point_descriptors")?;
        let lengths = self.i64s("point_track_lengths")?;
        let mut seen = self.i64s("point_observations")?;
        lengths
            .values
            .iter()
            .map(|length| {
                let v = rows.take(1, 4)?;
                Ok(PointTrack {
                    point_in_world: Vector3::new(v[0], v[1], v[2]),
                    mean_error_px: v[3] as f32,
                    descriptor: descriptors.take(1, d)?.to_vec(),
                    observations: take_observations(&mut seen, *length)?,
                })
            })
            .collect()
    }

    fn lines(&self, d: usize) -> Result<Vec<LineTrack>, String> {
        let mut rows = self.f64s("lines")?;
        let mut descriptors = self.f16s("line_descriptors")?;
        let lengths = self.i64s("line_track_lengths")?;
        let mut seen = self.i64s("line_observations")?;
        lengths
            .values
            .iter()
            .map(|length| {
                let v = rows.take(1, 7)?;
                Ok(LineTrack {
                    start_in_world: Vector3::new(v[0], v[1], v[2]),
                    end_in_world: Vector3::new(v[3], v[4], v[5]),
                    mean_error_px: v[6] as f32,
                    descriptor: descriptors.take(1, d)?.to_vec(),
                    observations: take_observations(&mut seen, *length)?,
                })
            })
            .collect()
    }
}

fn take_observations(rows: &mut Rows<i64>, length: i64) -> Result<Vec<Observation>, String> {
    let length =
        usize::try_from(length).map_err(|_| format!("a track has {length} observations"))?;
    let index = |v: i64| u32::try_from(v).map_err(|_| format!("observation index {v}"));
    rows.take(length, 2)?
        .chunks_exact(2)
        .map(|v| {
            Ok(Observation {
                image: index(v[0])?,
                feature: index(v[1])?,
            })
        })
        .collect()
}

fn index_below(value: i64, len: usize, name: &str) -> Result<Option<u32>, String> {
    if value == NO_TARGET {
        return Ok(None);
    }
    match u32::try_from(value) {
        Ok(index) if (index as usize) < len => Ok(Some(index)),
        _ => Err(format!("`{name}` points at track {value} of {len}")),
    }
}

/// Values that are handed out front to back.
struct Rows<T> {
    name: String,
    values: Vec<T>,
    next: usize,
}

impl<T> Rows<T> {
    fn new(name: &str, values: Vec<T>) -> Self {
        Self {
            name: name.to_owned(),
            values,
            next: 0,
        }
    }

    fn take(&mut self, rows: usize, width: usize) -> Result<&[T], String> {
        let end = rows
            .checked_mul(width)
            .and_then(|n| n.checked_add(self.next));
        let taken = end
            .and_then(|end| self.values.get(self.next..end))
            .ok_or_else(|| {
                format!(
                    "`{}` has {} values, {rows} rows of {width} were to follow value {}",
                    self.name,
                    self.values.len(),
                    self.next
                )
            })?;
        self.next += rows * width;
        Ok(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::geometry::Camera;

    fn sample() -> Labels {
        let segment = Segment2 {
            start: Pixel::new(1.0, 2.0),
            end: Pixel::new(30.0, 4.0),
            width_px: 2.0,
            precision: 0.125,
            neg_log10_nfa: 7.5,
        };
        Labels {
            descriptor_len: 2,
            samples_per_segment: 3,
            extractor: "test".to_owned(),
            points: vec![PointTrack {
                point_in_world: Vector3::new(1.0, 2.0, 3.0),
                observations: vec![
                    Observation {
                        image: 0,
                        feature: 1,
                    },
                    Observation {
                        image: 1,
                        feature: 0,
                    },
                ],
                descriptor: vec![0.5, -0.25],
                mean_error_px: 0.75,
            }],
            lines: vec![LineTrack {
                start_in_world: Vector3::new(0.0, 0.5, 1.0),
                end_in_world: Vector3::new(0.0, 1.5, 1.0),
                observations: vec![Observation {
                    image: 0,
                    feature: 0,
                }],
                descriptor: vec![1.0, 0.0],
                mean_error_px: 0.5,
            }],
            images: vec![
                LabelledImage {
                    name: "a b.jpg".to_owned(),
                    camera: Camera::centered(64, 48, 50.0),
                    cam_from_world: CamFromWorld::from_quaternion_wxyz(
                        [1.0, 0.1, 0.0, 0.0],
                        Vector3::new(0.1, 0.2, 0.3),
                    ),
                    pixels: vec![Pixel::new(0.5, 1.5), Pixel::new(3.25, 9.0)],
                    scores: vec![1.0, 0.5],
                    descriptors_nd: vec![1.0, 0.0, 0.0, 1.0],
                    point_targets: vec![None, Some(0)],
                    segments: vec![segment],
                    segment_descriptors_nsd: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
                    segment_targets: vec![Some(SegmentTarget {
                        track: 0,
                        reversed: true,
                    })],
                },
                LabelledImage {
                    name: "c.jpg".to_owned(),
                    camera: Camera::centered(64, 48, 50.0),
                    cam_from_world: CamFromWorld::identity(),
                    pixels: vec![Pixel::new(7.5, 7.5)],
                    scores: vec![0.25],
                    descriptors_nd: vec![0.5, 0.5],
                    point_targets: vec![Some(0)],
                    segments: vec![],
                    segment_descriptors_nsd: vec![],
                    segment_targets: vec![],
                },
            ],
            variants: Vec::new(),
        }
    }

    #[test]
    fn labels_survive_the_file() {
        let path = std::env::temp_dir().join(format!("labels-{}.safetensors", std::process::id()));
        let mut labels = sample();
        labels.variants.push(LabelledVariant {
            of_image: 1,
            image: labels.images[0].clone(),
        });
        labels
            .write(&path)
            .expect("the temporary folder is writable");
        assert_eq!(Labels::read(&path).expect("just written"), labels);
        let target = labels.images[0].segment_targets[0].expect("has one");
        let ends = labels.segment_target_ends(target).expect("track exists");
        assert_eq!(ends[0], labels.lines[0].end_in_world);

        let bytes = std::fs::read(&path).expect("exists");
        std::fs::write(&path, &bytes[..bytes.len() - 3]).expect("writable");
        assert!(matches!(
            Labels::read(&path),
            Err(LabelFileError::Container { .. })
        ));
        std::fs::remove_file(&path).expect("exists");
    }

    #[test]
    fn refuses_a_target_beyond_the_tracks() {
        let path = std::env::temp_dir().join(format!("labels-bad-{}.st", std::process::id()));
        let mut labels = sample();
        labels.images[0].point_targets[0] = Some(9);
        labels.write(&path).expect("writable");
        let message = Labels::read(&path)
            .expect_err("track 9 does not exist")
            .to_string();
        assert!(message.contains("track 9 of 1"), "{message}");
        std::fs::remove_file(&path).expect("exists");
    }
}
