//! The browser for tests and the software GPU driver.

use super::{already, apt, step};
use crate::shell;
use anyhow::{Context as _, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// A Chromium and its driver.
#[derive(Debug)]
pub(crate) struct Browser {
    pub(crate) chromium: PathBuf,
    pub(crate) driver: PathBuf,
}

fn look() -> (Option<PathBuf>, Option<PathBuf>) {
    let named = |variable: &str| {
        std::env::var_os(variable)
            .map(PathBuf::from)
            .filter(|path| path.is_file())
    };
    let on_path = |names: &[&str]| names.iter().find_map(|name| shell::find(name));
    (
        named("CHROME")
            .or_else(|| on_path(&["chromium", "chromium-browser", "google-chrome", "chrome"])),
        named("CHROMEDRIVER").or_else(|| on_path(&["chromedriver"])),
    )
}

/// Chromium, if it is on this machine.
pub(crate) fn installed_chromium() -> Option<PathBuf> {
    look().0
}

/// Finds Chromium and its driver, or has apt install them.
pub(super) fn install() -> Result<Browser> {
    let name = "Chromium";
    if let (Some(chromium), Some(driver)) = look() {
        already(name, chromium.display());
        return Ok(Browser { chromium, driver });
    }
    let advice = "the browser tests need Chromium and its driver: install both, or name them in CHROME and \
                  CHROMEDRIVER, or leave these tests out with `cargo xtask test --only native,node`";
    step(name, "apt installs chromium and chromium-driver", || {
        apt::install(&["chromium", "chromium-driver"]).context(advice)?;
        let (chromium, driver) = look();
        Ok(Browser {
            chromium: chromium
                .context("apt installed chromium, and it is still not on PATH")
                .context(advice)?,
            driver: driver
                .context("apt installed chromium-driver, and it is still not on PATH")
                .context(advice)?,
        })
    })
}

/// Installs a software Vulkan driver where no driver of any kind is.
pub(super) fn vulkan_driver() {
    let name = "Vulkan driver";
    let has_driver = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d"]
        .iter()
        .any(|dir| fs::read_dir(Path::new(dir)).is_ok_and(|mut entries| entries.next().is_some()));
    if !cfg!(target_os = "linux") {
        return;
    }
    if has_driver
        || std::env::var_os("VK_ICD_FILENAMES").is_some()
        || std::env::var_os("VK_DRIVER_FILES").is_some()
    {
        already(name, "one is here");
        return;
    }
    let result = step(name, "apt installs mesa-vulkan-drivers", || {
        apt::install(&["mesa-vulkan-drivers"])
    });
    if let Err(error) = result {
        println!("set-up  {name}: none, so GPU tests will be skipped ({error:#})");
    }
}
