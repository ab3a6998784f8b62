//! `cargo xtask audit`: what is built in, against the rules of `deny.toml`.

use crate::metadata::{Metadata, Package, host};
use crate::{paths, pins, shell};
use anyhow::{Context as _, Result, bail};

/// Licences of every crate that is built in; advisories of cargo-deny and npm audit where they can be asked.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Only what needs no network and no further tool.
    #[arg(long)]
    offline: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    licences()?;
    println!("audit   licences: as deny.toml says");
    if args.offline {
        return Ok(());
    }
    let mut missing = Vec::new();
    match shell::run(shell::cargo().args(["deny", "--version"])) {
        Ok(()) => shell::run(shell::cargo().args(["deny", "check"]))?,
        Err(_) => missing.push("cargo-deny (`cargo install cargo-deny --locked`)"),
    }
    let npm = if cfg!(windows) { "npm.cmd" } else { "npm" };
    let mut npm = shell::command(npm);
    // Build and test tools only: the package itself depends on nothing.
    npm.args(["audit", "--audit-level=high"])
        .current_dir(paths::root().join("web"));
    if let Err(error) = shell::output(&mut npm) {
        // A registry without that service is no finding.
        let text = format!("{error:#}");
        if text.contains("severity") {
            return Err(error);
        }
        missing.push("npm audit (the registry did not answer)");
    }
    for what in missing {
        println!("audit   not asked: {what}");
    }
    Ok(())
}

/// Licences of all crates that this machine would build, against the list in `deny.toml`.
///
/// # Errors
///
/// When one is not allowed, or the crates cannot be listed.
pub(crate) fn licences() -> Result<()> {
    let metadata = Metadata::of_platform(&host()?)?;
    let rules = pins::text("deny.toml")?;
    let (allowed, clarified) = (allowed(&rules)?, clarified(&rules));
    let licence = |package: &Package| -> Option<String> {
        let id = format!("{}@{}", package.name, package.version);
        let said = clarified.iter().find(|(name, _)| *name == id);
        said.map(|(_, licence)| licence.clone())
            .or_else(|| package.license.clone())
    };
    let refused: Vec<String> = metadata
        .packages
        .iter()
        .filter(|package| package.source.is_some())
        .map(|package| (package, licence(package)))
        .filter(|(_, licence)| !is_allowed(licence.as_deref(), &allowed))
        .map(|(package, licence)| {
            let licence = licence.as_deref().unwrap_or("none said");
            format!("{} {}: {licence}", package.name, package.version)
        })
        .collect();
    if !refused.is_empty() {
        bail!(
            "licences that deny.toml does not allow:\n{}",
            refused.join("\n")
        );
    }
    Ok(())
}

/// The list `allow` of the section on licences.
fn allowed(rules: &str) -> Result<Vec<String>> {
    let (_, list) = rules
        .split_once("[licenses]")
        .and_then(|(_, rest)| rest.split_once("allow = ["))
        .context("deny.toml has no list of allowed licences")?;
    let list = list.split(']').next().unwrap_or_default();
    Ok(list
        .split('"')
        .skip(1)
        .step_by(2)
        .map(str::to_owned)
        .collect())
}

/// Crates whose manifest names no licence, with the one that their text was read to be.
fn clarified(rules: &str) -> Vec<(String, String)> {
    rules
        .split("[[licenses.clarify]]")
        .skip(1)
        .filter_map(|section| {
            Some((
                pins::quoted(section, "crate")?,
                pins::quoted(section, "expression")?,
            ))
        })
        .collect()
}

fn is_allowed(licence: Option<&str>, allowed: &[String]) -> bool {
    let parsed =
        licence.and_then(|text| spdx::Expression::parse_mode(text, spdx::ParseMode::LAX).ok());
    parsed.is_some_and(|licence| licence.evaluate(|one| allowed.contains(&one.to_string())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_licence_is_allowed_where_the_list_grants_it() {
        let rules = "[licenses]\nallow = [\n  \"MIT\",\n  \"Apache-2.0 WITH LLVM-exception\",\n]\n[bans]\ndeny = [\"GPL-3.0\"]";
        let allowed = allowed(rules).expect("has a list");
        assert_eq!(allowed, ["MIT", "Apache-2.0 WITH LLVM-exception"]);
        for (licence, may) in [
            ("MIT", true),
            ("MIT/Apache-2.0", true),
            ("GPL-3.0-only OR MIT", true),
            ("GPL-3.0-only AND MIT", false),
            ("Apache-2.0", false),
            ("Apache-2.0 WITH LLVM-exception", true),
            ("whatever", false),
        ] {
            assert_eq!(is_allowed(Some(licence), &allowed), may, "{licence}");
        }
        assert!(!is_allowed(None, &allowed));
        let rules = "[[licenses.clarify]]\ncrate = \"a@1.0.0\"\nexpression = \"MIT\"\n[bans]";
        assert_eq!(clarified(rules), [("a@1.0.0".to_owned(), "MIT".to_owned())]);
    }
}
