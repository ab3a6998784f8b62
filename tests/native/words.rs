//! Holds the words of `docs/CONVENTIONS.md`: types that carry a word which could mean two things stand in its table, so that a
//! new one is named by somebody who has read what the word means here. `tests/package/words.test.mjs` does so for TypeScript.

use crate::{rust, tree};
use std::collections::BTreeSet;

/// A word and the Rust types that may carry it.
struct Word {
    word: String,
    types: BTreeSet<String>,
}

fn table(text: &str) -> Vec<Word> {
    let rows = text
        .lines()
        .skip_while(|line| !line.starts_with("| word | types in Rust |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    rows.filter_map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let types = cells[1].split('`').skip(1).step_by(2).map(str::to_owned);
        Some(Word {
            word: (*cells.first()?).to_owned(),
            types: types.collect(),
        })
    })
    .collect()
}

/// `PointTrack` → `point`, `track`.
fn parts(name: &str) -> Vec<String> {
    let mut parts: Vec<String> = Vec::new();
    let mut was_upper = false;
    for c in name.chars() {
        match parts.last_mut() {
            Some(part) if !c.is_uppercase() || was_upper => part.extend(c.to_lowercase()),
            _ => parts.push(c.to_lowercase().collect()),
        }
        was_upper = c.is_uppercase();
    }
    parts
}

/// The word itself, or the doer, the deed, the done, the many.
fn carries(name: &str, word: &str) -> bool {
    let ending = |part: String| part.strip_prefix(word).map(str::to_owned);
    parts(name)
        .into_iter()
        .filter_map(ending)
        .any(|rest| matches!(rest.as_str(), "" | "s" | "er" | "ed" | "ing"))
}

/// What the table and the types of the code do not agree about, as sentences.
fn breaches(words: &[Word], types: &[(String, String)]) -> Vec<String> {
    let mut sentences = Vec::new();
    for Word { word, types: may } in words {
        let mut missing = may.clone();
        for (name, file) in types.iter().filter(|(name, _)| carries(name, word)) {
            missing.remove(name);
            let fits = |pattern: &String| {
                let start = pattern.strip_suffix('*');
                start.is_some_and(|start| name.starts_with(start))
            };
            let of = may.iter().find(|pattern| fits(pattern));
            of.map(|pattern| missing.remove(pattern));
            if of.is_none() && !may.contains(name) {
                sentences.push(format!("{file}: {name} carries `{word}`"));
            }
        }
        sentences.extend(
            missing
                .iter()
                .map(|name| format!("no type is called {name}")),
        );
    }
    sentences
}

#[test]
fn types_carry_the_words_of_the_conventions() {
    let words = table(&tree::read("docs/CONVENTIONS.md"));
    assert!(words.len() > 3, "docs/CONVENTIONS.md has no table of types");
    let mut types = Vec::new();
    for folder in ["src", "mapper/src", "web/src"] {
        for file in tree::rust_files(folder) {
            let names = rust::types(&tree::read(&file));
            types.extend(names.into_iter().map(|name| (name, file.clone())));
        }
    }
    let sentences = breaches(&words, &types);
    assert!(
        sentences.is_empty(),
        "read what the word means in docs/CONVENTIONS.md, then rename the type or add it to the table there:\n{}",
        sentences.join("\n")
    );
}

#[test]
fn a_type_with_another_meaning_is_noticed() {
    let words = table(
        "| word | types in Rust | types in TypeScript |\n| --- | --- | --- |\n| frame | `FrameView` | `RawFrame` |\n",
    );
    let of = |names: &[&str]| {
        let types: Vec<_> = names
            .iter()
            .map(|name| ((*name).to_owned(), "a.rs".to_owned()))
            .collect();
        breaches(&words, &types)
    };
    assert_eq!(of(&["FrameView", "Keyframe", "Framework"]), [""; 0]);
    assert_eq!(
        of(&["FrameView", "SceneFrame"]),
        ["a.rs: SceneFrame carries `frame`"]
    );
    assert_eq!(of(&["Pose"]), ["no type is called FrameView"]);
    let open = table("| word | types in Rust |\n| --- | --- |\n| frame | `Frame*` |\n");
    let both = ["FrameView", "SceneFrame"].map(|name| (name.to_owned(), "a.rs".to_owned()));
    assert_eq!(breaches(&open, &both), ["a.rs: SceneFrame carries `frame`"]);
    assert_eq!(parts("GPUFrame2"), ["gpuframe2"]);
    assert_eq!(parts("TrackedPoint"), ["tracked", "point"]);
    assert_eq!(
        rust::types(
            "struct A; pub enum B { C } #[cfg(test)] mod tests { struct D; } fn f() { type E = u8; }"
        ),
        ["A", "B", "E"]
    );
}

/// `extrinsics` is the field's other word for `cam_from_world`, and does not say which way round.
#[test]
fn transforms_say_their_direction() {
    let mut found = Vec::new();
    for folder in ["src", "mapper/src", "web/src"] {
        for file in tree::rust_files(folder) {
            for (line, ident) in rust::identifiers(&file) {
                if ident.split('_').any(|part| part == "extrinsics") {
                    found.push(format!("{file}:{line}: {ident}"));
                }
            }
        }
    }
    assert!(
        found.is_empty(),
        "say which way round:\n{}",
        found.join("\n")
    );
}
