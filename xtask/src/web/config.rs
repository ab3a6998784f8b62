//! What the package is built of and with: `pkg-config/build.json`.

use serde::Deserialize;

/// `pkg-config/build.json`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BuildConfig {
    #[serde(rename = "crate")]
    pub(super) crate_name: String,
    pub(super) profile: String,
    pub(super) target: String,
    pub(super) rustflags: Vec<String>,
    pub(super) artefacts: Vec<Artefact>,
    pub(super) wasm_opt: Vec<String>,
    pub(super) proposals: Proposals,
}

/// One wasm binary with its glue.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Artefact {
    /// What its files begin with.
    pub(super) out_name: String,
    /// Folder of the package that it lies in; empty for the package's own.
    pub(super) folder: String,
    /// The crate's feature that it is built with, alone; empty for its usual ones.
    pub(super) feature: String,
}

/// Names of WebAssembly proposals, as `binary` knows them.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Proposals {
    /// The binary must use these: a build that lost its flags would still run, only slowly.
    pub(super) required: Vec<String>,
    /// The binary may use these, and nothing else.
    pub(super) allowed: Vec<String>,
}
