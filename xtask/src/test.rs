//! `cargo xtask test`: sets up what is missing, runs every tier, and closes with one line that sums them.

use crate::tally::Tally;
use crate::tiers;
use anyhow::{Result, bail};
use clap::ValueEnum;
use std::time::Instant;

/// Runs all tests: native, under Node, in Chromium, and the packed npm package.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct Args {
    /// Runs only these tiers.
    #[arg(long, value_enum, value_delimiter = ',')]
    only: Vec<Tier>,
    /// Fails GPU tests that find no adapter, instead of skipping them.
    #[arg(long)]
    require_gpu: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Tier {
    /// Format of the sources.
    Sources,
    /// Unit tests, examples in the documentation, and tests across modules.
    Native,
    /// The engine as wasm under Node.
    Node,
    /// The engine as wasm in headless Chromium.
    Browser,
    /// The packed npm package in an empty folder, its sizes and declarations, and the demo page.
    Package,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let chosen: Vec<Tier> = Tier::value_variants()
        .iter()
        .copied()
        .filter(|tier| args.only.is_empty() || args.only.contains(tier))
        .collect();
    let mut rows = Vec::new();
    let mut total = Tally::default();
    for tier in chosen {
        let start = Instant::now();
        println!("\n==== {} ====", name(tier));
        let tally = match tier {
            Tier::Sources => Ok(tiers::gates::sources()),
            Tier::Native => tiers::native::run(args.require_gpu),
            Tier::Node => tiers::node::run(),
            Tier::Browser => tiers::browser::run(),
            Tier::Package => package(),
        }
        .unwrap_or_else(|error| {
            println!("error: {error:#}");
            Tally::one(false)
        });
        total += tally;
        rows.push((name(tier), tally, start.elapsed().as_secs_f64()));
    }
    println!("\n==== summary ====");
    for (name, tally, seconds) in rows {
        println!("{name:<10} {:>5.1} min   {tally}", seconds / 60.0);
    }
    println!("{total}");
    if total.failed > 0 {
        bail!(
            "{} of {} tests failed",
            total.failed,
            total.passed + total.failed
        );
    }
    Ok(())
}

/// The gates first: without a package there is nothing to install.
fn package() -> Result<Tally> {
    let mut tally = tiers::gates::package();
    tally += tiers::package::run()?;
    Ok(tally)
}

fn name(tier: Tier) -> String {
    tier.to_possible_value()
        .map_or_else(String::new, |value| value.get_name().to_owned())
}
