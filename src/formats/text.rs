//! Text files read line by line, with errors that name file and line.

use super::FormatError;

/// How a pointer of Git LFS begins.
pub const LFS_START: &[u8; 23] = b"version https://git-lfs";

/// A text file in memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextFile {
    name: String,
    content: String,
}

impl TextFile {
    /// Text of a file's bytes: UTF-8, or UTF-16 with its mark. `name` is for errors.
    ///
    /// # Errors
    /// Bytes that are no text, and a pointer of Git LFS.
    pub fn from_bytes(name: impl Into<String>, bytes: Vec<u8>) -> Result<Self, FormatError> {
        let name = name.into();
        // A pointer of Git LFS stands where the file itself was not fetched.
        if bytes.starts_with(LFS_START) {
            return Err(FormatError::whole(
                &name,
                "this is a Git LFS pointer, not the file itself; run `git lfs pull`",
            ));
        }
        let content = decode(bytes).map_err(|e| FormatError::at(&name, "text", e))?;
        Ok(Self { name, content })
    }

    /// What errors call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Lines that are neither empty nor comments (`#`).
    pub fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.all_lines()
            .filter(|line| !line.text.is_empty() && !line.text.starts_with('#'))
    }

    /// The whole text.
    pub fn content(&self) -> &str {
        &self.content
    }

    /// All lines, trimmed.
    pub fn all_lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.content.lines().enumerate().map(|(i, text)| Line {
            file: &self.name,
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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Line<'a> {
    file: &'a str,
    number: usize,
    /// Trimmed.
    pub text: &'a str,
}

impl<'a> Line<'a> {
    /// What is wrong with the line.
    pub fn error(&self, what: impl ToString) -> FormatError {
        FormatError::at(self.file, format!("line {}", self.number), what)
    }

    /// What stands between spaces.
    pub fn fields(&self) -> Vec<&'a str> {
        self.text.split_whitespace().collect()
    }

    /// A field as a number.
    ///
    /// # Errors
    /// When it is none of this kind.
    pub fn number<T: std::str::FromStr>(&self, field: &str) -> Result<T, FormatError> {
        field
            .parse()
            .map_err(|_| self.error(format!("`{field}` is not a number of the expected kind")))
    }

    /// Fields as finite numbers.
    ///
    /// # Errors
    /// When one is none.
    pub fn finite(&self, fields: &[&str]) -> Result<Vec<f64>, FormatError> {
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
    pub fn split_at(&self, count: usize) -> (&'a str, &'a str) {
        let rest = (0..count).fold(self.text, |rest, _| {
            rest.find(char::is_whitespace)
                .map_or("", |at| rest[at..].trim_start())
        });
        let before = &self.text[..self.text.len() - rest.len()];
        (before.trim_end(), rest)
    }

    /// Fields as numbers, finite or not: a lost pose is a dropped picture, no broken file.
    ///
    /// # Errors
    /// When one is no number.
    pub fn numbers(&self, fields: &[&str]) -> Result<Vec<f64>, FormatError> {
        fields.iter().map(|field| self.number(field)).collect()
    }

    /// Splits into a name, which may hold spaces, and `count` numbers after it, finite or not.
    ///
    /// # Errors
    /// When there are fewer fields, or one is no number.
    pub fn name_and_numbers(&self, count: usize) -> Result<(String, Vec<f64>), FormatError> {
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
