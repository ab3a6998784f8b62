//! `cargo xtask bench`: the speed measurements, each beside its peer.

use crate::shell;
use anyhow::Result;

/// Runs the benchmarks of `benches/`; what follows `--` goes to them.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// One benchmark; all when left out.
    name: Option<String>,
    /// Passed on.
    #[arg(last = true)]
    rest: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let mut cargo = shell::cargo();
    cargo.args(["bench", "-p", "landline"]);
    if let Some(name) = &args.name {
        cargo.args(["--bench", name]);
    }
    shell::run(cargo.arg("--").args(&args.rest))
}
