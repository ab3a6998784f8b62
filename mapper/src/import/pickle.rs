//! Reader of the small part of Python's pickle format that `torch.save` uses for tensors. It never executes anything.
//!
//! In: the bytes of one pickle stream. Out: an [`Arena`] of plain values with the index of the top one.
//! A pickle is a program for a stack machine; this machine knows data opcodes and a fixed list of names, and everything
//! else is refused by name and position. Values live in an arena and are referred to by index, so memo references cost
//! nothing and the memory is bounded by the number of opcodes, thus by the length of the stream.
//! Source: the opcode descriptions in Python's `pickletools` documentation.

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
        let mut machine = Machine {
            bytes,
            at: 0,
            arena: self,
            stack: Vec::new(),
            marks: Vec::new(),
            memo: Vec::new(),
        };
        let top = machine.run()?;
        let used = machine.at;
        Ok((top, used))
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    arena: &'a mut Arena,
    stack: Vec<ValueId>,
    marks: Vec<usize>,
    memo: Vec<Option<ValueId>>,
}

impl Machine<'_> {
    fn inconsistent(&self, what: &'static str) -> PickleError {
        PickleError::Inconsistent { what, at: self.at }
    }

    fn take(&mut self, n: usize) -> Result<&[u8], PickleError> {
        let end = self.at.checked_add(n).filter(|e| *e <= self.bytes.len());
        let Some(end) = end else {
            return Err(PickleError::Truncated {
                at: self.bytes.len(),
            });
        };
        let out = &self.bytes[self.at..end];
        self.at = end;
        Ok(out)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    fn u8(&mut self) -> Result<u8, PickleError> {
        Ok(self.array::<1>()?[0])
    }

    fn u32_usize(&mut self) -> Result<usize, PickleError> {
        let n = u32::from_le_bytes(self.array()?);
        usize::try_from(n).map_err(|_e| self.inconsistent("a length that does not fit"))
    }

    fn line(&mut self) -> Result<String, PickleError> {
        let rest = &self.bytes[self.at..];
        let Some(end) = rest.iter().position(|b| *b == b'\n') else {
            return Err(PickleError::Truncated {
                at: self.bytes.len(),
            });
        };
        let start = self.at;
        let text = core::str::from_utf8(&rest[..end])
            .map_err(|_e| PickleError::Text { at: start })?
            .to_owned();
        self.at += end + 1;
        Ok(text)
    }

    fn push(&mut self, value: Value) -> Result<(), PickleError> {
        let id = u32::try_from(self.arena.values.len())
            .map_err(|_e| self.inconsistent("too many values"))?;
        self.arena.values.push(value);
        self.stack.push(id);
        Ok(())
    }

    fn push_text(&mut self, n: usize) -> Result<(), PickleError> {
        let start = self.at;
        let text = core::str::from_utf8(self.take(n)?)
            .map_err(|_e| PickleError::Text { at: start })?
            .to_owned();
        self.push(Value::Str(text))
    }

    /// Pops one value, never across a mark.
    fn pop(&mut self) -> Result<ValueId, PickleError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.inconsistent("the stack is empty"));
        }
        self.stack
            .pop()
            .ok_or_else(|| self.inconsistent("the stack is empty"))
    }

    fn pop_to_mark(&mut self) -> Result<Vec<ValueId>, PickleError> {
        let mark = self
            .marks
            .pop()
            .ok_or_else(|| self.inconsistent("no mark on the stack"))?;
        Ok(self.stack.split_off(mark))
    }

    fn pop_n(&mut self, n: usize) -> Result<Vec<ValueId>, PickleError> {
        let mut out = Vec::with_capacity(n);
        for _ in 0..n {
            out.push(self.pop()?);
        }
        out.reverse();
        Ok(out)
    }

    fn top(&self) -> Result<ValueId, PickleError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.last() {
            Some(id) if self.stack.len() > floor => Ok(*id),
            _ => Err(self.inconsistent("the stack is empty")),
        }
    }

    fn remember(&mut self, slot: usize) -> Result<(), PickleError> {
        // Writers number the memo consecutively, so a slot far beyond the end only serves to exhaust memory.
        if slot > self.memo.len().saturating_add(1024) {
            return Err(self.inconsistent("a memo slot far beyond the memo"));
        }
        let id = self.top()?;
        if slot >= self.memo.len() {
            self.memo.resize(slot + 1, None);
        }
        self.memo[slot] = Some(id);
        Ok(())
    }

    fn recall(&mut self, slot: usize) -> Result<(), PickleError> {
        let id = self
            .memo
            .get(slot)
            .copied()
            .flatten()
            .ok_or_else(|| self.inconsistent("a memo slot that was never filled"))?;
        self.stack.push(id);
        Ok(())
    }

    fn set_items(&mut self, flat: &[ValueId]) -> Result<(), PickleError> {
        if !flat.len().is_multiple_of(2) {
            return Err(self.inconsistent("a key without a value"));
        }
        let at = self.at;
        let id = self.top()?;
        match &mut self.arena.values[id as usize] {
            Value::Dict(items) => {
                items.extend(flat.chunks_exact(2).map(|c| (c[0], c[1])));
                Ok(())
            }
            other => Err(PickleError::Kind {
                expected: "a dictionary",
                found: other.kind(),
                at,
            }),
        }
    }

    fn append(&mut self, items: &[ValueId]) -> Result<(), PickleError> {
        let at = self.at;
        let id = self.top()?;
        match &mut self.arena.values[id as usize] {
            Value::List(list) => {
                list.extend_from_slice(items);
                Ok(())
            }
            other => Err(PickleError::Kind {
                expected: "a list",
                found: other.kind(),
                at,
            }),
        }
    }

    fn known(&self, module: String, name: String) -> Result<Value, PickleError> {
        let known = match (module.as_str(), name.as_str()) {
            ("collections", "OrderedDict") => Some(Known::OrderedDict),
            ("torch._utils", "_rebuild_tensor_v2" | "_rebuild_tensor") => {
                Some(Known::RebuildTensor)
            }
            ("torch._utils", "_rebuild_parameter") => Some(Known::RebuildParameter),
            ("torch", "Size") => Some(Known::Size),
            ("torch", class) => StorageType::from_class(class).map(Known::Storage),
            _ => None,
        };
        known.map(Value::Known).ok_or(PickleError::Name {
            module,
            name,
            at: self.at,
        })
    }

    fn tuple(&self, id: ValueId) -> Result<&[ValueId], PickleError> {
        match self.arena.get(id) {
            Value::Tuple(items) => Ok(items),
            other => Err(self.kind("a tuple", other)),
        }
    }

    fn kind(&self, expected: &'static str, found: &Value) -> PickleError {
        PickleError::Kind {
            expected,
            found: found.kind(),
            at: self.at,
        }
    }

    fn size(&self, id: ValueId) -> Result<u64, PickleError> {
        match self.arena.get(id) {
            Value::Int(n) => u64::try_from(*n).map_err(|_e| self.inconsistent("a negative size")),
            other => Err(self.kind("an integer", other)),
        }
    }

    fn sizes(&self, id: ValueId) -> Result<Vec<u64>, PickleError> {
        let items = self.tuple(id)?;
        if items.len() > 8 {
            return Err(self.inconsistent("a tensor with more than 8 axes"));
        }
        items.iter().map(|i| self.size(*i)).collect()
    }

    fn reduce(&mut self) -> Result<(), PickleError> {
        let args = self.pop()?;
        let callee = self.pop()?;
        let Value::Known(known) = *self.arena.get(callee) else {
            return Err(self.kind("a permitted function", self.arena.get(callee)));
        };
        let args = self.tuple(args)?;
        if args.len() > 16 {
            return Err(self.inconsistent("a call with more than 16 arguments"));
        }
        let args = args.to_vec();
        let value = match (known, args.as_slice()) {
            (Known::OrderedDict, []) => Value::Dict(Vec::new()),
            (Known::OrderedDict, [pairs]) => {
                // Taken, not copied: a list recalled from the memo again and again must not multiply.
                let at = self.at;
                let pairs = match &mut self.arena.values[*pairs as usize] {
                    Value::List(items) => core::mem::take(items),
                    other => {
                        return Err(PickleError::Kind {
                            expected: "a list of pairs",
                            found: other.kind(),
                            at,
                        });
                    }
                };
                let mut out = Vec::with_capacity(pairs.len());
                for pair in pairs {
                    match self.arena.get(pair) {
                        Value::Tuple(kv) | Value::List(kv) if kv.len() == 2 => {
                            out.push((kv[0], kv[1]));
                        }
                        other => return Err(self.kind("a pair", other)),
                    }
                }
                Value::Dict(out)
            }
            (Known::Size, [items]) if self.tuple(*items)?.len() <= 8 => {
                Value::Tuple(self.tuple(*items)?.to_vec())
            }
            (Known::RebuildTensor, [storage, offset, shape, stride, ..]) => {
                if !matches!(self.arena.get(*storage), Value::Storage { .. }) {
                    return Err(self.kind("a storage", self.arena.get(*storage)));
                }
                let view = TensorView {
                    storage: *storage,
                    offset: self.size(*offset)?,
                    shape: self.sizes(*shape)?,
                    stride: self.sizes(*stride)?,
                };
                if view.shape.len() != view.stride.len() {
                    return Err(self.inconsistent("as many strides as axes are needed"));
                }
                Value::Tensor(view)
            }
            (Known::RebuildParameter, [tensor, ..]) => match self.arena.get(*tensor) {
                Value::Tensor(view) => Value::Tensor(view.clone()),
                other => return Err(self.kind("a tensor", other)),
            },
            _ => return Err(self.inconsistent("a call with arguments that it does not take")),
        };
        self.push(value)
    }

    fn persistent(&mut self) -> Result<(), PickleError> {
        let id = self.pop()?;
        let parts = self.tuple(id)?;
        if parts.len() > 8 {
            return Err(self.inconsistent("a storage description that is too long"));
        }
        let parts = parts.to_vec();
        let [tag, class, key, _location, num_elements, rest @ ..] = parts.as_slice() else {
            return Err(self.inconsistent("a storage description that is too short"));
        };
        if self.arena.text(*tag) != Some("storage") {
            return Err(self.inconsistent("a persistent id that is not a storage"));
        }
        // Old files may describe a storage as a part of another one; no known checkpoint does.
        if let [view, ..] = rest
            && *self.arena.get(*view) != Value::None
        {
            return Err(self.inconsistent("a storage that is a view of another one"));
        }
        let Value::Known(Known::Storage(element)) = *self.arena.get(*class) else {
            return Err(self.kind("a storage class", self.arena.get(*class)));
        };
        let Some(key) = self.arena.text(*key).map(str::to_owned) else {
            return Err(self.kind("text", self.arena.get(*key)));
        };
        let num_elements = self.size(*num_elements)?;
        self.push(Value::Storage {
            element,
            key,
            num_elements,
        })
    }

    fn run(&mut self) -> Result<ValueId, PickleError> {
        loop {
            let opcode = self.u8()?;
            match opcode {
                0x80 => {
                    if self.u8()? > 5 {
                        return Err(self.inconsistent("a pickle protocol above 5"));
                    }
                }
                0x95 => {
                    self.array::<8>()?; // a frame only announces a length
                }
                b'.' => return self.pop(),
                b'(' => self.marks.push(self.stack.len()),
                b'N' => self.push(Value::None)?,
                0x88 => self.push(Value::Bool(true))?,
                0x89 => self.push(Value::Bool(false))?,
                b'K' => {
                    let n = self.u8()?;
                    self.push(Value::Int(i64::from(n)))?;
                }
                b'M' => {
                    let n = u16::from_le_bytes(self.array()?);
                    self.push(Value::Int(i64::from(n)))?;
                }
                b'J' => {
                    let n = i32::from_le_bytes(self.array()?);
                    self.push(Value::Int(i64::from(n)))?;
                }
                0x8a => {
                    let n = usize::from(self.u8()?);
                    let bytes = self.take(n)?;
                    let value = long_from_bytes(bytes);
                    self.push(value)?;
                }
                b'G' => {
                    let x = f64::from_be_bytes(self.array()?);
                    self.push(Value::Float(x))?;
                }
                b'X' | b'T' => {
                    let n = self.u32_usize()?;
                    self.push_text(n)?;
                }
                0x8c | b'U' => {
                    let n = usize::from(self.u8()?);
                    self.push_text(n)?;
                }
                b'}' => self.push(Value::Dict(Vec::new()))?,
                b']' => self.push(Value::List(Vec::new()))?,
                b')' => self.push(Value::Tuple(Vec::new()))?,
                b't' => {
                    let items = self.pop_to_mark()?;
                    self.push(Value::Tuple(items))?;
                }
                0x85..=0x87 => {
                    let items = self.pop_n(usize::from(opcode - 0x84))?;
                    self.push(Value::Tuple(items))?;
                }
                b'q' => {
                    let slot = usize::from(self.u8()?);
                    self.remember(slot)?;
                }
                b'r' => {
                    let slot = self.u32_usize()?;
                    self.remember(slot)?;
                }
                0x94 => self.remember(self.memo.len())?,
                b'h' => {
                    let slot = usize::from(self.u8()?);
                    self.recall(slot)?;
                }
                b'j' => {
                    let slot = self.u32_usize()?;
                    self.recall(slot)?;
                }
                b's' => {
                    let items = self.pop_n(2)?;
                    self.set_items(&items)?;
                }
                b'u' => {
                    let items = self.pop_to_mark()?;
                    self.set_items(&items)?;
                }
                b'a' => {
                    let items = self.pop_n(1)?;
                    self.append(&items)?;
                }
                b'e' => {
                    let items = self.pop_to_mark()?;
                    self.append(&items)?;
                }
                b'c' => {
                    let module = self.line()?;
                    let name = self.line()?;
                    let value = self.known(module, name)?;
                    self.push(value)?;
                }
                0x93 => {
                    let parts = self.pop_n(2)?;
                    let (Some(module), Some(name)) = (
                        self.arena.text(parts[0]).map(str::to_owned),
                        self.arena.text(parts[1]).map(str::to_owned),
                    ) else {
                        return Err(self.inconsistent("a name that is not text"));
                    };
                    let value = self.known(module, name)?;
                    self.push(value)?;
                }
                b'R' => self.reduce()?,
                b'Q' => self.persistent()?,
                // The attributes of an ordered dictionary (`_metadata`, module versions) carry no weights.
                b'b' => {
                    self.pop()?;
                    let target = self.top()?;
                    if !matches!(self.arena.get(target), Value::Dict(_)) {
                        return Err(self.kind("a dictionary", self.arena.get(target)));
                    }
                }
                opcode => {
                    return Err(PickleError::Opcode {
                        opcode,
                        at: self.at - 1,
                    });
                }
            }
        }
    }
}

