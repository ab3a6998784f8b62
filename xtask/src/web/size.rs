//! `cargo xtask size`: what a browser has to load, raw and compressed, against the budget.

use crate::files::files;
use crate::{paths, pins, shell};
use anyhow::{Context as _, Result, bail};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Prints the package's sizes and holds them against `pkg-config/size-budget.json`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Size {
    raw: u64,
    gzip: u64,
    brotli: u64,
}

impl Size {
    fn parts(self) -> [(&'static str, u64); 3] {
        [
            ("raw", self.raw),
            ("gzip", self.gzip),
            ("brotli", self.brotli),
        ]
    }
}

pub(crate) fn run(_args: &Args) -> Result<()> {
    let budget: BTreeMap<String, Size> = pins::json("pkg-config/size-budget.json")?;
    if !paths::package().join("package.json").is_file() {
        bail!("the package is not built: run `cargo xtask web` first");
    }
    let sizes = measure(&files(&paths::package())?)?;
    println!(
        "{:<20} {:>10} {:>10} {:>10} {:>10}",
        "bytes", "raw", "gzip", "brotli", "budget"
    );
    let mut over = Vec::new();
    let names: Vec<&str> = budget.keys().map(String::as_str).collect();
    for (name, limit) in &budget {
        let size = total(name, &names, &sizes)
            .with_context(|| format!("size-budget.json names {name}, not in the package"))?;
        let share = size
            .parts()
            .iter()
            .zip(limit.parts())
            .map(|(a, b)| 100 * a.1 / b.1.max(1))
            .max()
            .unwrap_or(0);
        println!(
            "{name:<20} {:>10} {:>10} {:>10} {share:>9}%",
            size.raw, size.gzip, size.brotli
        );
        over.extend(excess(name, size, *limit));
    }
    if over.is_empty() {
        return Ok(());
    }
    bail!(
        "over the size budget: {}; make it smaller, or raise pkg-config/size-budget.json with the reason",
        over.join(", ")
    )
}

fn excess(name: &str, size: Size, limit: Size) -> Vec<String> {
    size.parts()
        .iter()
        .zip(limit.parts())
        .filter(|(is, may)| is.1 > may.1)
        .map(|(is, may)| format!("{name} {} {} > {}", is.0, is.1, may.1))
        .collect()
}

/// One file, or all files of a folder with an ending (`*.js`, `mapper/*.js`) for which the budget has no better name.
fn total(name: &str, names: &[&str], sizes: &BTreeMap<String, Size>) -> Option<Size> {
    let best = |file: &str| {
        let fitting = names.iter().filter(|name| fits(name, file));
        fitting.max_by_key(|name| name.len()).copied()
    };
    sizes
        .iter()
        .filter(|(file, _)| best(file) == Some(name))
        .map(|(_, size)| *size)
        .reduce(|a, b| Size {
            raw: a.raw + b.raw,
            gzip: a.gzip + b.gzip,
            brotli: a.brotli + b.brotli,
        })
}

fn fits(name: &str, file: &str) -> bool {
    match name.split_once('*') {
        None => name == file,
        Some((folder, ending)) => file.starts_with(folder) && file.ends_with(ending),
    }
}

/// Compresses with Node's zlib at the strongest setting, as a static host does.
fn measure(files: &[String]) -> Result<BTreeMap<String, Size>> {
    const SCRIPT: &str = "const fs=require('fs'),z=require('zlib'),o={};\
        for(const f of process.argv.slice(1)){const b=fs.readFileSync(f);\
        o[f]={raw:b.length,gzip:z.gzipSync(b,{level:9}).length,brotli:z.brotliCompressSync(b).length}}\
        console.log(JSON.stringify(o))";
    let code = files
        .iter()
        .filter(|name| name.ends_with(".js") || name.ends_with(".wasm"));
    let mut node = shell::command("node");
    node.args(["-e", SCRIPT, "--"])
        .args(code)
        .current_dir(paths::package());
    Ok(serde_json::from_str(&shell::output(&mut node)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_each_limit_that_is_broken() {
        let limit = Size {
            raw: 10,
            gzip: 5,
            brotli: 4,
        };
        assert_eq!(
            excess(
                "a",
                Size {
                    raw: 10,
                    gzip: 5,
                    brotli: 4
                },
                limit
            ),
            Vec::<String>::new()
        );
        assert_eq!(
            excess(
                "a",
                Size {
                    raw: 11,
                    gzip: 5,
                    brotli: 5
                },
                limit
            ),
            ["a raw 11 > 10", "a brotli 5 > 4"]
        );
    }

    #[test]
    fn sums_files_by_ending() {
        let size = Size {
            raw: 2,
            gzip: 1,
            brotli: 1,
        };
        let sizes = BTreeMap::from([
            ("a.js".to_owned(), size),
            ("b.js".to_owned(), size),
            ("mapper/a.js".to_owned(), size),
            ("c.wasm".to_owned(), size),
        ]);
        let names = ["*.js", "mapper/*.js"];
        let raw = |name| total(name, &names, &sizes).map(|size| size.raw);
        assert_eq!(raw("*.js"), Some(4), "the folder has a budget of its own");
        assert_eq!(raw("mapper/*.js"), Some(2));
        assert_eq!(raw("d.js"), None);
    }
}
