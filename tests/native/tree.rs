//! The checkout as text, for `docs` and `layering`; not a topic of its own.

use std::fs;
use std::path::{Path, PathBuf};

pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// A text file of the checkout.
pub(crate) fn read(path: &str) -> String {
    fs::read_to_string(root().join(path))
        .unwrap_or_else(|error| panic!("cannot read {path}: {error}"))
}

/// All files below `folder` with this ending, relative to the root, sorted; nothing that is built or downloaded.
pub(crate) fn files(folder: &str, ending: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(dir) = folders.pop() {
        let entries = fs::read_dir(&dir)
            .unwrap_or_else(|error| panic!("cannot list {}: {error}", dir.display()));
        for entry in entries.flatten() {
            let path = entry.path();
            let name = entry.file_name().to_string_lossy().into_owned();
            if path.is_dir() {
                if !matches!(
                    name.as_str(),
                    "target" | "dist" | "node_modules" | ".git" | ".venv"
                ) {
                    folders.push(path);
                }
            } else if name.ends_with(ending) {
                found.push(relative(&path));
            }
        }
    }
    found.sort();
    found
}

pub(crate) fn rust_files(folder: &str) -> Vec<String> {
    files(folder, ".rs")
}

fn relative(path: &Path) -> String {
    path.strip_prefix(root())
        .unwrap_or(path)
        .to_string_lossy()
        .replace('\\', "/")
}

/// Statements of Rust code without their comments and string literals, each on one line with the number of its first
/// one. Good enough for looking for names; not a parser.
pub(crate) fn code_statements(text: &str) -> Vec<(usize, String)> {
    let mut statements = Vec::new();
    let mut current = String::new();
    let mut first = 1;
    for (number, line) in text.lines().enumerate() {
        if current.trim().is_empty() {
            first = number + 1;
            current.clear();
        }
        current.push_str(&without_literals(line));
        current.push(' ');
        // A `use` may span lines; everything else is looked at line by line.
        let is_open_use = current
            .trim_start()
            .trim_start_matches("pub ")
            .starts_with("use ")
            && !current.contains(';');
        if !is_open_use {
            statements.push((first, std::mem::take(&mut current)));
        }
    }
    statements.push((first, current));
    statements
}

fn without_literals(line: &str) -> String {
    let mut code = String::new();
    let mut in_string = false;
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '\\' if in_string => drop(chars.next()),
            // A quote in a character literal is not a string's.
            '"' if !code.ends_with('\'') => in_string = !in_string,
            '/' if !in_string && chars.peek() == Some(&'/') => break,
            _ if !in_string => code.push(c),
            _ => {}
        }
    }
    code
}

#[test]
fn leaves_comments_and_literals_out() {
    let text =
        "use crate::a; // crate::b\nlet s = \"crate::c\";\nuse crate::{\n    d,\n    e,\n};\n";
    let code: Vec<String> = code_statements(text)
        .into_iter()
        .map(|(_, code)| code)
        .collect();
    let all = code.join("|");
    assert!(
        !all.contains("crate::b") && !all.contains("crate::c"),
        "{all}"
    );
    assert!(
        code.iter()
            .any(|line| line.contains("d,") && line.contains("crate::{")),
        "grouped use on one line: {all}"
    );
}
