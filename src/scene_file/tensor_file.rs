//! The container of scene files and extractor files: safetensors with a bounded header.
//!
//! In: bytes; out: named tensors that borrow from them, and the text metadata; and the way back.
//! Reading leans on the `safetensors` crate (which checks that the blobs lie side by side without gap or overlap and end
//! with the file) and adds the bounds that a file from outside needs. Writing is our own because the crate keeps the
//! metadata in a hash map, which would give the same scene other bytes on each run.
//! Cost of reading: the header only; tensors are copied when they are taken.

use super::SceneFileError;
use crate::math::order::sort_by;
use crate::nn::{WeightTensor, Weights};
use half::f16;
use safetensors::{Dtype, SafeTensors};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Longest header read, bytes. The largest network has 116 tensors, about 12 kB of header.
pub const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Largest file read, bytes. The `paper` preset in f32 has 33 MB.
pub const MAX_FILE_BYTES: u64 = 1 << 29;

/// Suffix of the tensor that holds the row factors of an 8-bit tensor.
const SCALE_SUFFIX: &str = ".scale";

/// How the numbers of a tensor are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Element {
    /// 32-bit IEEE.
    F32,
    /// 16-bit IEEE.
    F16,
    /// 8-bit integers times one f32 factor for each row, which lies in a second tensor named `NAME.scale`. The integers reach
    /// from `-largest` to `largest`: a smaller range compresses better.
    I8 {
        /// From 1 to 127.
        largest: i8,
    },
}

impl Element {
    /// All that eight bits can say.
    pub const EIGHT_BIT: Self = Self::I8 { largest: i8::MAX };
}

/// A parsed file: metadata, and tensors that borrow the bytes.
#[derive(Debug)]
pub struct TensorFile<'a> {
    metadata: BTreeMap<String, String>,
    tensors: SafeTensors<'a>,
}

impl<'a> TensorFile<'a> {
    /// Checks the header and that it accounts for every byte.
    ///
    /// # Errors
    /// [`SceneFileError::TooLarge`], [`SceneFileError::Truncated`], [`SceneFileError::HeaderTooLong`],
    /// [`SceneFileError::Header`].
    pub fn parse(bytes: &'a [u8]) -> Result<Self, SceneFileError> {
        let len = u64::try_from(bytes.len()).unwrap_or(u64::MAX);
        if len > MAX_FILE_BYTES {
            return Err(SceneFileError::TooLarge {
                found: len,
                limit: MAX_FILE_BYTES,
            });
        }
        let Some(prefix) = bytes.first_chunk::<8>() else {
            return Err(SceneFileError::Truncated {
                found: len,
                needed: 8,
            });
        };
        let header = u64::from_le_bytes(*prefix);
        if header > MAX_HEADER_BYTES {
            return Err(SceneFileError::HeaderTooLong {
                found: header,
                limit: MAX_HEADER_BYTES,
            });
        }
        if len < header.saturating_add(8) {
            return Err(SceneFileError::Truncated {
                found: len,
                needed: header.saturating_add(8),
            });
        }
        let header_error = |source: safetensors::SafeTensorError| SceneFileError::Header {
            reason: source.to_string(),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(header_error)?;
        let metadata = header
            .metadata()
            .iter()
            .flatten()
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect();
        let tensors = SafeTensors::deserialize(bytes).map_err(header_error)?;
        Ok(Self { metadata, tensors })
    }

    /// All metadata.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// A metadata value.
    ///
    /// # Errors
    /// [`SceneFileError::MissingKey`].
    pub fn text(&self, key: &'static str) -> Result<&str, SceneFileError> {
        self.metadata
            .get(key)
            .map(String::as_str)
            .ok_or(SceneFileError::MissingKey { key })
    }

    /// Names, element types and shapes in alphabetical order, for listings.
    pub fn entries(&self) -> Vec<(&str, String, Vec<usize>)> {
        let mut out: Vec<_> = self
            .tensors
            .iter()
            .map(|(name, view)| (name, view.dtype().to_string(), view.shape().to_vec()))
            .collect();
        sort_by(&mut out, |a, b| a.0.cmp(b.0));
        out
    }

    /// Names of all tensors, in no particular order.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.iter().map(|(name, _)| name)
    }

