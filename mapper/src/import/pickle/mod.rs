//! Reader of the small part of Python's pickle format that `torch.save` uses for tensors. It never executes anything.
//!
//! In: the bytes of one pickle stream. Out: an [`Arena`] of plain values with the index of the top one.
//! A pickle is a program for a stack machine; this machine knows data opcodes and a fixed list of names, and everything
//! else is refused by name and position. Values live in an arena and are referred to by index, so memo references cost
//! nothing and the memory is bounded by the number of opcodes, thus by the length of the stream.
//! Source: the opcode descriptions in Python's `pickletools` documentation.

mod machine;

use machine::Machine;
use thiserror::Error;

/// Index of a value in an [`Arena`].
pub type ValueId = u32;

/// Element type of a PyTorch storage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StorageType {
    /// 16-bit IEEE.
    F16,
    /// Upper half of a 32-bit IEEE number.
    Bf16,
    /// 32-bit IEEE.
    F32,
    /// 64-bit IEEE.
    F64,
    /// Integers or truth values of this many bytes; no network keeps weights in them.
    Int(u8),
}

impl StorageType {
    /// Bytes of one element.
    pub fn num_bytes(self) -> usize {
        match self {
            Self::F16 | Self::Bf16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
            Self::Int(n) => usize::from(n),
        }
    }

    fn from_class(name: &str) -> Option<Self> {
        Some(match name {
            "HalfStorage" => Self::F16,
            "BFloat16Storage" => Self::Bf16,
            "FloatStorage" => Self::F32,
            "DoubleStorage" => Self::F64,
            "LongStorage" => Self::Int(8),
            "IntStorage" => Self::Int(4),
            "ShortStorage" => Self::Int(2),
            "CharStorage" | "ByteStorage" | "BoolStorage" => Self::Int(1),
            _ => return None,
        })
    }
}

/// The names that a checkpoint may refer to. A name outside this list ends the reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Known {
    /// `collections.OrderedDict`.
    OrderedDict,
    /// `torch._utils._rebuild_tensor_v2` and its older form without the last arguments.
    RebuildTensor,
    /// `torch._utils._rebuild_parameter`.
    RebuildParameter,
    /// `torch.Size`: a tuple.
    Size,
    /// One of the storage classes.
    Storage(StorageType),
}

/// A tensor as the pickle describes it: a view into a storage.
#[derive(Debug, Clone, PartialEq)]
pub struct TensorView {
    /// The [`Value::Storage`] it looks into.
    pub storage: ValueId,
    /// First element.
    pub offset: u64,
    /// Size of each axis.
    pub shape: Vec<u64>,
    /// Elements to step for each axis.
    pub stride: Vec<u64>,
}

/// One plain value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// `None`.
    None,
    /// Truth value.
    Bool(bool),
    /// Integer of up to 63 bits.
    Int(i64),
    /// An integer that needs more bits, as its little-endian bytes.
    LongInt(Vec<u8>),
    /// Floating-point number.
    Float(f64),
    /// Text.
    Str(String),
    /// Tuple.
    Tuple(Vec<ValueId>),
    /// List.
    List(Vec<ValueId>),
    /// Dictionary or ordered dictionary, in the order of insertion.
    Dict(Vec<(ValueId, ValueId)>),
    /// A name from the permitted list.
    Known(Known),
    /// A raw storage elsewhere in the file.
    Storage {
        /// Element type.
        element: StorageType,
        /// Name of the storage in the file.
        key: String,
        /// Number of elements.
        num_elements: u64,
    },
    /// A tensor.
    Tensor(TensorView),
}

impl Value {
    fn kind(&self) -> &'static str {
        match self {
            Self::None => "None",
            Self::Bool(_) => "a truth value",
            Self::Int(_) | Self::LongInt(_) => "an integer",
            Self::Float(_) => "a number",
            Self::Str(_) => "text",
            Self::Tuple(_) => "a tuple",
            Self::List(_) => "a list",
            Self::Dict(_) => "a dictionary",
            Self::Known(_) => "a class or function",
            Self::Storage { .. } => "a storage",
            Self::Tensor(_) => "a tensor",
        }
    }
}

