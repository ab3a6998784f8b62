//! Debian's and Ubuntu's packages.

use crate::shell;
use anyhow::{Context as _, Result, bail};
use std::process::Command;

/// Installs packages where this machine has apt and this user may use it.
///
/// # Errors
///
/// When there is no apt, no right to use it, or it fails.
pub(super) fn install(packages: &[&str]) -> Result<()> {
    let list = packages.join(" ");
    if shell::find("apt-get").is_none() {
        bail!("this system has no apt-get: install {list} (or its equivalent) by hand");
    }
    let Some(prefix) = privilege() else {
        bail!(
            "no right to install packages: run `sudo apt-get install {list}`, then run this command again"
        );
    };
    let apt = |words: &[&str]| -> Command {
        let mut all = prefix.to_vec();
        all.extend(["apt-get", "-q", "-o", "DPkg::Lock::Timeout=300"]);
        all.extend(words);
        let mut command = shell::command(all[0]);
        command
            .args(&all[1..])
            .env("DEBIAN_FRONTEND", "noninteractive");
        command
    };
    // An old package list names files that are gone, so it is renewed first. A refusal here is only a hint: the
    // installation may still work from the present list.
    if let Err(error) = shell::output(&mut apt(&["update"])) {
        println!(
            "        the package list could not be renewed ({error:#}); trying with the present one"
        );
    }
    let mut words = vec!["install", "-y", "--no-install-recommends"];
    words.extend(packages);
    shell::output(&mut apt(&words))
        .with_context(|| {
            format!("apt could not install {list}; this step needs the system's package registry")
        })
        .map(drop)
}

/// How to become root without a question: nothing for root, `sudo -n` where that works.
fn privilege() -> Option<&'static [&'static str]> {
    let user = shell::output(shell::command("id").arg("-u")).ok()?;
    if user.trim() == "0" {
        return Some(&[]);
    }
    shell::find("sudo")?;
    let may = shell::output(shell::command("sudo").args(["-n", "true"])).is_ok();
    may.then_some(&["sudo", "-n"])
}
