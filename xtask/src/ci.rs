//! `cargo xtask ci`: what a change must pass before it is worth a full test run.

use crate::tally::Tally;
use crate::tiers::gates::gate;
use crate::{setup, shell};
use anyhow::{Result, bail};
use std::time::Instant;

/// Format, clippy natively and for wasm, unit tests, layering; without `--quick` the whole test run follows.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Stops after the quick checks: under two minutes when warm.
    #[arg(long)]
    quick: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let start = Instant::now();
    setup::native_tools()?;
    let mut total = Tally::default();
    for (name, words) in STEPS {
        let start = Instant::now();
        total += gate(name, || shell::run(shell::cargo().args(*words)));
        println!("        {:.1} s", start.elapsed().as_secs_f64());
    }
    println!(
        "quick checks: {total} in {:.0} s",
        start.elapsed().as_secs_f64()
    );
    if total.failed > 0 {
        bail!("{} of the quick checks failed", total.failed);
    }
    if args.quick {
        Ok(())
    } else {
        crate::test::run(&crate::test::Args::default())
    }
}

const STEPS: &[(&str, &[&str])] = &[
    ("format", &["fmt", "--all", "--check"]),
    (
        "clippy, native",
        &[
            "clippy",
            "--quiet",
            "-p",
            "landline",
            "-p",
            "landline-testkit",
            "-p",
            "xtask",
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ],
    ),
    (
        "clippy, native tool without training",
        &[
            "clippy",
            "--quiet",
            "-p",
            "landline-mapper",
            "--no-default-features",
            "--",
            "-D",
            "warnings",
        ],
    ),
    (
        "clippy, wasm",
        &[
            "clippy",
            "--quiet",
            "-p",
            "landline",
            "-p",
            "landline-web",
            "--target",
            "wasm32-unknown-unknown",
            "--",
            "-D",
            "warnings",
        ],
    ),
    (
        "unit tests",
        &[
            "test", "--quiet", "-p", "landline", "-p", "xtask", "--lib", "--bins",
        ],
    ),
    (
        "layers and folders",
        &[
            "test", "--quiet", "-p", "landline", "--test", "native", "--", "layering", "docs",
        ],
    ),
];
