//! Holds the code to the layers of `docs/ARCHITECTURE.md`.

use crate::{rust, tree};

/// Module → what it may import, from the table of the document that follows these words; in the table's order.
fn table(words: &str) -> Vec<(String, Vec<String>)> {
    let text = tree::read("docs/ARCHITECTURE.md");
    let rows = text
        .lines()
        .skip_while(|line| !line.starts_with(words))
        .skip_while(|line| !line.starts_with("| module | may import |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let mut layers: Vec<(String, Vec<String>)> = Vec::new();
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let module = cells[0].trim_matches('`').to_owned();
        let allowed = match cells[1] {
            "nothing" => Vec::new(),
            "all of the above" => layers.iter().map(|(name, _)| name.clone()).collect(),
            list => list
                .split(',')
                .map(|name| name.trim().trim_matches('`').to_owned())
                .collect(),
        };
        layers.push((module, allowed));
    }
    assert!(
        layers.len() > 5,
        "docs/ARCHITECTURE.md has no table after `{words}`"
    );
    layers
}

/// What breaks a table, as sentences: imports of the files of a crate that their row does not list, modules without a row,
/// rows that list something below them. Every row may import `common` as well.
fn broken(source: &str, layers: &[(String, Vec<String>)], common: &[&str]) -> Vec<String> {
    let mut sentences = Vec::new();
    for (i, (module, allowed)) in layers.iter().enumerate() {
        for name in allowed {
            if !layers[..i].iter().any(|(above, _)| above == name) {
                sentences.push(format!(
                    "{module} may import {name}, which is not above it in the table"
                ));
            }
        }
    }
    let mut seen: Vec<&str> = Vec::new();
    for file in tree::rust_files(source) {
        let path = file.strip_prefix(&format!("{source}/")).unwrap_or(&file);
        let module = rust::module_of(path);
        let Some(top) = module.first() else {
            // The root only says which modules there are.
            continue;
        };
        let Some((top, allowed)) = layers.iter().find(|(name, _)| name == top) else {
            sentences.push(format!("{file}: the module {top} is not in the table"));
            continue;
        };
        seen.push(top);
        for import in rust::imports(&tree::read(&file), &module) {
            let may = import.path.first().is_some_and(|name| {
                name == top
                    || common.contains(&name.as_str())
                    || allowed.iter().any(|other| other == name)
            });
            if !may {
                let what = match import.path.first() {
                    Some(name) => format!("{name} ({})", import.text),
                    None => format!("the whole crate ({})", import.text),
                };
                sentences.push(format!("{file}:{}: {top} imports {what}", import.line));
            }
        }
    }
    for (module, _) in layers {
        if !seen.contains(&module.as_str()) {
            sentences.push(format!("{module} of the table does not exist"));
        }
    }
    sentences
}

#[test]
fn modules_of_the_core_import_only_lower_layers() {
    let sentences = broken("src", &table("Modules of the core:"), &["math"]);
    assert!(
        sentences.is_empty(),
        "the layers of docs/ARCHITECTURE.md are broken:\n{}",
        sentences.join("\n")
    );
}

#[test]
fn modules_of_the_mapper_import_only_lower_layers() {
    let sentences = broken("mapper/src", &table("Modules of the mapper:"), &[]);
    assert!(
        sentences.is_empty(),
        "the layers of docs/ARCHITECTURE.md are broken:\n{}",
        sentences.join("\n")
    );
}

#[test]
fn commands_of_the_mapper_do_not_know_each_other() {
    let mut broken = Vec::new();
    for file in tree::rust_files("mapper/src/cmd") {
        let module = rust::module_of(file.trim_start_matches("mapper/src/"));
        for import in rust::imports(&tree::read(&file), &module) {
            let is_own = import.path.get(1) == module.get(1) || module.len() < 2;
            if import.path.first().is_some_and(|top| top == "cmd") && !is_own {
                broken.push(format!("{file}:{}: {}", import.line, import.text));
            }
        }
    }
    assert!(
        broken.is_empty(),
        "what commands share belongs into a module below them:\n{}",
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
    for name in ["wasm_bindgen", "web_sys", "js_sys"] {
        broken.extend(uses("src", |ident| ident == name, |_| false));
    }
    assert!(
        broken.is_empty(),
        "browser bindings belong in web/:\n{}",
        broken.join("\n")
    );
}

#[test]
fn only_the_trainer_uses_burn() {
    let broken = uses(
        "mapper",
        |ident| ident == "burn",
        |file| file.contains("/train/") || file.ends_with("/train.rs"),
    );
    assert!(
        broken.is_empty(),
        "burn belongs in mapper/src/train:\n{}",
        broken.join("\n")
    );
}

#[test]
fn only_commands_and_their_arguments_know_the_command_line() {
    let is_meant = |file: &str| {
        let at = file.trim_start_matches("mapper/src/");
        at.starts_with("cmd/")
            || at == "main.rs"
            || at == "words.rs"
            || at == "args.rs"
            || at.ends_with("/args.rs")
    };
    let broken = uses("mapper/src", |ident| ident == "clap", is_meant);
    assert!(
        broken.is_empty(),
        "the command line belongs in cmd, args.rs and words.rs of mapper/src:\n{}",
        broken.join("\n")
    );
}

#[test]
fn unsafe_code_stays_in_kernels() {
    let broken = uses(
        "src",
        |ident| ident == "unsafe",
        |file| file.contains("kernels"),
    );
    assert!(
        broken.is_empty(),
        "unsafe code belongs in modules called kernels: {broken:#?}"
    );
}

#[test]
fn unsafe_code_is_in_the_inventory() {
    let mut found = Vec::new();
    for file in tree::rust_files(".") {
        let is_unsafe = |(_, ident): &(usize, String)| ident == "unsafe";
        // Most files do not hold the word, and need not be parsed.
        if tree::read(&file).contains("unsafe") {
            let times = rust::identifiers(&file).into_iter().filter(is_unsafe);
            found.push((file, times.count()));
        }
    }
    found.retain(|(_, times)| *times > 0);
    let text = tree::read("docs/SUPPLY.md");
    let table: Vec<(String, usize)> = text
        .lines()
        .skip_while(|line| !line.starts_with("| file | times |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .filter_map(|row| {
            let mut cells = row.trim_matches('|').split('|').map(str::trim);
            let file = cells.next()?.trim_matches('`').to_owned();
            Some((file, cells.next()?.parse().ok()?))
        })
        .collect();
    assert_eq!(found, table, "the inventory of docs/SUPPLY.md");
}

/// Test support is asked for by tests, benches and examples; it is not built into what ships.
#[test]
fn what_ships_does_not_depend_on_test_support() {
    for crate_folder in ["", "web/", "mapper/"] {
        let manifest = format!("{crate_folder}Cargo.toml");
        let text = tree::read(&manifest);
        let mut section = "";
        let mut is_used_by_tests = false;
        for line in text.lines() {
            if line.starts_with('[') {
                section = line;
            } else if line.starts_with("landline-testkit.") {
                assert!(
                    section == "[dev-dependencies]",
                    "{manifest}: {line} in {section}"
                );
                is_used_by_tests = true;
            }
        }
        assert!(is_used_by_tests, "{manifest} is not read rightly");
    }
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
        "src/reconstruction",
    ] {
        let is_fused = |ident: &str| {
            matches!(ident, "mul_add" | "recip")
                || ["_fmadd_", "relaxed_madd", "vfmaq"]
                    .iter()
                    .any(|part| ident.contains(part))
        };
        broken.extend(uses(module, is_fused, |_| false));
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
    let broken = uses(
        "src",
        |ident| matches!(ident, "Instant" | "SystemTime"),
        |_| false,
    );
    assert!(
        broken.is_empty(),
        "the core takes its clock from the caller:\n{}",
        broken.join("\n")
    );
}

/// Identifiers in the code below `folder` of which `is_meant` is true, outside the files that `exempt` names.
fn uses(
    folder: &str,
    is_meant: impl Fn(&str) -> bool,
    exempt: impl Fn(&str) -> bool,
) -> Vec<String> {
    let mut found = Vec::new();
    for file in tree::rust_files(folder)
        .into_iter()
        .filter(|file| !exempt(file))
    {
        for (line, ident) in rust::identifiers(&file) {
            if is_meant(&ident) {
                found.push(format!("{file}:{line}: {ident}"));
            }
        }
    }
    found
}
