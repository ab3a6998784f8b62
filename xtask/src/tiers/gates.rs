//! What must hold of the sources and of the built package, each counted as one test: the format, the instruction sets
//! (checked by the build), the sizes, the declarations.

use crate::tally::Tally;
use crate::{shell, web};
use anyhow::Result;

/// The sources.
pub(crate) fn sources() -> Tally {
    gate("format", || {
        shell::run(shell::cargo().args(["fmt", "--all", "--check"]))
    }) + gate("licences are those of deny.toml", crate::audit::licences)
}

/// The npm package: builds it and holds it against `pkg-config/`.
pub(crate) fn package() -> Tally {
    let mut tally = gate(
        "npm package builds, its instruction sets are the declared ones",
        web::build,
    );
    if tally.failed == 0 {
        tally += gate("sizes are within the budget", || {
            web::size::run(&web::size::Args {})
        });
        tally += gate("public declarations are those of the snapshot", || {
            web::api::run(&web::api::Args::default())
        });
    }
    tally
}

/// Runs a check, says how it went, and counts it.
pub(crate) fn gate(name: &str, check: impl FnOnce() -> Result<()>) -> Tally {
    let result = check();
    match &result {
        Ok(()) => println!("gate    {name}: ok"),
        Err(error) => println!("gate    {name}: FAILED\n{error:#}"),
    }
    Tally::one(result.is_ok())
}
