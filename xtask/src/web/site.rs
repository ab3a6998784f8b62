//! The demo page as it is served: `www/`, the built package and three.js, in `dist/site`.

use crate::files::{copy, copy_tree, files, resolve};
use crate::paths;
use anyhow::{Context as _, Result, bail};
use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use sha2::{Digest as _, Sha256};
use std::fs;
use std::path::Path;

/// Copies everything into place, in one rename.
pub(super) fn stage() -> Result<()> {
    let www = paths::root().join("www");
    if !www.join("index.html").is_file() {
        bail!("www/index.html is missing");
    }
    println!("web     demo page");
    let finished = paths::site();
    let scratch = finished.with_file_name(".site.tmp");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    copy_tree(&www, &scratch)?;
    super::comments::strip(&scratch)?;
    copy_tree(&paths::package(), &scratch.join("vendor/landline"))?;
    // The page has the whole sample of its own.
    fs::remove_dir_all(scratch.join("vendor/landline/sample"))?;
    copy_three(&scratch.join("vendor/three"))?;
    let index = scratch.join("index.html");
    let html = fs::read_to_string(&index).context("www/index.html is not UTF-8")?;
    paths::write(&index, with_import_map_hash(&html)?.as_bytes())?;
    list_files(&scratch)?;
    paths::replace_dir(&scratch, &finished)
}

/// three.js: the library, and of its addons those that the page's scripts name, with what these import in turn.
fn copy_three(to: &Path) -> Result<()> {
    let three = paths::root().join("web/node_modules/three");
    for name in files(&three.join("build"))? {
        if matches!(name.as_str(), "three.module.min.js" | "three.core.min.js") {
            copy(&three.join("build").join(&name), &to.join(&name))?;
        }
    }
    copy(&three.join("LICENSE"), &to.join("LICENSE"))?;
    let addons = three.join("examples/jsm");
    let mut wanted: Vec<String> = Vec::new();
    let www = paths::root().join("www");
    for name in files(&www)?.iter().filter(|name| name.ends_with(".js")) {
        for import in imports(&fs::read_to_string(www.join(name))?) {
            if let Some(addon) = import.strip_prefix("three/addons/") {
                wanted.push(addon.to_owned());
            }
        }
    }
    let mut copied: Vec<String> = Vec::new();
    while let Some(addon) = wanted.pop() {
        if copied.contains(&addon) {
            continue;
        }
        let text = fs::read_to_string(addons.join(&addon)).with_context(|| {
            format!("www/ imports three/addons/{addon}, which three does not have")
        })?;
        for import in imports(&text).filter(|import| import.starts_with('.')) {
            wanted.push(resolve(
                addon.rsplit_once('/').map_or("", |(folder, _)| folder),
                import,
            ));
        }
        copy(&addons.join(&addon), &to.join("addons").join(&addon))?;
        copied.push(addon);
    }
    Ok(())
}

/// Module names after `from` in a script.
fn imports(script: &str) -> impl Iterator<Item = &str> {
    script.split("from ").skip(1).filter_map(|rest| {
        let quote = rest.chars().next().filter(|c| matches!(c, '"' | '\''))?;
        rest[1..].split(quote).next()
    })
}

/// The page's policy allows exactly one inline script, its import map, by hash; the hash is filled in here.
fn with_import_map_hash(html: &str) -> Result<String> {
    const PLACEHOLDER: &str = "sha256-IMPORTMAP";
    const OPEN: &str = "<script type=\"importmap\">";
    let map = html
        .split_once(OPEN)
        .and_then(|(_, rest)| rest.split_once("</script>"))
        .map(|(map, _)| map)
        .context("www/index.html has no import map")?;
    if !html.contains(PLACEHOLDER) {
        bail!("www/index.html has no place for the import map's hash ({PLACEHOLDER})");
    }
    Ok(html.replace(
        PLACEHOLDER,
        &format!(
            "sha256-{}",
            BASE64_STANDARD.encode(Sha256::digest(map.as_bytes()))
        ),
    ))
}

/// A service worker needs to know what to keep for offline use: `files.json` lists everything with a content hash.
fn list_files(dir: &Path) -> Result<()> {
    let mut list = serde_json::Map::new();
    for name in files(dir)? {
        let hash = Sha256::digest(fs::read(dir.join(&name))?);
        list.insert(name, BASE64_STANDARD.encode(&hash[..12]).into());
    }
    paths::write(
        &dir.join("files.json"),
        serde_json::to_string_pretty(&list)?.as_bytes(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fills_the_import_map_hash() {
        let html = "<meta content=\"script-src 'sha256-IMPORTMAP'\"><script type=\"importmap\">{}</script>";
        let filled = with_import_map_hash(html).unwrap_or_default();
        // printf '{}' | openssl dgst -sha256 -binary | base64
        assert!(
            filled.contains("'sha256-RBNvo1WzZ4oRRq0W9+hknpT7T8If536DEMBg9hyq/4o='"),
            "{filled}"
        );
    }

    #[test]
    fn finds_imports_in_a_script() {
        let script = "import * as THREE from \"three\";\nimport {\n a\n} from '../lines/Line2.js';";
        assert_eq!(
            imports(script).collect::<Vec<_>>(),
            ["three", "../lines/Line2.js"]
        );
    }
}
