//! The packed npm package, installed in an empty folder and used by name, and the demo page in a browser: scripts of
//! `tests/package` under Node's test runner.

use crate::tally::{Tally, TapReader};
use crate::{paths, setup, shell, web};
use anyhow::{Context as _, Result, bail};

/// Runs the scripts on the package that the gates built.
pub(crate) fn run() -> Result<Tally> {
    let browser = setup::browser()?;
    let tarball = web::tarball()?;
    if !tarball.is_file() {
        bail!("{} was not built", tarball.display());
    }
    let folder = paths::root().join("tests/package");
    let mut scripts: Vec<_> = std::fs::read_dir(&folder)
        .with_context(|| format!("cannot list {}", folder.display()))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.to_string_lossy().ends_with(".test.mjs"))
        .collect();
    scripts.sort();
    let mut node = shell::command("node");
    // A page waits for its worker most of the time: two files at once keep two cores busy. Each has its own server,
    // browser and folder.
    node.args(["--test", "--test-reporter=tap", "--test-concurrency=2"])
        .args(scripts)
        .env("LANDLINE_TARBALL", tarball)
        .env("LANDLINE_SITE", paths::site())
        .env("CHROME", browser.chromium);
    let mut reader = TapReader::default();
    let succeeded = shell::stream(&mut node, |line| reader.line(line))?;
    Ok(reader.finish(succeeded))
}
