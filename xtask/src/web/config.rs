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
    pub(super) out_name: String,
    pub(super) wasm_opt: Vec<String>,
    pub(super) proposals: Proposals,
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
