//! Reader of the stored (not compressed) ZIP archives that `torch.save` writes.
//!
//! In: the bytes of the archive. Out: names and byte ranges of its entries. Nothing is copied or unpacked.
//! Source: PKWARE's APPNOTE, sections 4.3.7 (local header), 4.3.12 (central directory), 4.3.16 (its end).

use std::collections::BTreeMap;
use std::ops::Range;
use thiserror::Error;

/// Why an archive was refused.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ZipError {
    /// The directory is missing, as in a truncated file.
    #[error("the archive has no directory at its end; the file is truncated or no ZIP archive")]
    NoDirectory,
    /// A record points outside the file.
    #[error("the archive's {what} points outside the file; the file is damaged")]
    OutOfBounds {
        /// The record.
        what: &'static str,
    },
    /// An entry is compressed or encrypted; `torch.save` stores.
    #[error(
        "entry {name} is stored with method {method} and flags {flags:#x}; a checkpoint's entries are stored plainly"
    )]
    NotStored {
        /// The entry.
        name: String,
        /// Compression method.
        method: u16,
        /// General purpose flags.
        flags: u16,
    },
    /// Two entries have one name.
    #[error("two entries are called {name}; the file is damaged")]
    Duplicate {
        /// The name.
        name: String,
    },
    /// A name is not UTF-8.
    #[error("the archive has an entry whose name is not UTF-8")]
    Name,
}

/// Byte ranges of the entries by name.
pub fn entries(bytes: &[u8]) -> Result<BTreeMap<String, Range<usize>>, ZipError> {
    let (start, count) = directory(bytes)?;
    let mut at = start;
    let mut out = BTreeMap::new();
    for _ in 0..count {
        let header = bytes
            .get(at..)
            .filter(|h| h.starts_with(b"PK\x01\x02") && h.len() >= 46)
            .ok_or(ZipError::OutOfBounds { what: "directory" })?;
        let [flags, method] = [u16_at(header, 8), u16_at(header, 10)];
        let [mut packed, mut size, mut offset] = [20, 24, 42].map(|i| u64::from(u32_at(header, i)));
        let [name_len, extra_len, comment_len] =
            [28, 30, 32].map(|i| usize::from(u16_at(header, i)));
        let name = header
            .get(46..46 + name_len)
            .ok_or(ZipError::OutOfBounds { what: "entry name" })?;
        let name = core::str::from_utf8(name)
            .map_err(|_e| ZipError::Name)?
            .to_owned();
        let extra =
            header
                .get(46 + name_len..46 + name_len + extra_len)
                .ok_or(ZipError::OutOfBounds {
                    what: "extra field",
                })?;
        widen(extra, [&mut size, &mut packed, &mut offset])?;
        if method != 0 || flags & 1 != 0 || packed != size {
            return Err(ZipError::NotStored {
                name,
                method,
                flags,
            });
        }
        let range = data_range(bytes, offset, size)?;
        if out.insert(name.clone(), range).is_some() {
            return Err(ZipError::Duplicate { name });
        }
        at += 46 + name_len + extra_len + comment_len;
    }
    Ok(out)
}

/// Offset of the central directory and number of its entries.
fn directory(bytes: &[u8]) -> Result<(usize, usize), ZipError> {
    // The end record has 22 bytes and a comment of at most 65535.
    let earliest = bytes.len().saturating_sub(22 + 65_535);
    let end = (earliest..bytes.len().saturating_sub(21))
        .rev()
        .find(|i| bytes[*i..].starts_with(b"PK\x05\x06"))
        .ok_or(ZipError::NoDirectory)?;
    let record = &bytes[end..];
    let mut count = u64::from(u16_at(record, 10));
    let mut offset = u64::from(u32_at(record, 16));
    if count == 0xffff || offset == 0xffff_ffff {
        // The locator of the 64-bit end record lies right before the end record.
        let bad = ZipError::OutOfBounds {
            what: "64-bit directory record",
        };
        let locator = end
            .checked_sub(20)
            .map(|i| &bytes[i..])
            .filter(|l| l.starts_with(b"PK\x06\x07"));
        if let Some(locator) = locator {
            let wide = usize::try_from(u64_at(locator, 8))
                .ok()
                .and_then(|i| bytes.get(i..))
                .filter(|w| w.starts_with(b"PK\x06\x06") && w.len() >= 56)
                .ok_or(bad)?;
            count = u64_at(wide, 32);
            offset = u64_at(wide, 48);
        }
    }
    let bad = ZipError::OutOfBounds { what: "directory" };
    let offset = usize::try_from(offset)
        .ok()
        .filter(|o| *o <= end)
        .ok_or(bad)?;
    // Every entry needs 46 bytes, which bounds the count.
    let count = usize::try_from(count)
        .ok()
        .filter(|c| *c <= (end - offset) / 46)
        .ok_or(ZipError::OutOfBounds { what: "directory" })?;
    Ok((offset, count))
}

/// Replaces 32-bit fields that are all ones by those of the 64-bit extra field.
fn widen(mut extra: &[u8], fields: [&mut u64; 3]) -> Result<(), ZipError> {
    let bad = || ZipError::OutOfBounds {
        what: "extra field",
    };
    while extra.len() >= 4 {
        let len = usize::from(u16_at(extra, 2));
        let body = extra.get(4..4 + len).ok_or_else(bad)?;
        if u16_at(extra, 0) == 1 {
            let mut words = body.as_chunks::<8>().0.iter();
            for field in fields {
                if *field == 0xffff_ffff {
                    *field = u64::from_le_bytes(*words.next().ok_or_else(bad)?);
                }
            }
            return Ok(());
        }
        extra = &extra[4 + len..];
    }
    Ok(())
}

fn data_range(bytes: &[u8], offset: u64, size: u64) -> Result<Range<usize>, ZipError> {
    let bad = || ZipError::OutOfBounds { what: "entry" };
    let offset = usize::try_from(offset).map_err(|_e| bad())?;
    let size = usize::try_from(size).map_err(|_e| bad())?;
    let local = bytes
        .get(offset..)
        .filter(|l| l.starts_with(b"PK\x03\x04") && l.len() >= 30)
        .ok_or_else(bad)?;
    let start = offset + 30 + usize::from(u16_at(local, 26)) + usize::from(u16_at(local, 28));
    let end = start
        .checked_add(size)
        .filter(|e| *e <= bytes.len())
        .ok_or_else(bad)?;
    Ok(start..end)
}

// The callers have checked the length of the record that they read from.
fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from(u16_at(bytes, at)) | u32::from(u16_at(bytes, at + 2)) << 16
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}
