//! `cargo xtask site`: everything that is published under one address: the demo page, and the documents as pages beside it.
//! A document lies under `docs/` at its path in the checkout, with another ending, so that its links hold as they are.

use crate::files::{copy, copy_tree};
use crate::{paths, pins, web};
use anyhow::{Context as _, Result, bail};
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, TagEnd, html};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Stages the demo page and the documents in one folder that any static host can serve.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Path that the page will live under; only the page for wrong addresses needs to know.
    #[arg(long, default_value = "/")]
    base: String,
    /// Folder to fill.
    #[arg(long, default_value = "dist/pages")]
    out: PathBuf,
    /// Only the documents, without building the page.
    #[arg(long)]
    docs_only: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if !args.docs_only {
        web::build()?;
    }
    let out = paths::root().join(&args.out);
    let scratch = out.with_extension("tmp");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    if !args.docs_only {
        copy_tree(&paths::site(), &scratch)?;
    }
    let num_pages = write_documents(&scratch.join("docs"))?;
    let base = format!("/{}/", args.base.trim_matches('/')).replace("//", "/");
    paths::write(&scratch.join("404.html"), not_found(&base).as_bytes())?;
    // GitHub's own page builder stays away.
    paths::write(&scratch.join(".nojekyll"), b"")?;
    paths::replace_dir(&scratch, &out)?;
    println!("site    {num_pages} documents, {}", out.display());
    println!(
        "site    try it: cargo xtask serve --dir {} --base {base}",
        args.out.display()
    );
    Ok(())
}

/// Groups of documents, in the order of the list beside each page.
const GROUPS: [(&str, &[&str]); 5] = [
    (
        "Landline",
        &["README.md", "CHANGELOG.md", "CONTRIBUTING.md"],
    ),
    (
        "Package",
        &["pkg-config/README.npm.md", "examples/browser/README.md"],
    ),
    ("Guides", &["docs/guides/"]),
    ("Inside", &["docs/"]),
    ("Measurements", &["docs/benchmarks/"]),
];

/// A document: its path, its title, its Markdown.
struct Document {
    path: String,
    group: &'static str,
    title: String,
    text: String,
}

/// All documents, grouped.
fn documents() -> Result<Vec<Document>> {
    let root = paths::root();
    let mut found = Vec::new();
    for (group, names) in GROUPS {
        for name in names {
            let files = if let Some(folder) = name.strip_suffix('/') {
                let mut files: Vec<String> = fs::read_dir(root.join(folder))?
                    .flatten()
                    .map(|entry| format!("{name}{}", entry.file_name().to_string_lossy()))
                    .filter(|file| file.ends_with(".md"))
                    .collect();
                files.sort();
                files
            } else {
                vec![(*name).to_owned()]
            };
            for path in files {
                let text = pins::text(&path)?;
                let title = text
                    .lines()
                    .find_map(|line| line.strip_prefix("# "))
                    .with_context(|| format!("{path} has no title"))?
                    .to_owned();
                found.push(Document {
                    path,
                    group,
                    title,
                    text,
                });
            }
        }
    }
    Ok(found)
}

