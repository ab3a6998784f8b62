//! The kinds of test, one file each. Every tier runs to its end and counts; none stops the others.

pub(crate) mod browser;
pub(crate) mod gates;
pub(crate) mod native;
pub(crate) mod node;
pub(crate) mod package;

use crate::tally::{LibtestReader, Tally};
use crate::{paths, shell};
use anyhow::Result;
use std::collections::BTreeMap;
use std::fs;
use std::process::Command;

/// Runs `cargo test` in some form, and counts. Tests that skip themselves say so in a file, since their runner counts
/// them as passed.
///
/// # Errors
///
/// When cargo is missing or the file of skips cannot be kept.
fn cargo_test(command: &mut Command) -> Result<Tally> {
    let log = paths::target().join(format!("skipped-{}.tsv", std::process::id()));
    if log.exists() {
        fs::remove_file(&log)?;
    }
    command.env("LANDLINE_SKIP_LOG", &log);
    let mut reader = LibtestReader::default();
    let succeeded = shell::stream(command, |line| reader.line(line))?;
    let skips = fs::read_to_string(&log).unwrap_or_default();
    if log.exists() {
        fs::remove_file(&log)?;
    }
    let skips: BTreeMap<&str, &str> = skips
        .lines()
        .filter_map(|line| line.split_once('\t'))
        .collect();
    for (test, reason) in &skips {
        println!("skipped {test}: {reason}");
    }
    Ok(reader.finish(succeeded).with_skips(skips.len()))
}
