//! `cargo xtask api`: the public TypeScript declarations against their snapshot.

use crate::files::resolve;
use crate::{paths, pins};
use anyhow::{Context as _, Result, bail};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Holds the package's public declarations against `pkg-config/api.d.ts`.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct Args {
    /// Writes the snapshot anew instead.
    #[arg(long)]
    bless: bool,
}

const SNAPSHOT: &str = "pkg-config/api.d.ts";

pub(crate) fn run(args: &Args) -> Result<()> {
    let package = paths::package();
    if !package.join("package.json").is_file() {
        bail!("the package is not built: run `cargo xtask web` first");
    }
    let current = declarations(&package)?;
    if args.bless {
        paths::write(&paths::root().join(SNAPSHOT), current.as_bytes())?;
        println!("wrote {SNAPSHOT}");
        return Ok(());
    }
    let snapshot = pins::text(SNAPSHOT).unwrap_or_default();
    if let Some((number, is, was)) = first_difference(&current, &snapshot) {
        bail!(
            "the public declarations differ from {SNAPSHOT}, first in line {number}:\n  snapshot: {was}\n  \
             package:  {is}\nIf the change is meant, run `cargo xtask api --bless`, and say in CHANGELOG.md what users see"
        );
    }
    println!("declarations are those of {SNAPSHOT}");
    Ok(())
}

/// The declaration files that the package's exports lead to, one after another.
fn declarations(package: &Path) -> Result<String> {
    let manifest: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(package.join("package.json"))?)?;
    let exports = manifest["exports"]
        .as_object()
        .context("package.json has no exports")?;
    let mut waiting: Vec<String> = exports
        .values()
        .filter_map(|export| export["types"].as_str())
        .map(|path| path.trim_start_matches("./").to_owned())
        .collect();
    let mut texts = BTreeMap::new();
    while let Some(name) = waiting.pop() {
        if texts.contains_key(&name) {
            continue;
        }
        let text = fs::read_to_string(package.join(&name))
            .with_context(|| format!("the package lacks {name}"))?;
        let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
        for quoted in text
            .split("from \"")
            .skip(1)
            .filter_map(|rest| rest.split('"').next())
        {
            if quoted.starts_with('.') {
                waiting.push(resolve(folder, quoted).replace(".js", ".d.ts"));
            }
        }
        texts.insert(name, text);
    }
    let mut all = String::from(
        "// Public declarations of the npm package, as built. Made by `cargo xtask api --bless`; not written by hand.\n",
    );
    for (name, text) in texts {
        all.push_str(&format!("\n// ---- {name}\n\n{}\n", text.trim_end()));
    }
    Ok(all)
}

/// Number of the first line that differs, and the line on both sides.
fn first_difference<'a>(is: &'a str, was: &'a str) -> Option<(usize, &'a str, &'a str)> {
    let (mut is, mut was) = (is.lines(), was.lines());
    for number in 1.. {
        match (is.next(), was.next()) {
            (None, None) => return None,
            (a, b) if a == b => {}
            (a, b) => return Some((number, a.unwrap_or("(ends)"), b.unwrap_or("(ends)"))),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_first_difference() {
        assert_eq!(first_difference("a\nb\n", "a\nb\n"), None);
        assert_eq!(first_difference("a\nb\n", "a\nc\n"), Some((2, "b", "c")));
        assert_eq!(first_difference("a\n", "a\nc\n"), Some((2, "(ends)", "c")));
    }
}
