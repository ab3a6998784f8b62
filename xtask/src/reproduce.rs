//! `cargo xtask reproduce`: whether the shipped binaries are built again, byte for byte, in another place.

use crate::{paths, setup, shell, web};
use anyhow::{Context as _, Result, bail};
use sha2::{Digest as _, Sha256};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use wasmparser::{Parser, Payload};

/// Builds the package's binaries twice, in this checkout and in a fresh clone of its last commit at another path with a build folder
/// of its own, and compares them and their scripts byte by byte. Fails where they differ, and says in which section of the binary.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the clone, which must not be there yet; one in the system's folder for temporary files when not given. It is
    /// removed when both are the same.
    #[arg(long)]
    at: Option<PathBuf>,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let git = |words: &[&str]| shell::output(shell::command("git").args(words));
    let commit = git(&["rev-parse", "HEAD"])
        .context("the second build is made of a clone: this needs a git checkout")?;
    let commit = commit.trim();
    let is_dirty = !git(&["status", "--porcelain"])?.is_empty();
    let dir = match &args.at {
        Some(dir) => std::path::absolute(dir)?,
        None => std::env::temp_dir().join(format!("landline-again-{}", std::process::id())),
    };
    if dir.exists() {
        bail!("{} is there already", dir.display());
    }

    let names = web::built_binaries()?;
    println!("again   clone of {commit} in {}", dir.display());
    shell::run(
        shell::command("git")
            .args(["clone", "--quiet", "--no-checkout"])
            .arg(paths::root())
            .arg(&dir),
    )?;
    shell::run(
        shell::command("git")
            .args(["checkout", "--quiet", "--detach", commit])
            .current_dir(&dir),
    )?;
    // The same program in the other checkout: `paths::root` follows this variable.
    let program = std::env::current_exe().context("cannot find this program itself")?;
    shell::run(
        shell::command(program)
            .args(["web", "--binaries"])
            .current_dir(&dir)
            .env("CARGO_MANIFEST_DIR", dir.join("xtask"))
            .env("CARGO_TARGET_DIR", dir.join("target"))
            .env("LANDLINE_CACHE", paths::cache()),
    )?;

    let again = dir.join(paths::bindgen().strip_prefix(paths::root())?);
    println!(
        "\ncommit {commit}\n\n| file | bytes | SHA-256 | built again |\n| --- | --- | --- | --- |"
    );
    let mut num_different = 0;
    for name in &names {
        let (first, second) = (read(&paths::bindgen(), name)?, read(&again, name)?);
        let told = match difference(&first, &second) {
            None => "the same".to_owned(),
            Some(difference) => {
                num_different += 1;
                format!("{difference}; {} bytes, {}", second.len(), sha256(&second))
            }
        };
        println!(
            "| `{name}` | {} | `{}` | {told} |",
            first.len(),
            sha256(&first)
        );
    }
    if is_dirty {
        println!(
            "\nThis checkout has changes that are not committed; the clone has not. The first build is not that of the commit."
        );
    }
    if num_different > 0 {
        let and = if is_dirty {
            ", maybe by those changes"
        } else {
            ""
        };
        bail!(
            "{num_different} of {} files differ{and}; the second build is in {}",
            names.len(),
            dir.display()
        );
    }
    fs::remove_dir_all(&dir).with_context(|| format!("cannot remove {}", dir.display()))
}

fn read(dir: &Path, name: &str) -> Result<Vec<u8>> {
    let path = dir.join(name);
    fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
}

fn sha256(bytes: &[u8]) -> String {
    setup::hex(&Sha256::digest(bytes))
}

/// Where two files begin to differ.
#[derive(Debug, PartialEq, Eq)]
struct Difference {
    /// The first byte that only one of them has so.
    at: usize,
    /// The section of a wasm binary that it lies in, by the first of the files.
    section: Option<String>,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "differs from byte {}", self.at)?;
        match &self.section {
            Some(section) => write!(f, ", section {section}"),
            None => Ok(()),
        }
    }
}

/// The first difference of two files; `None` where they are the same.
fn difference(first: &[u8], second: &[u8]) -> Option<Difference> {
    let at = first
        .iter()
        .zip(second)
        .position(|(a, b)| a != b)
        .or_else(|| (first.len() != second.len()).then(|| first.len().min(second.len())))?;
    Some(Difference {
        at,
        section: section(first, at),
    })
}

/// The section of a wasm binary that a byte lies in, by name; `None` in its head, behind its end and in other files.
fn section(file: &[u8], at: usize) -> Option<String> {
    for payload in Parser::new(0).parse_all(file) {
        let payload = payload.ok()?;
        let Some((id, range)) = payload.as_section() else {
            continue;
        };
        if (at as u64) < range.end {
            // The identifier and the length stand before what the range covers.
            let name = match payload {
                Payload::CustomSection(custom) => format!("custom \"{}\"", custom.name()),
                _ => name_of_section(id).to_owned(),
            };
            return (at >= 8).then_some(name);
        }
    }
    None
}

/// Sections by the numbers that the WebAssembly specification gives them (5.5.2).
fn name_of_section(id: u8) -> &'static str {
    match id {
        1 => "type",
        2 => "import",
        3 => "function",
        4 => "table",
        5 => "memory",
        6 => "global",
        7 => "export",
        8 => "start",
        9 => "element",
        10 => "code",
        11 => "data",
        12 => "data count",
        _ => "unknown",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A module with a type, a custom section `note` and a memory.
    fn module() -> Vec<u8> {
        let mut wasm = b"\0asm\x01\0\0\0".to_vec();
        wasm.extend([1, 4, 1, 0x60, 0, 0]); // bytes 8 to 13
        wasm.extend(b"\0\x07\x04noteab"); // 14 to 22
        wasm.extend([5, 3, 1, 0, 1]); // 23 to 27
        wasm
    }

    #[test]
    fn the_first_different_byte_is_told_with_its_section() {
        let first = module();
        assert_eq!(difference(&first, &first), None, "the same file");
        for (at, section) in [
            (4, None),
            (10, Some("type")),
            (22, Some("custom \"note\"")),
            (27, Some("memory")),
        ] {
            let mut second = first.clone();
            second[at] ^= 1;
            let section = section.map(str::to_owned);
            assert_eq!(
                difference(&first, &second),
                Some(Difference { at, section })
            );
        }
    }

    #[test]
    fn a_file_that_goes_on_differs_behind_the_others_end() {
        let first = module();
        let longer = [first.as_slice(), &[0, 2, 1, b'x']].concat();
        let behind = Some(Difference {
            at: 28,
            section: None,
        });
        assert_eq!(difference(&first, &longer), behind);
        let shorter = difference(&longer, &first).expect("one is shorter");
        assert_eq!(
            shorter.to_string(),
            "differs from byte 28, section custom \"x\""
        );
        let text = difference(b"let a", b"let b").expect("another letter");
        assert_eq!(
            text.to_string(),
            "differs from byte 4",
            "scripts have no sections"
        );
    }
}
