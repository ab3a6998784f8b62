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
        let content = String::from_utf8(bytes)
            .map_err(|e| DatasetError::parse(path, "text", format!("not UTF-8: {e}")))?;
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

    /// All lines, trimmed.
    pub(super) fn all_lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.content
            .trim_start_matches('\u{feff}')
            .lines()
            .enumerate()
            .map(|(i, text)| Line {
                path: &self.path,
                number: i + 1,
                text: text.trim(),
            })
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

    /// Splits into a name, which may hold spaces, and `count` numbers after it.
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
        let (name, numbers) = fields.split_at(at);
        Ok((name.join(" "), self.finite(numbers)?))
    }
}