/// Writes the documents as pages, and what they show; says how many.
///
/// # Errors
///
/// When a link leads nowhere, all of them named.
pub(crate) fn write_documents(out: &Path) -> Result<usize> {
    let documents = documents()?;
    let repository = web::workspace_value("repository")?;
    let known: BTreeSet<&str> = documents.iter().map(|d| d.path.as_str()).collect();
    let mut wanted: Vec<(String, String, String)> = Vec::new();
    let mut ids: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut shown: BTreeSet<String> = BTreeSet::new();
    for document in &documents {
        let folder = document
            .path
            .rsplit_once('/')
            .map_or("", |(folder, _)| folder);
        let mut links = |target: &str, is_picture: bool| -> String {
            if target.contains("://") || target.starts_with("mailto:") {
                return target.to_owned();
            }
            let (path, anchor) = target.split_once('#').unwrap_or((target, ""));
            let full = match path {
                "" => document.path.clone(),
                path => joined(folder, path),
            };
            wanted.push((document.path.clone(), full.clone(), anchor.to_owned()));
            if is_picture {
                shown.insert(full);
                target.to_owned()
            } else if known.contains(full.as_str()) {
                target.replace(".md", ".html")
            } else {
                format!("{repository}/blob/main/{full}")
            }
        };
        let (body, own_ids) = rendered(&document.text, &mut links);
        ids.insert(document.path.clone(), own_ids);
        let page = page(document, &documents, &body);
        paths::write(
            &out.join(document.path.replace(".md", ".html")),
            page.as_bytes(),
        )?;
    }
    let root = paths::root();
    let broken: Vec<String> = wanted
        .iter()
        .filter(|(_, to, anchor)| {
            let has_anchor = || ids.get(to).is_none_or(|ids| ids.contains(anchor));
            !root.join(to).exists() || !(anchor.is_empty() || has_anchor())
        })
        .map(|(from, to, anchor)| format!("{from}: {to}#{anchor}"))
        .collect();
    if !broken.is_empty() {
        bail!("links that lead nowhere:\n{}", broken.join("\n"));
    }
    for picture in shown {
        copy(&root.join(&picture), &out.join(&picture))?;
    }
    let api = Document {
        path: API.to_owned(),
        group: "Package",
        title: "Declarations".to_owned(),
        text: format!(
            "# Declarations\n\n```ts\n{}\n```\n",
            pins::text("pkg-config/api.d.ts")?
        ),
    };
    let (body, _) = rendered(&api.text, &mut |target, _| target.to_owned());
    let page = page(&api, &documents, &body);
    paths::write(&out.join(API.replace(".md", ".html")), page.as_bytes())?;
    paths::write(&out.join("docs.css"), STYLE.as_bytes())?;
    let index = "<!doctype html><meta charset=\"utf-8\"><title>Landline</title><meta http-equiv=\"refresh\" content=\"0; url=README.html\"><a href=\"README.html\">Landline</a>";
    paths::write(&out.join("index.html"), index.as_bytes())?;
    Ok(documents.len() + 1)
}

/// The declarations as a page of their own.
const API: &str = "pkg-config/api.md";

/// Markdown as HTML, every heading with an identifier, every link and picture as `links` says; and the identifiers.
fn rendered(text: &str, links: &mut dyn FnMut(&str, bool) -> String) -> (String, BTreeSet<String>) {
    let options = Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH;
    let mut events: Vec<Event<'_>> = Parser::new_ext(text, options).collect();
    let mut ids = BTreeSet::new();
    for i in 0..events.len() {
        if let Event::Start(Tag::Heading { .. }) = events[i] {
            let is_end = |e: &Event<'_>| matches!(e, Event::End(TagEnd::Heading(_)));
            let words: String = events[i..]
                .iter()
                .take_while(|e| !is_end(e))
                .filter_map(|e| match e {
                    Event::Text(text) | Event::Code(text) => Some(text.as_ref()),
                    _ => None,
                })
                .collect();
            let own = slug(&words);
            if let Event::Start(Tag::Heading { id, .. }) = &mut events[i] {
                *id = Some(CowStr::from(own.clone()));
            }
            ids.insert(own);
        }
        match &mut events[i] {
            Event::Start(Tag::Link { dest_url, .. }) => *dest_url = links(dest_url, false).into(),
            Event::Start(Tag::Image { dest_url, .. }) => *dest_url = links(dest_url, true).into(),
            _ => {}
        }
    }
    let mut out = String::new();
    html::push_html(&mut out, events.into_iter());
    (out, ids)
}

/// The identifier that code hosts give to a heading.
fn slug(words: &str) -> String {
    words
        .to_lowercase()
        .chars()
        .filter_map(|c| match c {
            ' ' => Some('-'),
            c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
            _ => None,
        })
        .collect()
}

