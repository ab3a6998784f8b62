//! The wasm binary: cargo, wasm-bindgen, wasm-opt.

use super::config::{Build, BuildConfig};
use crate::files::files;
use crate::setup::{WebTools, hex, node_tool};
use crate::{paths, shell};
use anyhow::{Context as _, Result, bail};
use sha2::{Digest as _, Sha256};
use std::fs;
use std::path::{Path, PathBuf};

/// Has cargo build the binary; returns where it was put, since the next build's has the same name for cargo.
pub(super) fn compile(config: &BuildConfig, build: &Build) -> Result<PathBuf> {
    println!(
        "web     cargo builds {} for {} ({}, profile {})",
        config.crate_name, build.out_name, config.target, config.profile
    );
    let mut flags = config.rustflags.clone();
    // Panic messages carry source paths; these say nothing of the machine that built them.
    for (from, to) in private_paths() {
        flags.push(format!("--remap-path-prefix={from}={to}"));
    }
    let mut cargo = shell::cargo();
    // Composed here, whatever the environment says: flags set outside would replace ours and lose simd128.
    cargo
        .args([
            "build",
            "--package",
            &config.crate_name,
            "--lib",
            "--profile",
            &config.profile,
        ])
        .args(["--target", &config.target]);
    if !build.features.is_empty() {
        cargo.args(["--no-default-features", "--features"]);
        cargo.arg(build.features.join(","));
    }
    cargo
        .env_remove("RUSTFLAGS")
        .env("CARGO_ENCODED_RUSTFLAGS", flags.join("\u{1f}"));
    shell::run(&mut cargo)?;
    let folder = paths::target().join(&config.target).join(&config.profile);
    let built = folder.join(format!("{}.wasm", config.crate_name.replace('-', "_")));
    let raw = folder.join(format!("{}.raw.wasm", build.out_name));
    fs::copy(&built, &raw).with_context(|| format!("cargo left no {}", built.display()))?;
    Ok(raw)
}

/// Binds and optimises what cargo built into a folder and returns its path; the glue lies beside it.
pub(super) fn finish(
    config: &BuildConfig,
    build: &Build,
    tools: &WebTools,
    raw: &Path,
    dir: &Path,
) -> Result<PathBuf> {
    let name = &build.out_name;
    let file = format!("{}_bg.wasm", build.glue());
    let out = dir.join(&file);
    let flags: Vec<&String> = config.wasm_opt.iter().chain(&build.wasm_opt).collect();
    let key = key(&flags, tools, raw)?;
    let stamp = dir.join("built-from");
    if out.is_file() && fs::read_to_string(&stamp).is_ok_and(|text| text == key) {
        println!("web     {name}: wasm-bindgen, wasm-opt: up to date");
        return Ok(out);
    }

    // A stamp of an older binary must not outlive it.
    if stamp.exists() {
        fs::remove_file(&stamp)?;
    }
    println!("web     {name}: wasm-bindgen");
    let scratch = dir.with_extension("tmp");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    let mut bindgen = shell::command(&tools.wasm_bindgen.cli);
    bindgen
        .args([
            "--target",
            "web",
            "--remove-producers-section",
            "--out-name",
            build.glue(),
            "--out-dir",
        ])
        .arg(&scratch)
        .arg(raw);
    shell::run(&mut bindgen)?;

    println!(
        "web     {name}: wasm-opt {}",
        config.wasm_opt.first().map_or("", String::as_str)
    );
    let bound = scratch.join(&file);
    let optimized = scratch.join("optimized.wasm");
    let mut wasm_opt = node_tool("binaryen/bin/wasm-opt");
    wasm_opt.args(&flags).arg(&bound).arg("-o").arg(&optimized);
    shell::output(&mut wasm_opt)?;
    fs::rename(&optimized, &bound).context("wasm-opt left no output")?;
    paths::write(&scratch.join("built-from"), key.as_bytes())?;
    fs::create_dir_all(dir)?;
    // File by file: the folder of one artefact may hold that of another. The stamp comes last.
    for name in files(&scratch)?.iter().filter(|name| *name != "built-from") {
        fs::rename(scratch.join(name), dir.join(name))?;
    }
    fs::rename(scratch.join("built-from"), &stamp)?;
    fs::remove_dir_all(&scratch)?;
    no_private_paths(&fs::read(&out)?)?;
    Ok(out)
}

/// Hash of everything the two tools' output depends on.
fn key(wasm_opt: &[&String], tools: &WebTools, raw: &Path) -> Result<String> {
    let mut hash = Sha256::new();
    hash.update(fs::read(raw).with_context(|| format!("cargo left no {}", raw.display()))?);
    for flag in wasm_opt {
        hash.update(flag);
        hash.update("\n");
    }
    hash.update(&tools.node.lock_hash);
    hash.update(tools.wasm_bindgen.cli.to_string_lossy().as_bytes());
    Ok(hex(&hash.finalize()))
}

/// Folders of this machine that source paths in a binary begin with, and what stands for them.
fn private_paths() -> Vec<(String, &'static str)> {
    let mut paths = vec![(paths::root().display().to_string(), "landline")];
    let cargo_home = std::env::var_os("CARGO_HOME")
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo")));
    if let Some(home) = cargo_home {
        paths.push((home.display().to_string(), "cargo"));
    }
    paths
}

/// The binary must not tell where it was built.
fn no_private_paths(wasm: &[u8]) -> Result<()> {
    for (path, _) in private_paths() {
        if wasm
            .windows(path.len())
            .any(|window| window == path.as_bytes())
        {
            bail!("the wasm binary contains the path {path}: a source path escaped the remapping");
        }
    }
    Ok(())
}