    /// The bytes of a tensor that holds no weights: of this element type, with so many columns or with one axis.
    ///
    /// # Errors
    /// [`SceneFileError::LandmarkTensor`] when it is missing, or of another type or shape.
    pub(crate) fn raw(
        &self,
        name: &str,
        dtype: &str,
        columns: Option<usize>,
    ) -> Result<&'a [u8], SceneFileError> {
        let bad = |reason: String| SceneFileError::LandmarkTensor {
            tensor: name.to_owned(),
            reason,
        };
        let Ok(view) = self.tensors.tensor(name) else {
            return Err(bad("is missing".to_owned()));
        };
        let is_shape = match (view.shape(), columns) {
            ([_], None) => true,
            ([_, found], Some(expected)) => *found == expected,
            _ => false,
        };
        if view.dtype().to_string() != dtype || !is_shape {
            let expected = columns.map_or("[n]".to_owned(), |c| format!("[n, {c}]"));
            return Err(bad(format!(
                "has elements of type {} and shape {:?}, expected {dtype} and {expected}",
                view.dtype(),
                view.shape()
            )));
        }
        Ok(view.data())
    }

    /// All tensors as weights; 8-bit ones multiplied out. The landmarks' are left out.
    ///
    /// # Errors
    /// [`SceneFileError::Element`] for element types other than f32, f16 and i8, [`SceneFileError::NotFinite`],
    /// [`SceneFileError::RowScale`].
    pub fn weights(&self) -> Result<Weights, SceneFileError> {
        let mut out = Weights::new();
        let is_weight = |(name, _): &(&str, _)| !name.starts_with(super::landmarks::PREFIX);
        for (name, view) in self.tensors.iter().filter(is_weight) {
            let shape = view.shape();
            let tensor = match view.dtype() {
                Dtype::F32 if self.is_row_scale(name) => continue,
                Dtype::F32 => {
                    WeightTensor::f32(shape, finite(name, f32_from_le(view.data()), |x| x)?)
                }
                Dtype::F16 => {
                    let data: Vec<f16> = view
                        .data()
                        .as_chunks::<2>()
                        .0
                        .iter()
                        .map(|c| f16::from_le_bytes(*c))
                        .collect();
                    WeightTensor::f16(shape, finite(name, data, f16::to_f32)?)
                }
                Dtype::I8 => WeightTensor::f32(shape, self.scaled_rows(name, shape, view.data())?),
                other => {
                    return Err(SceneFileError::Element {
                        tensor: name.to_owned(),
                        found: other.to_string(),
                    });
                }
            };
            out.insert(
                name,
                tensor.map_err(|source| SceneFileError::Header {
                    reason: source.to_string(),
                })?,
            );
        }
        Ok(out)
    }

    fn is_row_scale(&self, name: &str) -> bool {
        name.strip_suffix(SCALE_SUFFIX)
            .and_then(|base| self.tensors.tensor(base).ok())
            .is_some_and(|view| view.dtype() == Dtype::I8)
    }

    fn scaled_rows(
        &self,
        name: &str,
        shape: &[usize],
        data: &[u8],
    ) -> Result<Vec<f32>, SceneFileError> {
        let bad = |reason: String| SceneFileError::RowScale {
            tensor: name.to_owned(),
            reason,
        };
        let rows = shape.first().copied().unwrap_or(0);
        if shape.len() < 2 || rows == 0 {
            return Err(bad(format!(
                "an 8-bit tensor needs rows, found shape {shape:?}"
            )));
        }
        let scale_name = format!("{name}{SCALE_SUFFIX}");
        let Ok(scale) = self.tensors.tensor(&scale_name) else {
            return Err(bad(format!("there is no tensor {scale_name}")));
        };
        if scale.dtype() != Dtype::F32 || scale.shape() != [rows] {
            return Err(bad(format!(
                "{scale_name} has type {} and shape {:?}, expected F32 and [{rows}]",
                scale.dtype(),
                scale.shape()
            )));
        }
        let factors = finite(&scale_name, f32_from_le(scale.data()), |x| x)?;
        let columns = data.len() / rows;
        let mut out = Vec::with_capacity(data.len());
        for (row, factor) in data.chunks_exact(columns.max(1)).zip(factors) {
            out.extend(
                row.iter()
                    .map(|b| f32::from(i8::from_le_bytes([*b])) * factor),
            );
        }
        // A factor near the largest number overflows.
        finite(name, out, |x| x)
    }
}

