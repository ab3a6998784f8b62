//! `cargo xtask sbom`: what the shipped artefacts are made of, as CycloneDX.

use crate::metadata::{Metadata, Node, Package, host};
use crate::{paths, pins};
use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Writes a bill of materials (CycloneDX 1.5, JSON) of the npm package and of the native tool: every crate that is built in or
/// builds, with version, licence and the registry's SHA-256, and who depends on whom. The same checkout gives the same files.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the files; `target/sbom` when not given.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// What ships: file, crate at its root, platform (this machine's where none is named).
const SHIPPED: [(&str, &str, Option<&str>); 2] = [
    (
        "landline-npm",
        "landline-web",
        Some("wasm32-unknown-unknown"),
    ),
    ("landline-tool", "landline-mapper", None),
];

pub(crate) fn run(args: &Args) -> Result<()> {
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| paths::target().join("sbom"));
    let host = host()?;
    let checksums = checksums(&pins::text("Cargo.lock")?);
    for (file, root, platform) in SHIPPED {
        let platform = platform.unwrap_or(&host);
        let metadata = Metadata::of_platform(platform)?;
        let bill = bill(&metadata, root, &checksums)?;
        let path = out.join(format!("{file}.cdx.json"));
        paths::write(&path, serde_json::to_string_pretty(&bill)?.as_bytes())?;
        let count = bill["components"].as_array().map_or(0, Vec::len);
        println!(
            "sbom    {}: {count} components for {platform}",
            path.display()
        );
    }
    Ok(())
}

/// SHA-256 of the registry's archives by name and version, from `Cargo.lock`.
fn checksums(lock: &str) -> BTreeMap<(String, String), String> {
    lock.split("[[package]]")
        .filter_map(|section| {
            let of = (
                pins::quoted(section, "name")?,
                pins::quoted(section, "version")?,
            );
            Some((of, pins::quoted(section, "checksum")?))
        })
        .collect()
}

/// The bill of one crate: what it reaches without dependencies of tests.
fn bill(
    metadata: &Metadata,
    root: &str,
    checksums: &BTreeMap<(String, String), String>,
) -> Result<Value> {
    let packages: BTreeMap<&str, &Package> = metadata
        .packages
        .iter()
        .map(|p| (p.id.as_str(), p))
        .collect();
    let nodes: BTreeMap<&str, &Node> = metadata
        .resolve
        .nodes
        .iter()
        .map(|n| (n.id.as_str(), n))
        .collect();
    let own = |p: &&Package| p.name == root && p.source.is_none();
    let start = metadata.packages.iter().find(own);
    let start = start.with_context(|| format!("cargo metadata has no crate {root}"))?;
    let shipped = |id: &str| -> BTreeSet<&str> {
        let node = nodes.get(id);
        let deps = node.into_iter().flat_map(|n| &n.deps);
        deps.filter(|d| d.ships()).map(|d| d.pkg.as_str()).collect()
    };
    let mut reached = BTreeSet::from([start.id.as_str()]);
    let mut open = vec![start.id.as_str()];
    while let Some(id) = open.pop() {
        open.extend(shipped(id).into_iter().filter(|dep| reached.insert(*dep)));
    }
    let purl = |p: &Package| format!("pkg:cargo/{}@{}", p.name, p.version);
    let purl_of = |id: &str| packages.get(id).map(|p| purl(p));
    let component = |p: &Package| {
        let mut component = json!({
            "type": "library",
            "bom-ref": purl(p),
            "name": p.name,
            "version": p.version,
            "purl": purl(p),
        });
        if let Some(text) = &p.description {
            component["description"] = json!(text.trim());
        }
        if let Some(licence) = &p.license {
            // Older manifests separate alternatives by a slash.
            component["licenses"] = json!([{ "expression": licence.replace('/', " OR ") }]);
        }
        if let Some(sum) = checksums.get(&(p.name.clone(), p.version.clone())) {
            component["hashes"] = json!([{ "alg": "SHA-256", "content": sum }]);
        }
        component
    };
    let others = reached.iter().filter(|id| **id != start.id);
    let mut components: Vec<Value> = others
        .filter_map(|id| packages.get(id))
        .map(|p| component(p))
        .collect();
    components.sort_by(|a, b| a["bom-ref"].as_str().cmp(&b["bom-ref"].as_str()));
    let mut dependencies: Vec<Value> = reached
        .iter()
        .filter_map(|id| {
            let on: BTreeSet<String> = shipped(id).into_iter().filter_map(purl_of).collect();
            Some(json!({ "ref": purl_of(id)?, "dependsOn": on }))
        })
        .collect();
    dependencies.sort_by(|a, b| a["ref"].as_str().cmp(&b["ref"].as_str()));
    let mut product = component(start);
    product["type"] = json!("application");
    Ok(json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": { "component": product },
        "components": components,
        "dependencies": dependencies,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bill_has_what_ships_and_nothing_of_the_tests() {
        let package = |name: &str, licence: &str, source: Option<&str>| json!({ "id": name, "name": name, "version": "1.2.3", "license": licence, "source": source });
        let dep = |name: &str, kind: Option<&str>| json!({ "pkg": name, "dep_kinds": [{ "kind": kind }] });
        let metadata = json!({
            "packages": [
                package("app", "MIT", None),
                package("used", "MIT/Apache-2.0", Some("registry")),
                package("below", "Zlib", Some("registry")),
                package("builder", "MIT", Some("registry")),
                package("tester", "MIT", Some("registry")),
                package("other", "MIT", Some("registry")),
            ],
            "resolve": { "nodes": [
                { "id": "app", "deps": [dep("used", None), dep("builder", Some("build")), dep("tester", Some("dev"))] },
                { "id": "used", "deps": [dep("below", None)] },
                { "id": "below", "deps": [] },
                { "id": "builder", "deps": [dep("below", None)] },
                { "id": "tester", "deps": [dep("other", None)] },
                { "id": "other", "deps": [] },
            ] },
        });
        let metadata: Metadata = serde_json::from_value(metadata).expect("as cargo writes it");
        let lock = "version = 4\n\n[[package]]\nname = \"used\"\nversion = \"1.2.3\"\nsource = \"registry\"\nchecksum = \"abcd\"\n";
        let bill = bill(&metadata, "app", &checksums(lock)).expect("app is there");
        let names: Vec<_> = bill["components"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|c| c["name"].as_str().expect("a name"))
            .collect();
        assert_eq!(names, ["below", "builder", "used"]);
        let used = &bill["components"][2];
        assert_eq!(used["purl"], "pkg:cargo/used@1.2.3");
        assert_eq!(used["licenses"][0]["expression"], "MIT OR Apache-2.0");
        assert_eq!(used["hashes"][0]["content"], "abcd");
        assert_eq!(bill["dependencies"][0]["ref"], "pkg:cargo/app@1.2.3");
        assert_eq!(
            bill["dependencies"][0]["dependsOn"],
            json!(["pkg:cargo/builder@1.2.3", "pkg:cargo/used@1.2.3"])
        );
        assert!(super::bill(&metadata, "nobody", &BTreeMap::new()).is_err());
    }
}