/// Why a pickle stream was refused.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum PickleError {
    /// The stream ends inside an instruction.
    #[error("the pickle ends at byte {at}, inside an instruction; the file is truncated")]
    Truncated {
        /// Position in the stream.
        at: usize,
    },
    /// An instruction outside the permitted subset.
    #[error(
        "pickle opcode 0x{opcode:02x} at byte {at} is outside the subset that tensors need; save only the state dict"
    )]
    Opcode {
        /// The instruction.
        opcode: u8,
        /// Position in the stream.
        at: usize,
    },
    /// A class or function outside the permitted list. It is never imported or called.
    #[error(
        "the pickle refers to {module}.{name} (byte {at}), which a checkpoint of tensors does not need and which is never called; save only the state dict"
    )]
    Name {
        /// Python module.
        module: String,
        /// Name in the module.
        name: String,
        /// Position in the stream.
        at: usize,
    },
    /// The stack or the memo does not hold what an instruction needs.
    #[error("the pickle is inconsistent at byte {at}: {what}")]
    Inconsistent {
        /// What was missing.
        what: &'static str,
        /// Position in the stream.
        at: usize,
    },
    /// An argument has the wrong kind.
    #[error("the pickle is inconsistent at byte {at}: expected {expected}, found {found}")]
    Kind {
        /// What was needed.
        expected: &'static str,
        /// What was there.
        found: &'static str,
        /// Position in the stream.
        at: usize,
    },
    /// Text that is not UTF-8.
    #[error("the pickle holds text that is not UTF-8 at byte {at}")]
    Text {
        /// Position in the stream.
        at: usize,
    },
}

/// Values of one pickle stream.
#[derive(Debug, Default)]
pub struct Arena {
    values: Vec<Value>,
}

impl Arena {
    /// The value behind an index that this arena handed out.
    pub fn get(&self, id: ValueId) -> &Value {
        &self.values[id as usize]
    }

    /// Text behind an index.
    pub fn text(&self, id: ValueId) -> Option<&str> {
        match self.get(id) {
            Value::Str(s) => Some(s),
            _ => None,
        }
    }

    /// Reads one stream. Returns the top value and the number of bytes read.
    ///
    /// # Errors
    /// [`PickleError`] for everything outside the subset.
    pub fn read(&mut self, bytes: &[u8]) -> Result<(ValueId, usize), PickleError> {
        Machine::new(bytes, self).run()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<(Arena, ValueId), PickleError> {
        let mut arena = Arena::default();
        let (id, _used) = arena.read(bytes)?;
        Ok((arena, id))
    }

    #[test]
    fn reads_nested_containers_and_memo_references() {
        // {"a": [1, -2], "b": ("a", None, True)} with "a" recalled from the memo.
        let bytes =
            b"\x80\x02}(U\x01aq\x00](K\x01J\xfe\xff\xff\xffeX\x01\x00\x00\x00b(h\x00N\x88tu.";
        let (arena, id) = read(bytes).expect("valid");
        let Value::Dict(items) = arena.get(id) else {
            panic!("not a dictionary")
        };
        assert_eq!(items.len(), 2);
        let Value::List(list) = arena.get(items[0].1) else {
            panic!("not a list")
        };
        assert_eq!(*arena.get(list[1]), Value::Int(-2));
        let Value::Tuple(tuple) = arena.get(items[1].1) else {
            panic!("not a tuple")
        };
        assert_eq!(arena.text(tuple[0]), Some("a"));
    }

    #[test]
    fn refuses_names_outside_the_list_without_calling_them() {
        let bytes = b"\x80\x02cos\nsystem\nU\x02ls\x85R.";
        match read(bytes) {
            Err(PickleError::Name { module, name, .. }) => {
                assert_eq!((module.as_str(), name.as_str()), ("os", "system"));
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn refuses_opcodes_outside_the_subset() {
        for opcode in [b'i', b'o', 0x81, 0x92, b'P', 0x82, b'0', b'2'] {
            let got = read(&[0x80, 2, opcode, b'.']);
            assert_eq!(
                got.map(|_| ()).expect_err("must refuse"),
                PickleError::Opcode { opcode, at: 2 }
            );
        }
    }

    #[test]
    fn a_memo_slot_far_away_costs_no_more_than_a_near_one() {
        let (arena, id) =
            read(b"\x80\x02Nr\xff\xff\xff\xffj\xff\xff\xff\xff\x86.").expect("as Python reads it");
        let Value::Tuple(both) = arena.get(id) else {
            panic!("not a pair: {:?}", arena.get(id));
        };
        assert!(both.len() == 2 && both.iter().all(|id| *arena.get(*id) == Value::None));
    }

    #[test]
    fn truncation_at_every_byte_is_an_error() {
        let bytes =
            b"\x80\x02}(U\x01aq\x00](K\x01J\xfe\xff\xff\xffeX\x01\x00\x00\x00b(h\x00N\x88tu.";
        for n in 0..bytes.len() {
            assert!(read(&bytes[..n]).is_err(), "{n}");
        }
    }
}
