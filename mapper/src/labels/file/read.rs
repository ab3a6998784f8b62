//! Label file to labels, with every count checked.

use super::super::{LabelledVariant, Labels, Origin};
use super::LabelFileError;
use half::f16;
use landline::features::{FeatureSet, Keypoint};
use landline::formats::rigid_from_matrix;
use landline::geometry::{CamFromWorld, Pixel, Segment2};
use landline::mapping::{LABEL_FORMAT, LABEL_VERSION, LabelHeader};
use landline::models::ExtractorKind;
use landline::reconstruction::{LineTrack, Observation, PointTrack, Reconstruction, View};
use landline::scene_file::Units;
use nalgebra::{Matrix3, Vector3};
use safetensors::tensor::{Dtype, SafeTensors};
use std::path::Path;

impl Labels {
    /// Reads what [`Labels::write`] wrote, of this version.
    ///
    /// # Errors
    /// When the file is missing, damaged, or of another format.
    pub fn read(path: &Path) -> Result<Self, LabelFileError> {
        let bytes = std::fs::read(path).map_err(|source| LabelFileError::Io {
            path: path.to_owned(),
            source,
        })?;
        Self::from_bytes(&bytes, path)
    }

    /// [`Self::read`] of bytes that are there already; errors say that they are of `path`.
    ///
    /// # Errors
    /// When they are damaged, or of another format.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, LabelFileError> {
        let container = |source| LabelFileError::Container {
            path: path.to_owned(),
            source,
        };
        let content = |what: String| LabelFileError::Content {
            path: path.to_owned(),
            what,
        };
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(container)?;
        let entries = metadata.metadata().clone().unwrap_or_default();
        let version = entries
            .get("format")
            .and_then(|format| format.strip_prefix(LABEL_FORMAT))
            .ok_or_else(|| content(format!("its `format` is not `{LABEL_FORMAT}`")))?
            .trim();
        if version != LABEL_VERSION.to_string() {
            return Err(LabelFileError::Version {
                path: path.to_owned(),
                found: version.to_owned(),
            });
        }
        let header: LabelHeader = entries
            .get("labels")
            .ok_or_else(|| content("its header has no entry `labels`".to_owned()))
            .and_then(|json| serde_json::from_str(json).map_err(|e| content(e.to_string())))?;
        let value = |(field, found, expected)| LabelFileError::Value {
            path: path.to_owned(),
            field,
            found,
            expected,
        };
        let origin = origin(&header).map_err(value)?;
        let (units, gravity) = world(&header).map_err(value)?;
        let file = SafeTensors::deserialize(bytes).map_err(container)?;
        let labels = Columns { file: &file }.labels(header);
        labels
            .map(|mut labels| {
                labels.origin = origin;
                labels.map.units = units;
                labels.map.gravity = gravity;
                labels
            })
            .map_err(content)
    }

    /// [`Self::read`] of labels whose features have to be of the extractor with this checkpoint.
    ///
    /// # Errors
    /// As [`Self::read`], and [`LabelFileError::WrongExtractor`].
    pub fn read_for(
        path: &Path,
        extractor: ExtractorKind,
        sha256: &str,
    ) -> Result<Self, LabelFileError> {
        let labels = Self::read(path)?;
        if labels.origin.is_of(extractor, sha256) {
            return Ok(labels);
        }
        let told = |name: &str, sha256: &str| format!("{name} ({sha256})");
        Err(LabelFileError::WrongExtractor {
            path: path.to_owned(),
            labels: told(
                labels.origin.extractor.name(),
                &labels.origin.extractor_sha256,
            ),
            loaded: told(extractor.name(), sha256),
        })
    }
}

/// A field, what it holds, and what it should.
type WrongField = (&'static str, String, &'static str);

/// What a header says of its labels' origin, or which field holds what in place of what.
fn origin(header: &LabelHeader) -> Result<Origin, WrongField> {
    let extractor = ExtractorKind::from_name(&header.extractor).ok_or_else(|| {
        (
            "extractor",
            header.extractor.clone(),
            "not a known extractor",
        )
    })?;
    let sha256 = &header.extractor_sha256;
    if sha256.len() != 64 || !sha256.bytes().all(|b| b.is_ascii_hexdigit()) {
        let expected = "expected the SHA-256 of a checkpoint, 64 hexadecimal digits";
        return Err(("extractor_sha256", sha256.clone(), expected));
    }
    if !(16..=8192).contains(&header.working_max_side) {
        let found = header.working_max_side.to_string();
        return Err(("working_max_side", found, "expected 16 to 8192 pixels"));
    }
    Ok(Origin {
        extractor,
        extractor_sha256: sha256.clone(),
        working_max_side: header.working_max_side,
        source: header.source.clone(),
    })
}

