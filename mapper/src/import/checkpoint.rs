//! Named tensors from a foreign file: PyTorch (ZIP or the older stream format) or safetensors.
//!
//! In: bytes. Out: a flat map from name to f32 tensor; half, bfloat16 and double precision are converted, integer tensors
//! (counters of batch norms) are left out. The reading never executes anything and never allocates more numbers than the
//! file has bytes.

use super::pickle::{Arena, PickleError, StorageType, TensorView, Value, ValueId};
use super::zip::{self, ZipError};
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use thiserror::Error;

/// A tensor with f32 numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct ForeignTensor {
    /// Sizes of the axes.
    pub shape: Vec<usize>,
    /// The numbers.
    pub data: Vec<f32>,
}

/// A checkpoint's tensors by their foreign names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checkpoint {
    /// The tensors.
    pub tensors: BTreeMap<String, ForeignTensor>,
}

/// Why a checkpoint could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The first bytes are of no known kind.
    #[error(
        "this is neither a PyTorch checkpoint nor a safetensors file (it begins with {found:02x?})"
    )]
    UnknownKind {
        /// First bytes.
        found: Vec<u8>,
    },
    /// The archive is damaged.
    #[error("the PyTorch checkpoint's archive is damaged")]
    Zip(#[from] ZipError),
    /// The pickle is damaged or not plain.
    #[error("the PyTorch checkpoint's pickle is refused")]
    Pickle(#[from] PickleError),
    /// The archive lacks an entry.
    #[error("PyTorch checkpoint: the archive has no entry {name}")]
    MissingEntry {
        /// The entry.
        name: String,
    },
    /// The file was written on a big-endian machine.
    #[error(
        "PyTorch checkpoint: byte order {found:?} is not supported; save it again on a little-endian machine"
    )]
    ByteOrder {
        /// What the file says.
        found: String,
    },
    /// A storage has another size than its description.
    #[error("PyTorch checkpoint: storage {key} has {found} bytes, its description needs {needed}")]
    StorageSize {
        /// Name of the storage.
        key: String,
        /// Bytes in the file.
        found: u64,
        /// Bytes needed.
        needed: u64,
    },
    /// A tensor looks outside its storage.
    #[error("PyTorch checkpoint: tensor {name} looks outside its storage {key}")]
    OutOfStorage {
        /// The tensor.
        name: String,
        /// The storage.
        key: String,
    },
    /// The tensors hold more numbers than the file has bytes: views that repeat storages.
    #[error(
        "PyTorch checkpoint: its tensors repeat storages to more numbers than the file has bytes"
    )]
    Repeats,
    /// Two tensors have one name.
    #[error("the checkpoint has two tensors called {name}")]
    Duplicate {
        /// The name.
        name: String,
    },
    /// No dictionary of tensors was found.
    #[error("the checkpoint holds no tensors under a name; save the model's state dict")]
    NoTensors,
    /// More than one dictionary of tensors and none with a usual name.
    #[error(
        "the checkpoint holds several sets of tensors ({found:?}); save only the model's state dict"
    )]
    Ambiguous {
        /// Their names.
        found: Vec<String>,
    },
    /// The safetensors header is damaged.
    #[error("the safetensors file is damaged")]
    Safetensors(#[from] safetensors::SafeTensorError),
    /// A safetensors tensor has an element type that weights do not have.
    #[error("safetensors file: tensor {name} has elements of type {found}")]
    Element {
        /// The tensor.
        name: String,
        /// Its type.
        found: Dtype,
    },
}

impl Checkpoint {
    /// Reads a file of any supported kind.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn read(bytes: &[u8]) -> Result<Self, CheckpointError> {
        if bytes.starts_with(b"PK\x03\x04") {
            return read_zip(bytes);
        }
        if bytes.starts_with(&[0x80]) {
            return read_stream(bytes);
        }
        if bytes.get(8) == Some(&b'{') {
            return read_safetensors(bytes);
        }
        Err(CheckpointError::UnknownKind {
            found: bytes[..bytes.len().min(8)].to_vec(),
        })
    }
}

fn read_safetensors(bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    let file = SafeTensors::deserialize(bytes)?;
    let mut tensors = BTreeMap::new();
    for (name, view) in file.iter() {
        let element = match view.dtype() {
            Dtype::F16 => StorageType::F16,
            Dtype::BF16 => StorageType::Bf16,
            Dtype::F32 => StorageType::F32,
            Dtype::F64 => StorageType::F64,
            Dtype::I64 | Dtype::I32 | Dtype::I16 | Dtype::I8 | Dtype::U8 | Dtype::BOOL => continue,
            found => {
                return Err(CheckpointError::Element {
                    name: name.to_owned(),
                    found,
                });
            }
        };
        let tensor = ForeignTensor {
            shape: view.shape().to_vec(),
            data: numbers(view.data(), element),
        };
        tensors.insert(name.to_owned(), tensor);
    }
    if tensors.is_empty() {
        return Err(CheckpointError::NoTensors);
    }
    Ok(Checkpoint { tensors })
}