fn f32_from_le(bytes: &[u8]) -> Vec<f32> {
    bytes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|c| f32::from_le_bytes(*c))
        .collect()
}

fn finite<T: Copy>(
    name: &str,
    data: Vec<T>,
    to_f32: impl Fn(T) -> f32,
) -> Result<Vec<T>, SceneFileError> {
    match data.iter().position(|x| !to_f32(*x).is_finite()) {
        None => Ok(data),
        Some(index) => Err(SceneFileError::NotFinite {
            tensor: name.to_owned(),
            index,
        }),
    }
}

/// A tensor whose bytes are written as they are.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RawTensor {
    pub(crate) name: &'static str,
    /// As safetensors calls it.
    pub(crate) dtype: &'static str,
    pub(crate) shape: Vec<usize>,
    pub(crate) bytes: Vec<u8>,
}

struct Blob<'a> {
    dtype: &'static str,
    shape: Cow<'a, [usize]>,
    bytes: Vec<u8>,
}

/// The bytes of a file. `element_of` chooses the storage of each tensor by name and shape.
///
/// Equal input gives equal bytes: blobs are ordered by size of their elements (so that all are aligned) and name.
///
/// # Errors
/// [`SceneFileError::NotFinite`] for a NaN or an infinity, or a number that the chosen storage cannot hold.
pub fn serialize(
    metadata: &BTreeMap<String, String>,
    weights: &Weights,
    element_of: impl Fn(&str, &[usize]) -> Element,
) -> Result<Vec<u8>, SceneFileError> {
    serialize_with(metadata, weights, Vec::new(), element_of)
}