/// Two's complement, little-endian, as long as needed.
fn long_from_bytes(bytes: &[u8]) -> Value {
    let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
    if bytes.len() <= 8 {
        let mut wide = if negative { [0xff; 8] } else { [0; 8] };
        wide[..bytes.len()].copy_from_slice(bytes);
        Value::Int(i64::from_le_bytes(wide))
    } else {
        Value::LongInt(bytes.to_vec())
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
    fn a_memo_slot_far_away_is_refused_instead_of_allocated() {
        let got = read(b"\x80\x02Nr\xff\xff\xff\xff.");
        assert!(
            matches!(got, Err(PickleError::Inconsistent { .. })),
            "{got:?}"
        );
    }

    #[test]
    fn truncation_at_every_byte_is_an_error() {
        let bytes =
            b"\x80\x02}(U\x01aq\x00](K\x01J\xfe\xff\xff\xffeX\x01\x00\x00\x00b(h\x00N\x88tu.";
        for n in 0..bytes.len() {
            assert!(read(&bytes[..n]).is_err(), "{n}");
        }
    }

    #[test]
    fn long_integers_keep_sign() {
        assert_eq!(long_from_bytes(&[]), Value::Int(0));
        assert_eq!(long_from_bytes(&[0xff]), Value::Int(-1));
        assert_eq!(long_from_bytes(&[0x00, 0x80]), Value::Int(-32768));
        assert!(matches!(long_from_bytes(&[1; 10]), Value::LongInt(_)));
    }
}