fn read_zip(bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    let entries = zip::entries(bytes)?;
    let Some(root) = entries
        .keys()
        .find_map(|name| name.strip_suffix("data.pkl"))
    else {
        return Err(CheckpointError::MissingEntry {
            name: "data.pkl".to_owned(),
        });
    };
    if let Some(order) = entries.get(&format!("{root}byteorder")) {
        let order = String::from_utf8_lossy(&bytes[order.clone()]).into_owned();
        if order != "little" {
            return Err(CheckpointError::ByteOrder { found: order });
        }
    }
    let pickle = &bytes[entries[&format!("{root}data.pkl")].clone()];
    let mut arena = Arena::default();
    let (top, _used) = arena.read(pickle)?;
    let find = |key: &str| {
        let name = format!("{root}data/{key}");
        entries
            .get(&name)
            .cloned()
            .ok_or(CheckpointError::MissingEntry { name })
    };
    collect(bytes, &arena, top, &find)
}

/// The format before version 1.6: magic number, protocol version, system info, the pickle, the storages' names, and the
/// storages one after the other, each with its element count in front.
fn read_stream(bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    const MAGIC: [u8; 10] = [0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19];
    let mut arena = Arena::default();
    let mut at = 0;
    let mut next = |arena: &mut Arena| -> Result<(ValueId, usize), CheckpointError> {
        let (id, used) = arena.read(&bytes[at..])?;
        at += used;
        Ok((id, at))
    };
    let (magic, _) = next(&mut arena)?;
    if *arena.get(magic) != Value::LongInt(MAGIC.to_vec()) {
        return Err(CheckpointError::UnknownKind {
            found: bytes[..bytes.len().min(8)].to_vec(),
        });
    }
    next(&mut arena)?;
    next(&mut arena)?;
    let (top, _) = next(&mut arena)?;
    let (keys, mut at) = next(&mut arena)?;

    let mut described = HashMap::new();
    for id in 0..=keys {
        if let Value::Storage {
            element,
            key,
            num_elements,
        } = arena.get(id)
        {
            described.insert(key.as_str(), (*element, *num_elements));
        }
    }
    let Value::List(keys) = arena.get(keys) else {
        return Err(CheckpointError::NoTensors);
    };
    let mut ranges: HashMap<String, Range<usize>> = HashMap::new();
    for key in keys {
        let key = arena.text(*key).unwrap_or_default();
        let (element, num_elements) =
            described
                .get(key)
                .copied()
                .ok_or_else(|| CheckpointError::MissingEntry {
                    name: key.to_owned(),
                })?;
        let needed = num_elements.saturating_mul(element.num_bytes() as u64);
        let rest = &bytes[at..];
        let fits = |found: u64| CheckpointError::StorageSize {
            key: key.to_owned(),
            found,
            needed,
        };
        let Some((count, data)) = rest.split_first_chunk::<8>() else {
            return Err(fits(rest.len() as u64));
        };
        let count = u64::from_le_bytes(*count);
        if count != num_elements {
            return Err(fits(count.saturating_mul(element.num_bytes() as u64)));
        }
        if (data.len() as u64) < needed {
            return Err(fits(data.len() as u64));
        }
        let len = needed as usize;
        ranges.insert(key.to_owned(), at + 8..at + 8 + len);
        at += 8 + len;
    }
    let find = |key: &str| {
        ranges
            .get(key)
            .cloned()
            .ok_or_else(|| CheckpointError::MissingEntry {
                name: key.to_owned(),
            })
    };
    collect(bytes, &arena, top, &find)
}

/// Names under which training programs put the weights of the model.
const USUAL_NAMES: [&str; 4] = ["model_state_dict", "state_dict", "model", "weights"];