/// `a/b` and `../c` → `a/c`.
fn joined(folder: &str, path: &str) -> String {
    let resolved = crate::files::resolve(folder, path);
    if path.ends_with('/') {
        resolved.trim_end_matches('/').to_owned()
    } else {
        resolved
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

fn page(document: &Document, all: &[Document], body: &str) -> String {
    let up = "../".repeat(document.path.matches('/').count());
    let title = escaped(&document.title.replace('`', ""));
    let mut list = format!("<a href=\"{up}../\">The demo page</a>");
    for (group, _) in GROUPS {
        list.push_str(&format!("<h2>{group}</h2>"));
        let api = (API, "Declarations");
        let own = all.iter().filter(|d| d.group == group);
        let own = own.map(|d| (d.path.as_str(), d.title.as_str()));
        for (path, title) in own.chain((group == "Package").then_some(api)) {
            let here = if path == document.path {
                " aria-current=\"page\""
            } else {
                ""
            };
            let title = escaped(&title.replace('`', ""));
            let path = path.replace(".md", ".html");
            list.push_str(&format!("<a href=\"{up}{path}\"{here}>{title}</a>"));
        }
    }
    format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'self'; style-src-attr 'unsafe-inline'; img-src 'self'\">\
         <title>{title} - Landline</title><link rel=\"stylesheet\" href=\"{up}docs.css\"><link rel=\"icon\" href=\"{up}../icon.svg\">\
         <nav aria-label=\"Documents\">{list}</nav>\n<main>{body}</main></html>\n"
    )
}

fn not_found(base: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Not here - Landline</title>\
         <p>There is nothing at this address. <a href=\"{base}\">The demo page</a>, <a href=\"{base}docs/\">the documents</a>.</html>\n"
    )
}

const STYLE: &str = "\
:root { color-scheme: light dark; font: 16px/1.55 system-ui, sans-serif }
body { margin: 0; display: grid; grid-template-columns: minmax(13rem, 17rem) minmax(0, 52rem); gap: 2.5rem; padding: 1.5rem }
nav a { display: block; padding: .15rem 0; text-decoration: none }
nav a[aria-current] { font-weight: 600 }
nav h2 { font-size: .8rem; letter-spacing: .04em; text-transform: uppercase; margin: 1.1rem 0 .2rem }
main :is(pre, table) { overflow-x: auto; display: block; max-width: 100% }
pre { padding: .8rem 1rem; background: color-mix(in srgb, CanvasText 7%, Canvas); border-radius: .4rem; font-size: .86rem }
code { font-family: ui-monospace, monospace }
table { border-collapse: collapse }
th, td { border: 1px solid color-mix(in srgb, CanvasText 55%, Canvas); padding: .3rem .6rem; text-align: left; vertical-align: top }
img { max-width: 100% }
@media (max-width: 50rem) { body { display: block; padding: 1rem } nav { columns: 2 } }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_get_identifiers_and_links_are_turned() {
        let text = "# A `b`, c\n\n[x](y.md#z) ![p](p.png)\n\n| a |\n| - |\n| 1 |\n";
        let mut seen = Vec::new();
        let (html, ids) = rendered(text, &mut |target, is_picture| {
            seen.push((target.to_owned(), is_picture));
            target.replace(".md", ".html")
        });
        assert_eq!(
            seen,
            [("y.md#z".to_owned(), false), ("p.png".to_owned(), true)]
        );
        assert!(ids.contains("a-b-c"), "{ids:?}");
        for part in [
            "<h1 id=\"a-b-c\">",
            "href=\"y.html#z\"",
            "src=\"p.png\"",
            "<table>",
        ] {
            assert!(html.contains(part), "{part} in {html}");
        }
    }

    #[test]
    fn the_documents_make_a_site() {
        let out = std::env::temp_dir().join(format!("landline-docs-{}", std::process::id()));
        let num_pages = write_documents(&out).expect("all links lead somewhere");
        assert!(num_pages > 20, "{num_pages}");
        let guide =
            fs::read_to_string(out.join("docs/guides/map-your-room.html")).expect("is there");
        assert!(
            guide.contains("href=\"../benchmarks/reconstruction.html\""),
            "a link between documents"
        );
        assert!(guide.contains("href=\"../../docs.css\""));
        let first = fs::read_to_string(out.join("README.html")).expect("is there");
        assert!(
            first.contains("src=\"docs/images/demo.jpg\"")
                && out.join("docs/images/demo.jpg").is_file()
        );
        fs::remove_dir_all(&out).expect("is there");
    }
}
