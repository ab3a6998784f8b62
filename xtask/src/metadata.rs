//! What cargo says of the crates that are built.

use crate::shell;
use anyhow::Result;
use serde::Deserialize;

/// `cargo metadata`, as far as it is read here.
#[derive(Debug, Deserialize)]
pub(crate) struct Metadata {
    pub(crate) packages: Vec<Package>,
    pub(crate) resolve: Resolve,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Package {
    pub(crate) id: String,
    pub(crate) name: String,
    pub(crate) version: String,
    pub(crate) license: Option<String>,
    pub(crate) description: Option<String>,
    /// `None` for those of this workspace.
    pub(crate) source: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Resolve {
    pub(crate) nodes: Vec<Node>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Node {
    pub(crate) id: String,
    pub(crate) deps: Vec<Dependency>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Dependency {
    pub(crate) pkg: String,
    dep_kinds: Vec<DependencyKind>,
}

#[derive(Debug, Deserialize)]
struct DependencyKind {
    /// `None` for what is built in, else `build` or `dev`.
    kind: Option<String>,
}

impl Dependency {
    /// Whether it is built in or builds, and is not of the tests alone.
    pub(crate) fn ships(&self) -> bool {
        self.dep_kinds
            .iter()
            .any(|k| k.kind.as_deref() != Some("dev"))
    }
}

impl Metadata {
    /// Of all crates of the workspace as they are locked, built for a platform.
    ///
    /// # Errors
    ///
    /// When cargo cannot list them.
    pub(crate) fn of_platform(platform: &str) -> Result<Self> {
        let mut cargo = shell::cargo();
        cargo.args(["metadata", "--locked", "--format-version", "1"]);
        cargo.args(["--filter-platform", platform]);
        Ok(serde_json::from_str(&shell::output(&mut cargo)?)?)
    }
}

/// This machine's platform.
pub(crate) fn host() -> Result<String> {
    let told = shell::output(shell::command("rustc").args(["--print", "host-tuple"]))?;
    Ok(told.trim().to_owned())
}
