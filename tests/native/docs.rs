//! Holds the documents to the tree: folders, links, commands, paper keys, and what must not be in git.

use crate::tree;
use std::fs;

/// Every document that people read on its own.
fn documents() -> Vec<String> {
    tree::files(".", ".md")
        .into_iter()
        .map(|path| path.trim_start_matches("./").to_owned())
        .collect()
}

#[test]
fn folders_of_the_architecture_exist_and_are_complete() {
    let text = tree::read("docs/ARCHITECTURE.md");
    let named: Vec<&str> = text
        .lines()
        .skip_while(|line| !line.starts_with("| folder |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .filter_map(|line| line.split('`').nth(1))
        .collect();
    let missing: Vec<_> = named
        .iter()
        .filter(|folder| !tree::root().join(folder).is_dir())
        .collect();
    assert!(
        missing.is_empty(),
        "docs/ARCHITECTURE.md names folders that do not exist: {missing:?}"
    );

    let present = |dir: &str| -> Vec<String> {
        fs::read_dir(tree::root().join(dir))
            .into_iter()
            .flatten()
            .flatten()
            .filter(|entry| entry.path().is_dir())
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect()
    };
    let ignored = [
        ".git",
        "target",
        "dist",
        "node_modules",
        ".venv",
        ".idea",
        ".vscode",
    ];
    let mut unnamed: Vec<String> = present(".")
        .into_iter()
        .filter(|name| !ignored.contains(&name.as_str()))
        .map(|name| format!("{name}/"))
        .collect();
    unnamed.extend(
        present("src")
            .into_iter()
            .map(|name| format!("src/{name}/")),
    );
    unnamed.retain(|folder| !named.contains(&folder.as_str()));
    assert!(
        unnamed.is_empty(),
        "docs/ARCHITECTURE.md does not name {unnamed:?}"
    );
}

#[test]
fn limits_stand_in_the_code_as_in_their_table() {
    let text = tree::read("docs/ARCHITECTURE.md");
    let rows: Vec<_> = text
        .lines()
        .skip_while(|line| !line.starts_with("| what | at most |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .collect();
    assert!(rows.len() > 10, "the table of limits has gone");
    let mut wrong = Vec::new();
    for row in rows {
        let mut quoted = row.split('`').skip(1).step_by(2);
        let (Some(code), Some(file)) = (quoted.next(), quoted.next()) else {
            panic!("no code and file in {row}");
        };
        // A longer number would begin alike.
        let source = tree::read(file);
        let is_there = source
            .match_indices(code)
            .any(|(at, _)| source[at + code.len()..].starts_with(';'));
        if !is_there {
            wrong.push(format!("{file} does not say {code}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn links_between_documents_lead_somewhere() {
    let mut broken = Vec::new();
    for document in documents() {
        let text = tree::read(&document);
        let folder = document.rsplit_once('/').map_or("", |(folder, _)| folder);
        for target in text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next())
        {
            let path = target.split('#').next().unwrap_or("");
            if path.is_empty() || path.contains("://") || path.starts_with("mailto:") {
                continue;
            }
            if !tree::root().join(folder).join(path).exists() {
                broken.push(format!("{document}: {target}"));
            }
        }
    }
    assert!(
        broken.is_empty(),
        "links that lead nowhere:\n{}",
        broken.join("\n")
    );
}

/// Guides name the files that have to be touched; a name with a placeholder stands for a new one.
#[test]
fn files_of_the_guides_exist() {
    let mut missing = Vec::new();
    let folders = [
        "src/",
        "mapper/src/",
        "mapper/tests/",
        "testkit/",
        "tests/",
        "web/",
        "docs/",
        "benches/",
        "xtask/",
        "pkg-config/",
        "www/",
    ];
    for guide in tree::files("docs/guides", ".md") {
        let text = tree::read(&guide);
        for name in text.split('`').skip(1).step_by(2) {
            let is_path = folders.iter().any(|folder| name.starts_with(folder));
            if is_path && !name.contains(['<', ' ', '*']) && !tree::root().join(name).exists() {
                missing.push(format!("{guide}: {name}"));
            }
        }
    }
    assert!(missing.is_empty(), "no such file:\n{}", missing.join("\n"));
}

#[test]
fn documented_commands_exist() {
    let table = tree::read("xtask/src/main.rs");
    let known: Vec<String> = table
        .split("enum Command {")
        .nth(1)
        .and_then(|rest| rest.split('}').next())
        .unwrap_or("")
        .lines()
        .filter_map(|line| line.trim().split('(').next())
        .map(str::to_lowercase)
        .filter(|name| !name.is_empty())
        .collect();
    let mut broken = Vec::new();
    for document in documents()
        .into_iter()
        .chain(tree::files(".github", ".yml"))
    {
        for word in tree::read(&document).split("cargo xtask ").skip(1) {
            let name: String = word
                .chars()
                .take_while(|c| c.is_ascii_lowercase() || *c == '-')
                .collect();
            if !name.is_empty() && !known.contains(&name) {
                broken.push(format!("{document}: cargo xtask {name}"));
            }
        }
    }
    assert!(
        broken.is_empty(),
        "no such command (known: {known:?}):\n{}",
        broken.join("\n")
    );
}

/// The archives of a release are those that `cargo binstall` asks for.
#[test]
fn releases_are_named_as_their_manifest_says() {
    let manifest = tree::read("mapper/Cargo.toml");
    let workflow = tree::read(".github/workflows/release.yml");
    let value = |key: &str| {
        let rest = manifest.split(&format!("{key} = \"")).nth(1);
        rest.and_then(|rest| rest.split('"').next())
            .unwrap_or_default()
            .to_owned()
    };
    assert!(value("pkg-url").ends_with("/v{ version }/landline-{ target }.tgz"));
    assert_eq!(
        value("bin-dir"),
        "landline-{ target }/{ bin }{ binary-ext }"
    );
    for part in [
        "tags: [\"v*\"]",
        "NAME: \"landline-${{ matrix.target }}\"",
        "tar czf \"$NAME.tgz\" \"$NAME\"",
        "--package landline-mapper",
    ] {
        assert!(workflow.contains(part), "release.yml lacks {part}");
    }
}

/// A key such as `[lsd2012]` in a module's header stands for a row of `docs/PAPERS.md`.
#[test]
fn cited_papers_are_listed() {
    let papers = tree::read("docs/PAPERS.md");
    let mut missing = Vec::new();
    for folder in ["src", "mapper", "testkit", "web"] {
        for file in tree::rust_files(folder) {
            for line in tree::read(&file)
                .lines()
                .filter(|line| line.trim_start().starts_with("//"))
            {
                for key in line
                    .split("`[")
                    .skip(1)
                    .filter_map(|rest| rest.split("]`").next())
                {
                    if is_paper_key(key) && !papers.contains(&format!("`[{key}]`")) {
                        missing.push(format!("{file}: [{key}]"));
                    }
                }
            }
        }
    }
    missing.dedup();
    assert!(
        missing.is_empty(),
        "docs/PAPERS.md does not list:\n{}",
        missing.join("\n")
    );
}

/// Letters (with digits among them), then a year.
fn is_paper_key(key: &str) -> bool {
    let name = key.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_word = key
        .chars()
        .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
    is_word && !name.is_empty() && key.len() - name.len() == 4
}

/// Lock files record versions and hashes, not the hosts of somebody's registry.
#[test]
fn lock_files_name_no_registry_host() {
    for lock in tree::files(".", "package-lock.json") {
        assert!(
            !tree::read(&lock).contains("\"resolved\""),
            "{lock} records download addresses"
        );
    }
}

/// A note on work to be done belongs to an issue, and says which.
#[test]
fn open_notes_name_their_issue() {
    let mut broken = Vec::new();
    for folder in ["src", "mapper", "testkit", "web/src", "xtask"] {
        for file in tree::rust_files(folder) {
            for (number, line) in tree::read(&file).lines().enumerate() {
                let bare = line.contains("TODO") && !line.contains("TODO(#");
                if bare || line.contains("FIXME") {
                    broken.push(format!("{file}:{}: {}", number + 1, line.trim()));
                }
            }
        }
    }
    assert!(
        broken.is_empty(),
        "write TODO(#issue):\n{}",
        broken.join("\n")
    );
}

#[test]
fn tells_paper_keys_from_other_brackets() {
    for (key, is_key) in [
        ("lsd2012", true),
        ("pl2map2025", true),
        ("0", false),
        ("2012", false),
        ("N, 64", false),
    ] {
        assert_eq!(is_paper_key(key), is_key, "{key}");
    }
}
