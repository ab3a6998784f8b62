//! Files that appear whole or not at all: written to a temporary name beside the target, then renamed.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a file through `fill`; the target keeps its old content when anything fails (disk full, interrupt).
///
/// # Errors
/// Of the operating system or of `fill`, with the path in the text.
pub fn write_atomic(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    write_at_once(path, |temporary| {
        let mut out = BufWriter::new(File::create(temporary)?);
        fill(&mut out)?;
        out.into_inner().map_err(io::IntoInnerError::into_error)?;
        Ok(())
    })
}

/// [`write_atomic`] where the writer wants a path: `fill` makes the file that it is given.
///
/// # Errors
/// Of the operating system or of `fill`, with the path in the text.
pub fn write_at_once(path: &Path, fill: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    let named = |e: io::Error| io::Error::new(e.kind(), format!("writing {}: {e}", path.display()));
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder).map_err(named)?;
    let mut temporary_name = path.file_name().unwrap_or_default().to_owned();
    temporary_name.push(format!(".{}.partial", std::process::id()));
    let temporary = folder.join(temporary_name);
    let outcome = (|| {
        fill(&temporary)?;
        File::open(&temporary)?.sync_all()?;
        fs::rename(&temporary, path)
    })();
    outcome.map_err(|e| {
        // The partial file is of no use to anybody; the first error is the one to report.
        drop(fs::remove_file(&temporary));
        named(e)
    })
}

/// [`write_atomic`] of bytes at hand.
///
/// # Errors
/// Of the operating system, with the path in the text.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_atomic(path, |out| out.write_all(bytes))
}

/// What lies in a folder, by name.
///
/// # Errors
/// Of the operating system, with the path in the text.
pub fn entries(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let listed = fs::read_dir(folder)
        .map_err(|e| io::Error::new(e.kind(), format!("cannot list {}: {e}", folder.display())))?;
    let mut paths: Vec<PathBuf> = listed
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failure_keeps_the_old_file_and_leaves_no_partial_one() -> io::Result<()> {
        let folder = std::env::temp_dir().join(format!("landline-files-{}", std::process::id()));
        let path = folder.join("a.txt");
        write_bytes(&path, b"old")?;
        let outcome = write_atomic(&path, |out| {
            out.write_all(b"half of the new")?;
            Err(io::Error::new(io::ErrorKind::StorageFull, "no space left"))
        });
        let message = outcome.expect_err("the write must fail").to_string();
        assert!(message.contains("a.txt"), "{message}");
        assert_eq!(fs::read(&path)?, b"old");
        assert_eq!(fs::read_dir(&folder)?.count(), 1);
        fs::remove_dir_all(&folder)
    }
}
