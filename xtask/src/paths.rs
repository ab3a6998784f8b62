//! Folders: the checkout, what is built in it, and the cache that outlives it.

use anyhow::{Context as _, Result, bail};
use std::env;
use std::fs;
use std::path::{Path, PathBuf};

/// Root of the checkout. Cargo tells at run time where it is, so a moved checkout works without a rebuild.
pub(crate) fn root() -> PathBuf {
    let xtask = env::var_os("CARGO_MANIFEST_DIR")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    xtask
        .parent()
        .map_or_else(|| PathBuf::from("."), Path::to_path_buf)
}

/// Cargo's build folder.
pub(crate) fn target() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |dir| root().join(dir))
}

/// The unpacked npm package, as it is packed.
pub(crate) fn package() -> PathBuf {
    root().join("dist/npm/landline")
}

/// The demo page as it is served.
pub(crate) fn site() -> PathBuf {
    root().join("dist/site")
}

/// Where the generated glue is; `web/tsconfig.json` names this folder too.
pub(crate) fn bindgen() -> PathBuf {
    root().join("target/web/bindgen")
}

/// Downloads and tools that several checkouts of one user share: `$LANDLINE_CACHE`, else `landline` in the user's
/// cache folder. Everything in it has its version in its name and was renamed into place when complete.
pub(crate) fn cache() -> PathBuf {
    if let Some(dir) = env::var_os("LANDLINE_CACHE") {
        return root().join(dir);
    }
    if let Some(dir) = env::var_os("XDG_CACHE_HOME") {
        return PathBuf::from(dir).join("landline");
    }
    match env::var_os("HOME").or_else(|| env::var_os("USERPROFILE")) {
        Some(home) => PathBuf::from(home).join(".cache/landline"),
        None => target().join("cache"),
    }
}

/// A new empty folder inside the cache for something half done, to be renamed when it is whole. Left-overs of an
/// interrupted run under the same name are removed.
///
/// # Errors
///
/// When the cache folder cannot be written.
pub(crate) fn cache_scratch(name: &str) -> Result<Scratch> {
    let dir = cache().join(format!(".{name}.{}.tmp", std::process::id()));
    let advice = || {
        format!(
            "cannot write in the cache folder {}: make it writable, or set LANDLINE_CACHE to a folder that is",
            cache().display()
        )
    };
    fs::create_dir_all(cache()).with_context(advice)?;
    sweep(&format!(".{name}."));
    fs::create_dir_all(&dir).with_context(advice)?;
    Ok(Scratch(dir))
}

/// A folder for something half done; what is still in it at the end goes with it.
#[derive(Debug)]
pub(crate) struct Scratch(PathBuf);

impl std::ops::Deref for Scratch {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What cannot be removed is swept by a later run.
        drop(fs::remove_dir_all(&self.0));
    }
}

/// Removes what an interrupted run left behind. Another run may be at work on its own scratch folder at this moment,
/// so only folders that nobody has touched for an hour go; a failure to remove one is not worth stopping for.
fn sweep(prefix: &str) {
    const STALE: std::time::Duration = std::time::Duration::from_secs(3600);
    let Ok(entries) = fs::read_dir(cache()) else {
        return;
    };
    for entry in entries.flatten() {
        let is_scratch = entry.file_name().to_string_lossy().starts_with(prefix);
        let is_stale = entry
            .metadata()
            .and_then(|meta| meta.modified())
            .is_ok_and(|time| time.elapsed().is_ok_and(|age| age > STALE));
        if is_scratch && is_stale {
            drop(fs::remove_dir_all(entry.path()));
        }
    }
}

/// Puts a finished file or folder in its place. Where another run was quicker, its result stays: both are the same.
///
/// # Errors
///
/// When the file system refuses.
pub(crate) fn publish(from: &Path, to: &Path) -> Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent)
            .with_context(|| format!("cannot make the folder {}", parent.display()))?;
    }
    match fs::rename(from, to) {
        Ok(()) => Ok(()),
        Err(_) if to.exists() => Ok(()),
        Err(error) => Err(error)
            .with_context(|| format!("cannot move {} to {}", from.display(), to.display())),
    }
}

/// Replaces the folder `to` by the finished folder `from`.
///
/// # Errors
///
/// When the file system refuses.
pub(crate) fn replace_dir(from: &Path, to: &Path) -> Result<()> {
    if to.exists() {
        fs::remove_dir_all(to)
            .with_context(|| format!("cannot remove the old {}", to.display()))?;
    }
    fs::rename(from, to)
        .with_context(|| format!("cannot move {} to {}", from.display(), to.display()))
}

/// Writes a file under a temporary name, then renames it: a reader sees the old or the new one, never a half.
///
/// # Errors
///
/// When the file system refuses.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let Some(parent) = path.parent() else {
        bail!("{} has no folder", path.display())
    };
    let context = || format!("cannot write {}", path.display());
    fs::create_dir_all(parent).with_context(context)?;
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".tmp");
    let temporary = path.with_file_name(name);
    fs::write(&temporary, bytes).with_context(context)?;
    fs::rename(&temporary, path).with_context(context)
}
