//! Text files read line by line, with errors that name file and line.

use super::DatasetError;
use std::path::{Path, PathBuf};

/// How a pointer of Git LFS begins.
pub(super) const LFS_START: &[u8; 23] = b"version https://git-lfs";

/// A text file in memory.
pub(super) struct TextFile {
    pub(super) path: PathBuf,
    content: String,
}

impl TextFile {
    pub(super) fn read(path: &Path) -> Result<Self, DatasetError> {
        let bytes = std::fs::read(path).map_err(DatasetError::io(path))?;
        // A pointer of Git LFS stands where the file itself was not fetched.
        if bytes.starts_with(LFS_START) {
            return Err(DatasetError::missing(
                path,
                "this is a Git LFS pointer, not the file itself; run `git lfs pull`",
            ));
        }
        let content = decode(bytes).map_err(|e| DatasetError::parse(path, "text", e))?;
        Ok(Self {
            path: path.to_owned(),
            content,
        })
    }

    /// Lines that are neither empty nor comments (`#`).
    pub(super) fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.all_lines()
            .filter(|line| !line.text.is_empty() && !line.text.starts_with('#'))
    }

    /// The whole text.
    pub(super) fn content(&self) -> &str {
        &self.content
    }

    /// All lines, trimmed.
    pub(super) fn all_lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.content.lines().enumerate().map(|(i, text)| Line {
            path: &self.path,
            number: i + 1,
            text: text.trim(),
        })
    }
}

/// Text of bytes in UTF-8, or in UTF-16 as some editors and shells of Windows write it; without its byte order mark.
fn decode(bytes: Vec<u8>) -> Result<String, String> {
    let wide = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest.chunks_exact(2).map(|b| unit([b[0], b[1]])).collect();
        String::from_utf16(&units).map_err(|e| format!("not UTF-16: {e}"))
    };
    match bytes.as_slice() {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => {
            String::from_utf8(rest.to_vec()).map_err(|e| format!("not UTF-8: {e}"))
        }
        _ => String::from_utf8(bytes).map_err(|e| format!("not UTF-8: {e}")),
    }
}

/// One line with its place.
#[derive(Clone, Copy)]
pub(super) struct Line<'a> {
    path: &'a Path,
    number: usize,
    pub(super) text: &'a str,
}

impl<'a> Line<'a> {
    pub(super) fn error(&self, what: impl ToString) -> DatasetError {
        DatasetError::parse(self.path, format!("line {}", self.number), what)
    }

    pub(super) fn fields(&self) -> Vec<&'a str> {
        self.text.split_whitespace().collect()
    }

    pub(super) fn number<T: std::str::FromStr>(&self, field: &str) -> Result<T, DatasetError> {
        field
            .parse()
            .map_err(|_| self.error(format!("`{field}` is not a number of the expected kind")))
    }

    /// Fields as finite numbers.
    pub(super) fn finite(&self, fields: &[&str]) -> Result<Vec<f64>, DatasetError> {
        fields
            .iter()
            .map(|field| {
                let value: f64 = self.number(field)?;
                if value.is_finite() {
                    Ok(value)
                } else {
                    Err(self.error(format!("`{field}` is not finite")))
                }
            })
            .collect()
    }

    /// The line up to so many fields, and the rest, as they are written.
    pub(super) fn split_at(&self, count: usize) -> (&'a str, &'a str) {
        let rest = (0..count).fold(self.text, |rest, _| {
            rest.find(char::is_whitespace)
                .map_or("", |at| rest[at..].trim_start())
        });
        let before = &self.text[..self.text.len() - rest.len()];
        (before.trim_end(), rest)
    }

    /// Fields as numbers, finite or not: a lost pose is a dropped picture, no broken file.
    pub(super) fn numbers(&self, fields: &[&str]) -> Result<Vec<f64>, DatasetError> {
        fields.iter().map(|field| self.number(field)).collect()
    }

    /// Splits into a name, which may hold spaces, and `count` numbers after it, finite or not.
    pub(super) fn name_and_numbers(
        &self,
        count: usize,
    ) -> Result<(String, Vec<f64>), DatasetError> {
        let fields = self.fields();
        let at = fields
            .len()
            .checked_sub(count)
            .filter(|at| *at > 0)
            .ok_or_else(|| {
                self.error(format!(
                    "expected a name and {count} numbers, found {} fields",
                    fields.len()
                ))
            })?;
        let numbers = self.numbers(&fields[at..])?;
        let name = fields[at..].iter().fold(self.text, |rest, _| {
            rest.rsplit_once(char::is_whitespace)
                .map_or("", |(before, _)| before.trim_end())
        });
        Ok((name.to_owned(), numbers))
    }
}