fn collect(
    bytes: &[u8],
    arena: &Arena,
    top: ValueId,
    find: &dyn Fn(&str) -> Result<Range<usize>, CheckpointError>,
) -> Result<Checkpoint, CheckpointError> {
    let tensors_of = |id: ValueId| -> Vec<(&str, &TensorView)> {
        let Value::Dict(items) = arena.get(id) else {
            return Vec::new();
        };
        items
            .iter()
            .filter_map(|(k, v)| match (arena.text(*k), arena.get(*v)) {
                (Some(name), Value::Tensor(view)) => Some((name, view)),
                _ => None,
            })
            .collect()
    };
    let mut named = tensors_of(top);
    if named.is_empty()
        && let Value::Dict(items) = arena.get(top)
    {
        let candidates: Vec<(&str, Vec<(&str, &TensorView)>)> = items
            .iter()
            .filter_map(|(k, v)| arena.text(*k).map(|name| (name, tensors_of(*v))))
            .filter(|(_, tensors)| !tensors.is_empty())
            .collect();
        let usual = USUAL_NAMES
            .iter()
            .find_map(|usual| candidates.iter().position(|(name, _)| name == usual));
        named = match (usual, candidates.len()) {
            (Some(i), _) => candidates.into_iter().nth(i),
            (None, 0 | 1) => candidates.into_iter().next(),
            (None, _) => {
                return Err(CheckpointError::Ambiguous {
                    found: candidates.iter().map(|(n, _)| (*n).to_owned()).collect(),
                });
            }
        }
        .map(|(_, tensors)| tensors)
        .unwrap_or_default();
    }
    if named.is_empty() {
        return Err(CheckpointError::NoTensors);
    }
    let mut budget = bytes.len() as u64;
    let mut tensors = BTreeMap::new();
    for (name, view) in named {
        let Value::Storage {
            element,
            key,
            num_elements,
        } = arena.get(view.storage)
        else {
            continue;
        };
        if matches!(element, StorageType::Int(_)) {
            continue;
        }
        let range = find(key)?;
        let needed = num_elements.saturating_mul(element.num_bytes() as u64);
        if range.len() as u64 != needed {
            return Err(CheckpointError::StorageSize {
                key: key.clone(),
                found: range.len() as u64,
                needed,
            });
        }
        let outside = || CheckpointError::OutOfStorage {
            name: name.to_owned(),
            key: key.clone(),
        };
        let count = view
            .shape
            .iter()
            .try_fold(1_u64, |p, n| p.checked_mul(*n))
            .ok_or_else(outside)?;
        budget = budget.checked_sub(count).ok_or(CheckpointError::Repeats)?;
        let data = gather(&bytes[range], *element, view, count).ok_or_else(outside)?;
        let shape = view.shape.iter().map(|n| *n as usize).collect();
        if tensors
            .insert(name.to_owned(), ForeignTensor { shape, data })
            .is_some()
        {
            return Err(CheckpointError::Duplicate {
                name: name.to_owned(),
            });
        }
    }
    if tensors.is_empty() {
        return Err(CheckpointError::NoTensors);
    }
    Ok(Checkpoint { tensors })
}

/// The numbers of a view, row-major, or `None` when it looks outside.
fn gather(storage: &[u8], element: StorageType, view: &TensorView, count: u64) -> Option<Vec<f32>> {
    if count == 0 {
        return Some(Vec::new());
    }
    let last = view
        .shape
        .iter()
        .zip(&view.stride)
        .try_fold(view.offset, |at, (n, stride)| {
            at.checked_add((n - 1).checked_mul(*stride)?)
        })?;
    let width = element.num_bytes();
    let available = (storage.len() / width) as u64;
    if last >= available {
        return None;
    }
    let mut expected = 1;
    let contiguous = view.shape.iter().zip(&view.stride).rev().all(|(n, s)| {
        let fits = *n == 1 || *s == expected;
        expected *= n;
        fits
    });
    let first = view.offset as usize * width;
    if contiguous {
        return Some(numbers(
            &storage[first..first + count as usize * width],
            element,
        ));
    }
    let mut index = vec![0_u64; view.shape.len()];
    let mut out = Vec::with_capacity(count as usize);
    for _ in 0..count {
        let at = view.offset
            + index
                .iter()
                .zip(&view.stride)
                .map(|(i, s)| i * s)
                .sum::<u64>();
        let at = at as usize * width;
        out.extend(numbers(&storage[at..at + width], element));
        for (i, n) in index.iter_mut().zip(&view.shape).rev() {
            *i += 1;
            if *i < *n {
                break;
            }
            *i = 0;
        }
    }
    Some(out)
}

fn numbers(bytes: &[u8], element: StorageType) -> Vec<f32> {
    match element {
        StorageType::F16 => bytes
            .as_chunks()
            .0
            .iter()
            .map(|c| f16::from_le_bytes(*c).to_f32())
            .collect(),
        StorageType::Bf16 => bytes
            .as_chunks()
            .0
            .iter()
            .map(|c| bf16::from_le_bytes(*c).to_f32())
            .collect(),
        StorageType::F32 => bytes
            .as_chunks()
            .0
            .iter()
            .map(|c| f32::from_le_bytes(*c))
            .collect(),
        StorageType::F64 => bytes
            .as_chunks()
            .0
            .iter()
            .map(|c| f64::from_le_bytes(*c) as f32)
            .collect(),
        StorageType::Int(_) => Vec::new(),
    }
}