/// [`serialize`] with further tensors.
pub(crate) fn serialize_with(
    metadata: &BTreeMap<String, String>,
    weights: &Weights,
    raw: Vec<RawTensor>,
    element_of: impl Fn(&str, &[usize]) -> Element,
) -> Result<Vec<u8>, SceneFileError> {
    let mut blobs: Vec<(String, Blob<'_>)> = Vec::with_capacity(weights.len() + raw.len());
    for tensor in raw {
        let blob = Blob {
            dtype: tensor.dtype,
            shape: Cow::Owned(tensor.shape),
            bytes: tensor.bytes,
        };
        blobs.push((tensor.name.to_owned(), blob));
    }
    for (name, tensor) in weights.iter() {
        let shape = tensor.shape();
        let data = finite(name, tensor.to_f32(), |x| x)?;
        let (dtype, bytes) = match element_of(name, shape) {
            Element::F16 => {
                let half = data.iter().map(|x| f16::from_f32(*x)).collect();
                let half = finite(name, half, f16::to_f32)?;
                ("F16", half.iter().flat_map(|x| x.to_le_bytes()).collect())
            }
            Element::I8 { largest } if shape.len() >= 2 && !data.is_empty() => {
                let (bytes, scales) = quantize_rows(&data, shape[0], largest);
                let scales = scales.iter().flat_map(|x| x.to_le_bytes()).collect();
                blobs.push((
                    format!("{name}{SCALE_SUFFIX}"),
                    Blob {
                        dtype: "F32",
                        shape: Cow::Owned(vec![shape[0]]),
                        bytes: scales,
                    },
                ));
                ("I8", bytes)
            }
            Element::F32 | Element::I8 { .. } => {
                ("F32", data.iter().flat_map(|x| x.to_le_bytes()).collect())
            }
        };
        blobs.push((
            name.to_owned(),
            Blob {
                dtype,
                shape: Cow::Borrowed(shape),
                bytes,
            },
        ));
    }
    let rank = |dtype: &str| match dtype {
        "F32" => 0_u8,
        "F16" | "U16" => 1,
        _ => 2,
    };
    sort_by(&mut blobs, |a, b| {
        (rank(a.1.dtype), &a.0).cmp(&(rank(b.1.dtype), &b.0))
    });

    let mut header = serde_json::Map::new();
    if !metadata.is_empty() {
        header.insert("__metadata__".to_owned(), serde_json::json!(metadata));
    }
    let mut offset = 0_usize;
    for (name, blob) in &blobs {
        let end = offset + blob.bytes.len();
        header.insert(
            name.clone(),
            serde_json::json!({
                "dtype": blob.dtype,
                "shape": blob.shape,
                "data_offsets": [offset, end],
            }),
        );
        offset = end;
    }
    let mut out = header_bytes(header)?;
    out.reserve_exact(offset);
    for (_, blob) in &blobs {
        out.extend_from_slice(&blob.bytes);
    }
    Ok(out)
}

/// The length of a header and the header, filled up to a multiple of eight bytes.
fn header_bytes(
    header: serde_json::Map<String, serde_json::Value>,
) -> Result<Vec<u8>, SceneFileError> {
    let mut text = serde_json::Value::Object(header).to_string().into_bytes();
    text.resize(text.len().next_multiple_of(8), b' ');
    let header_len = u64::try_from(text.len()).unwrap_or(u64::MAX);
    if header_len > MAX_HEADER_BYTES {
        return Err(SceneFileError::HeaderTooLong {
            found: header_len,
            limit: MAX_HEADER_BYTES,
        });
    }
    let mut out = header_len.to_le_bytes().to_vec();
    out.extend_from_slice(&text);
    Ok(out)
}

/// A file with other metadata: the header is written anew, every tensor stays where it is.
///
/// # Errors
/// As [`TensorFile::parse`].
pub(super) fn replace_metadata(
    bytes: &[u8],
    change: impl FnOnce(&mut BTreeMap<String, String>),
) -> Result<Vec<u8>, SceneFileError> {
    let mut metadata = TensorFile::parse(bytes)?.metadata;
    change(&mut metadata);
    let damaged = |reason: String| SceneFileError::Header { reason };
    let (header_len, _) = SafeTensors::read_metadata(bytes).map_err(|e| damaged(e.to_string()))?;
    let (header, tensors) = bytes
        .get(8..)
        .and_then(|rest| rest.split_at_checked(header_len))
        .ok_or_else(|| damaged("its length is not that of the file".to_owned()))?;
    let mut header: serde_json::Map<String, serde_json::Value> =
        serde_json::from_slice(header).map_err(|e| damaged(e.to_string()))?;
    header.insert("__metadata__".to_owned(), serde_json::json!(metadata));
    let mut out = header_bytes(header)?;
    out.extend_from_slice(tensors);
    Ok(out)
}

/// Symmetric 8-bit rows: each row is divided by its largest magnitude over 127.
fn quantize_rows(data: &[f32], rows: usize, largest: i8) -> (Vec<u8>, Vec<f32>) {
    let largest = f32::from(largest.max(1));
    let columns = (data.len() / rows.max(1)).max(1);
    let mut bytes = Vec::with_capacity(data.len());
    let mut scales = Vec::with_capacity(rows);
    for row in data.chunks_exact(columns) {
        let scale = row.iter().fold(0.0_f32, |m, x| m.max(x.abs())) / largest;
        let inverse = if scale > 0.0 { 1.0 / scale } else { 0.0 };
        scales.push(scale);
        #[expect(
            clippy::as_conversions,
            clippy::cast_possible_truncation,
            reason = "rounded and clamped to the range of i8"
        )]
        bytes.extend(row.iter().map(|x| {
            let q = (x * inverse).round().clamp(-largest, largest) as i8;
            q.to_le_bytes()[0]
        }));
    }
    (bytes, scales)
}
