//! The stack machine that runs a pickle, instruction by instruction.

use std::collections::HashMap;

use super::{Arena, Known, PickleError, StorageType, TensorView, Value, ValueId};

/// The stack machine.
pub(super) struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    arena: &'a mut Arena,
    stack: Vec<ValueId>,
    marks: Vec<usize>,
    /// By slot. A map, because a stream may number its slots as it likes: with a list, five bytes that name a far slot
    /// would take kilobytes.
    memo: HashMap<usize, ValueId>,
}

impl<'a> Machine<'a> {
    /// A machine at the start of a stream; what it makes goes into `arena`.
    pub(super) fn new(bytes: &'a [u8], arena: &'a mut Arena) -> Self {
        Self {
            bytes,
            at: 0,
            arena,
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        }
    }

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
        let id = self.top()?;
        self.memo.insert(slot, id);
        Ok(())
    }

    fn recall(&mut self, slot: usize) -> Result<(), PickleError> {
        let id = self
            .memo
            .get(&slot)
            .copied()
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

    /// Runs to the end of the stream. Returns the top value and the number of bytes read.
    pub(super) fn run(mut self) -> Result<(ValueId, usize), PickleError> {
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
                b'.' => return Ok((self.pop()?, self.at)),
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

    #[test]
    fn long_integers_keep_sign() {
        assert_eq!(long_from_bytes(&[]), Value::Int(0));
        assert_eq!(long_from_bytes(&[0xff]), Value::Int(-1));
        assert_eq!(long_from_bytes(&[0x00, 0x80]), Value::Int(-32768));
        assert!(matches!(long_from_bytes(&[1; 10]), Value::LongInt(_)));
    }
}