/// What a header says of its world: unit of lengths, direction of gravity; or which field holds what in place of what.
fn world(header: &LabelHeader) -> Result<(Units, Option<Vector3<f64>>), WrongField> {
    let units = Units::from_name(&header.units)
        .ok_or_else(|| ("units", header.units.clone(), "expected `m` or `arbitrary`"))?;
    if let Some(g) = header.gravity
        && (Vector3::from(g).norm() - 1.0).abs() > 1e-3
    {
        return Err(("gravity", format!("{g:?}"), "must be a unit vector"));
    }
    Ok((units, header.gravity.map(Vector3::from)))
}

struct Columns<'a> {
    file: &'a SafeTensors<'a>,
}

impl<'a> Columns<'a> {
    fn rows<const N: usize, T>(
        &self,
        name: &'static str,
        dtype: Dtype,
        read: fn([u8; N]) -> T,
        is_sound: fn(&T) -> bool,
    ) -> Result<Rows<'a, N, T>, String> {
        let tensor = self.file.tensor(name).map_err(|e| e.to_string())?;
        if tensor.dtype() != dtype {
            return Err(format!(
                "`{name}` is {:?}, expected {dtype:?}",
                tensor.dtype()
            ));
        }
        Ok(Rows {
            name,
            values: tensor.data().as_chunks::<N>().0,
            read,
            is_sound,
            next: 0,
        })
    }
    fn f64s(&self, name: &'static str) -> Result<Rows<'a, 8, f64>, String> {
        self.rows(name, Dtype::F64, f64::from_le_bytes, |v| v.is_finite())
    }
    fn f32s(&self, name: &'static str) -> Result<Rows<'a, 4, f32>, String> {
        self.rows(name, Dtype::F32, f32::from_le_bytes, |v| v.is_finite())
    }
    fn f16s(&self, name: &'static str) -> Result<Rows<'a, 2, f32>, String> {
        self.rows(
            name,
            Dtype::F16,
            |b| f16::from_le_bytes(b).to_f32(),
            |v| v.is_finite(),
        )
    }
    fn i64s(&self, name: &'static str) -> Result<Rows<'a, 8, i64>, String> {
        self.rows(name, Dtype::I64, i64::from_le_bytes, |_| true)
    }

    fn labels(&self, header: LabelHeader) -> Result<Labels, String> {
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
        let mut segments = self.f64s("segments")?;
        let mut segment_descriptors = self.f16s("segment_descriptors")?;
        let mut views: Vec<View> = Vec::with_capacity(header.images.len());
        let mut variants = Vec::new();
        for image in header.images {
            let (n, m) = (image.num_keypoints, image.num_segments);
            let rows_of_segments = m
                .checked_mul(s)
                .ok_or_else(|| format!("{}: {m} segments of {s} samples", image.name))?;
            let features = FeatureSet {
                keypoints: keypoints
                    .take(n, 3)?
                    .chunks_exact(3)
                    .map(|row| Keypoint {
                        pixel: Pixel::new(f64::from(row[0]), f64::from(row[1])),
                        score: row[2],
                    })
                    .collect(),
                descriptors_nd: descriptors.take(n, d)?,
                segments: segments
                    .take(m, 7)?
                    .as_chunks()
                    .0
                    .iter()
                    .map(|numbers| Segment2::from_numbers(*numbers))
                    .collect(),
                segment_descriptors_nsd: segment_descriptors.take(rows_of_segments, d)?,
                descriptor_channels: d,
                tokens: s,
            };
            match image.variant_of {
                None => {
                    let pose = CamFromWorld::new(
                        Matrix3::from_row_slice(&image.rotation_row_major),
                        Vector3::from(image.translation),
                    );
                    // Checked, not repaired: what was written comes back bit for bit.
                    rigid_from_matrix::<(), ()>(&pose.rotation, pose.translation)
                        .map_err(|problem| format!("pose of {}: {problem}", image.name))?;
                    views.push(View {
                        name: image.name,
                        camera: image.camera.to_camera().map_err(|e| e.to_string())?,
                        cam_from_world: Some(pose),
                        features,
                    });
                }
                Some(of_view) if (of_view as usize) < views.len() => {
                    variants.push(LabelledVariant { of_view, features });
                }
                Some(of) => return Err(format!("a variant of picture {of}, which is not there")),
            }
        }
        let map = Reconstruction {
            points: self.points(d, &views)?,
            lines: self.lines(d, &views)?,
            views,
            ..Reconstruction::default()
        };
        Ok(Labels {
            origin: Origin::default(),
            map,
            variants,
        })
    }

    fn points(&self, d: usize, views: &[View]) -> Result<Vec<PointTrack>, String> {
        let mut rows = self.f64s("points")?.unchecked();
        let mut descriptors = self.f16s("point_descriptors")?;
        let mut seen = self.i64s("point_observations")?;
        let num_keypoints = |f: &FeatureSet| f.keypoints.len();
        self.i64s("point_track_lengths")?
            .all()
            .map(|length| {
                let v = rows.take(1, 4)?;
                check_place("points", &v[..3])?;
                Ok(PointTrack {
                    point_in_world: Vector3::new(v[0], v[1], v[2]),
                    mean_error_px: v[3] as f32,
                    descriptor: descriptors.take(1, d)?,
                    observations: take_observations(&mut seen, length, views, &num_keypoints)?,
                })
            })
            .collect()
    }

    fn lines(&self, d: usize, views: &[View]) -> Result<Vec<LineTrack>, String> {
        let mut rows = self.f64s("lines")?.unchecked();
        let mut descriptors = self.f16s("line_descriptors")?;
        let mut seen = self.i64s("line_observations")?;
        let num_segments = |f: &FeatureSet| f.segments.len();
        self.i64s("line_track_lengths")?
            .all()
            .map(|length| {
                let v = rows.take(1, 7)?;
                check_place("lines", &v[..6])?;
                Ok(LineTrack {
                    start_in_world: Vector3::new(v[0], v[1], v[2]),
                    end_in_world: Vector3::new(v[3], v[4], v[5]),
                    mean_error_px: v[6] as f32,
                    descriptor: descriptors.take(1, d)?,
                    observations: take_observations(&mut seen, length, views, &num_segments)?,
                })
            })
            .collect()
    }
}

/// Of a track that nobody has measured the error is NaN; where it is has to be a number.
fn check_place(name: &str, coordinates: &[f64]) -> Result<(), String> {
    if coordinates.iter().all(|v| v.is_finite()) {
        Ok(())
    } else {
        Err(format!("`{name}` holds a position that is not finite"))
    }
}

/// The next observations, of features that the views have.
fn take_observations(
    rows: &mut Rows<'_, 8, i64>,
    length: i64,
    views: &[View],
    num_features: &dyn Fn(&FeatureSet) -> usize,
) -> Result<Vec<Observation>, String> {
    let name = rows.name;
    let length =
        usize::try_from(length).map_err(|_| format!("`{name}`: a track of {length} views"))?;
    let index = |value: i64, len: usize, of: &str| match usize::try_from(value) {
        Ok(index) if index < len => Ok(index),
        _ => Err(format!("`{name}` points at {of} {value} of {len}")),
    };
    rows.take(length, 2)?
        .chunks_exact(2)
        .map(|v| {
            let view = index(v[0], views.len(), "picture")?;
            let feature = index(v[1], num_features(&views[view].features), "feature")?;
            Ok(Observation::new(view, feature))
        })
        .collect()
}

/// Values that are handed out front to back, converted as they go.
struct Rows<'a, const N: usize, T> {
    name: &'static str,
    values: &'a [[u8; N]],
    read: fn([u8; N]) -> T,
    is_sound: fn(&T) -> bool,
    next: usize,
}

impl<'a, const N: usize, T> Rows<'a, N, T> {
    fn take(&mut self, rows: usize, width: usize) -> Result<Vec<T>, String> {
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
        let values: Vec<T> = taken.iter().map(|bytes| (self.read)(*bytes)).collect();
        if let Some(at) = values.iter().position(|v| !(self.is_sound)(v)) {
            return Err(format!(
                "value {} of `{}` is not finite",
                self.next + at,
                self.name
            ));
        }
        self.next += rows * width;
        Ok(values)
    }

    fn unchecked(self) -> Self {
        Self {
            is_sound: |_| true,
            ..self
        }
    }

    fn all(self) -> impl Iterator<Item = T> + 'a
    where
        T: 'a,
    {
        self.values.iter().map(move |bytes| (self.read)(*bytes))
    }
}
