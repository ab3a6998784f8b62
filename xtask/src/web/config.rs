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
    pub(super) builds: Vec<Build>,
    pub(super) wasm_opt: Vec<String>,
    /// WebAssembly proposals, by names that `binary` knows, that every binary may use; beside these only what it requires.
    pub(super) allowed: Vec<String>,
}

/// One wasm binary. Its size has a limit in `pkg-config/size-budget.json`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Build {
    /// What its files begin with.
    pub(super) out_name: String,
    /// Folder of the package that it lies in; empty for the package's own.
    pub(super) folder: String,
    /// The crate's features that it is built with, alone; empty for its usual ones.
    pub(super) features: Vec<String>,
    /// The build whose script it is loaded with; its own when left out.
    #[serde(default)]
    pub(super) glue_of: Option<String>,
    /// Flags of wasm-opt beside those of all.
    #[serde(default)]
    pub(super) wasm_opt: Vec<String>,
    /// Proposals that the binary must use: a build that lost its flags would still run, only slowly.
    pub(super) required: Vec<String>,
    /// The instructions of relaxed SIMD that it must use, and no others: processors differ in what they answer.
    #[serde(default)]
    pub(super) relaxed: Vec<String>,
}

impl Build {
    /// The name that its script has, which stands in the binary too.
    pub(super) fn glue(&self) -> &str {
        self.glue_of.as_deref().unwrap_or(&self.out_name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn every_build_has_a_size_budget() -> anyhow::Result<()> {
        let config: BuildConfig = crate::pins::json("pkg-config/build.json")?;
        let budget: BTreeMap<String, serde_json::Value> =
            crate::pins::json("pkg-config/size-budget.json")?;
        for Build {
            folder, out_name, ..
        } in config.builds
        {
            let slash = if folder.is_empty() { "" } else { "/" };
            let file = format!("{folder}{slash}{out_name}_bg.wasm");
            assert!(budget.contains_key(&file), "no limit for {file}");
        }
        Ok(())
    }
}
