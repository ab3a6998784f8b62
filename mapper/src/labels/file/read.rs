//! Label file to labels, with every count checked.

use super::super::{
    LabelledImage, LabelledVariant, Labels, LineTrack, Observation, PointTrack, SegmentTarget,
};
use super::{FORMAT, Header, LabelFileError, NO_TARGET};
use half::f16;
use landline::geometry::{CamFromWorld, Pixel, Segment2};
use nalgebra::{Matrix3, Vector3};
use safetensors::tensor::{Dtype, SafeTensors};
use std::path::Path;

impl Labels {
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
