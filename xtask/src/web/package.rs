//! The npm package's folder and its tarball.

use super::config::BuildConfig;
use crate::files::{copy, copy_tree, files};
use crate::setup::{Weights, native_tool, node_tool};
use crate::{paths, pins, shell};
use anyhow::{Context as _, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};

/// Compiles `web/ts` to JavaScript and declarations; returns their folder.
pub(super) fn compile_scripts() -> Result<PathBuf> {
    println!("web     tsc");
    let out = paths::root().join("target/web/ts");
    if out.exists() {
        fs::remove_dir_all(&out)?;
    }
    shell::output(
        node_tool("typescript/bin/tsc").args(["--project", "pkg-config/tsconfig.package.json"]),
    )?;
    Ok(out)
}

/// Fills `dist/npm/landline`, in one rename.
pub(super) fn assemble(config: &BuildConfig, scripts: &Path, weights: &Weights) -> Result<()> {
    println!("web     package folder");
    let root = paths::root();
    let finished = paths::package();
    let scratch = finished.with_file_name(".landline.tmp");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    fs::create_dir_all(&scratch)?;
    copy_tree(scripts, &scratch)?;
    for build in &config.builds {
        let (from, to) = (super::folder(build), scratch.join(&build.folder));
        let endings: &[&str] = match build.glue_of {
            None => &[".js", ".d.ts", "_bg.wasm"],
            Some(_) => &["_bg.wasm"],
        };
        for ending in endings {
            let own = format!("{}{ending}", build.glue());
            let name = format!("{}{ending}", build.out_name);
            copy(&from.join(own), &to.join(name))?;
        }
    }
    super::comments::strip(&scratch)?;
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        copy(&root.join(name), &scratch.join(name))?;
    }
    copy(
        &root.join("pkg-config/README.npm.md"),
        &scratch.join("README.md"),
    )?;
    convert_weights(weights, &scratch.join("xfeat.safetensors"))?;
    copy(&weights.notice, &scratch.join("XFEAT-LICENSE"))?;
    // For the entry `landline/sample`.
    let sample = root.join("www/scenes/sample");
    for (from, to) in SAMPLE {
        copy(&sample.join(from), &scratch.join("sample").join(to))?;
    }
    let manifest = manifest(
        &pins::text("pkg-config/package.template.json")?,
        &version()?,
        &workspace_value("repository")?,
        &files(&scratch)?,
    )?;
    paths::write(&scratch.join("package.json"), manifest.as_bytes())?;
    paths::replace_dir(&scratch, &finished)
}

/// Files of the demo's sample and their names in the package.
const SAMPLE: [(&str, &str); 2] = [
    ("sample.landline", "sample.landline"),
    ("query-03.jpg", "picture.jpg"),
];

/// Has the native tool convert the checkpoint.
fn convert_weights(weights: &Weights, to: &Path) -> Result<()> {
    println!("web     extractor weights");
    let tool = native_tool()?;
    let mut convert = shell::command(tool);
    convert
        .args(["convert", "--extractor", "xfeat"])
        .arg(&weights.checkpoint)
        .arg(to)
        .args(["--precision", "int8", "--licence", "Apache-2.0", "--source"])
        .arg(&weights.source);
    shell::output(&mut convert)
        .context("cannot convert the extractor's weights")
        .map(drop)
}

/// Packs the folder as npm would publish it; returns the tarball.
pub(super) fn pack() -> Result<PathBuf> {
    let dir = paths::root().join("dist/npm");
    let npm = if cfg!(windows) { "npm.cmd" } else { "npm" };
    let mut pack = shell::command(npm);
    pack.args(["pack", "--silent", "--pack-destination"])
        .arg(&dir)
        .current_dir(paths::package());
    let name = shell::output(&mut pack)?;
    let tarball = dir.join(name.trim());
    if !tarball.is_file() {
        bail!(
            "npm pack said {:?} and left no such file in {}",
            name.trim(),
            dir.display()
        );
    }
    Ok(tarball)
}

/// The tarball of the last build.
pub(crate) fn tarball() -> Result<PathBuf> {
    Ok(paths::root().join(format!("dist/npm/landline-{}.tgz", version()?)))
}

/// The workspace's version, which is the package's too.
fn version() -> Result<String> {
    workspace_value("version")
}

/// What `Cargo.toml` says of all crates.
pub(crate) fn workspace_value(key: &str) -> Result<String> {
    pins::text("Cargo.toml")?
        .lines()
        .find_map(|line| line.strip_prefix(&format!("{key} = \"")))
        .map(|rest| rest.trim_end_matches('"').to_owned())
        .with_context(|| format!("Cargo.toml has no {key} of the workspace"))
}

/// Fills the template in. The file list names every file, so that a stray one in the folder is never published.
fn manifest(template: &str, version: &str, repository: &str, files: &[String]) -> Result<String> {
    let text = template
        .replace("{{name}}", "landline")
        .replace("{{version}}", version)
        .replace("{{repository}}", repository);
    let list = serde_json::to_string(files)?;
    let filled = text.replace("\"files\": []", &format!("\"files\": {list}"));
    if filled == text || filled.contains("{{") {
        bail!(
            "package.template.json lacks the empty file list, or has a placeholder that nothing fills"
        );
    }
    let _: serde_json::Value =
        serde_json::from_str(&filled).context("package.template.json is not JSON when filled")?;
    Ok(filled)
}

#[cfg(test)]
mod tests {
    use super::manifest;

    #[test]
    fn fills_the_template() {
        let template = r#"{ "name": "{{name}}", "version": "{{version}}", "homepage": "{{repository}}", "files": [] }"#;
        let filled =
            manifest(template, "1.2.3", "https://a/b", &["a.js".to_owned()]).unwrap_or_default();
        assert_eq!(
            filled,
            r#"{ "name": "landline", "version": "1.2.3", "homepage": "https://a/b", "files": ["a.js"] }"#
        );
    }

    #[test]
    fn refuses_an_unfilled_placeholder() {
        assert!(
            manifest(r#"{ "x": "{{licence}}", "files": [] }"#, "1.2.3", "", &[]).is_err(),
            "unknown placeholder"
        );
    }
}
