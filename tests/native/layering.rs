//! Holds the code to the layers of `docs/ARCHITECTURE.md`.

use crate::tree;
use std::collections::BTreeMap;

/// Module → what it may import, from the table of the document.
fn table() -> BTreeMap<String, Vec<String>> {
    let text = tree::read("docs/ARCHITECTURE.md");
    let rows = text
        .lines()
        .skip_while(|line| !line.starts_with("| module | may import |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let mut layers = BTreeMap::new();
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let module = cells[0].trim_matches('`').to_owned();
        let allowed = match cells[1] {
            "nothing" => Vec::new(),
            "all of the above" => layers.keys().cloned().collect(),
            list => list
                .split(',')
                .map(|name| name.trim().trim_matches('`').to_owned())
                .collect(),
        };
        layers.insert(module, allowed);
    }
    layers
}

/// Names that follow `crate::` in a line of code: one, or those of a group.
fn crate_names(code: &str) -> Vec<&str> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let standalone = !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
        let rest = &code[at + "crate::".len()..];
        if !standalone {
            continue;
        }
        if let Some(group) = rest.strip_prefix('{') {
            let mut depth = 0;
            for part in group.split_inclusive(['{', '}', ',']) {
                if depth == 0 {
                    names.push(ident(part.trim_start()));
                }
                depth += i32::from(part.ends_with('{')) - i32::from(part.ends_with('}'));
                if depth < 0 {
                    break;
                }
            }
        } else {
            names.push(ident(rest));
        }
    }
    names.retain(|name| !name.is_empty());
    names
}

fn ident(text: &str) -> &str {
    let end = text
        .find(|c: char| !c.is_alphanumeric() && c != '_')
        .unwrap_or(text.len());
    &text[..end]
}

#[test]
fn modules_import_only_lower_layers() {
    let layers = table();
    assert!(
        layers.len() > 5,
        "the layer table of docs/ARCHITECTURE.md was not found"
    );
    let mut broken = Vec::new();
    for file in tree::rust_files("src") {
        let Some(module) = file
            .strip_prefix("src/")
            .and_then(|rest| rest.split_once('/'))
            .map(|(module, _)| module)
        else {
            continue;
        };
        let Some(allowed) = layers.get(module) else {
            broken.push(format!(
                "{file}: the module {module} is not in the layer table"
            ));
            continue;
        };
        for (number, code) in tree::code_statements(&tree::read(&file)) {
            for name in crate_names(&code) {
                let known = layers.contains_key(name);
                let may =
                    name == module || name == "math" || allowed.iter().any(|other| other == name);
                if known && !may {
                    broken.push(format!("{file}:{number}: {module} imports {name}"));
                }
            }
        }
    }
    assert!(
        broken.is_empty(),
        "layers of docs/ARCHITECTURE.md are broken:\n{}",
        broken.join("\n")
    );
}

#[test]
fn the_core_does_not_know_the_browser() {
    let manifest = tree::read("Cargo.toml");
    let direct = manifest
        .split("\n[dependencies]")
        .nth(1)
        .and_then(|rest| rest.split("\n[").next())
        .unwrap_or("");
    let mut broken: Vec<String> = direct
        .lines()
        .filter(|line| {
            ["wasm-bindgen", "web-sys", "js-sys"]
                .iter()
                .any(|name| line.starts_with(name))
        })
        .map(|line| format!("Cargo.toml: {line}"))
        .collect();
    for file in tree::rust_files("src") {
        for (number, code) in tree::code_statements(&tree::read(&file)) {
            if ["wasm_bindgen", "web_sys", "js_sys"]
                .iter()
                .any(|name| code.contains(name))
            {
                broken.push(format!("{file}:{number}: {code}"));
            }
        }
    }
    assert!(
        broken.is_empty(),
        "browser bindings belong in web/:\n{}",
        broken.join("\n")
    );
}

#[test]
fn only_the_trainer_uses_burn() {
    let broken = uses("mapper", "burn::", |file| {
        file.contains("/train/") || file.ends_with("/train.rs")
    });
    assert!(
        broken.is_empty(),
        "burn belongs in mapper/src/train:\n{}",
        broken.join("\n")
    );
}

#[test]
fn unsafe_code_stays_in_kernels() {
    let broken = uses("src", "unsafe", |file| file.contains("kernels"));
    let broken: Vec<_> = broken
        .iter()
        .filter(|line| !line.contains("unsafe_code"))
        .collect();
    assert!(
        broken.is_empty(),
        "unsafe code belongs in modules called kernels: {broken:#?}"
    );
}

/// Fused and approximate operations give other last digits on other machines; where native and wasm have to agree,
/// they are not used.
#[test]
fn portable_modules_do_not_fuse() {
    let mut broken = Vec::new();
    for module in [
        "src/math",
        "src/geometry",
        "src/image",
        "src/lsd",
        "src/pose",
    ] {
        for word in [".mul_add(", ".recip()", "_fmadd_", "relaxed_madd", "vfmaq"] {
            broken.extend(uses(module, word, |_| false));
        }
    }
    assert!(
        broken.is_empty(),
        "native and wasm would differ:\n{}",
        broken.join("\n")
    );
}

/// A time budget comes as a closure of the caller; browsers have no `Instant`, and results may not depend on a clock.
#[test]
fn the_core_reads_no_clock() {
    let mut broken = uses("src", "Instant::now", |_| false);
    broken.extend(uses("src", "SystemTime", |_| false));
    assert!(
        broken.is_empty(),
        "the core takes its clock from the caller:\n{}",
        broken.join("\n")
    );
}

/// Lines of code below `folder` that contain `word`, outside the files that `exempt` names.
fn uses(folder: &str, word: &str, exempt: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for file in tree::rust_files(folder)
        .into_iter()
        .filter(|file| !exempt(file))
    {
        for (number, code) in tree::code_statements(&tree::read(&file)) {
            if code.contains(word) {
                found.push(format!("{file}:{number}: {}", code.trim()));
            }
        }
    }
    found
}

#[test]
fn reads_single_and_grouped_imports() {
    assert_eq!(
        crate_names("use crate::image::{GrayView, check};"),
        ["image"]
    );
    assert_eq!(
        crate_names("use crate::{image::{A, B}, pose, math::C};"),
        ["image", "pose", "math"]
    );
    assert_eq!(
        crate_names("let x = crate::lsd::detect(crate::pose::y);"),
        ["lsd", "pose"]
    );
    assert_eq!(
        crate_names("pub(crate) use other_crate::pose;"),
        Vec::<&str>::new()
    );
}
