//! Files that appear whole or not at all: written to a temporary name beside the target, then renamed.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Component, Path, PathBuf};

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

/// For each of some files a name without folders, to call something made of it: the file's own, as `name_of` takes it
/// ([`Path::file_stem`]); where several are called so, with the folders before it that tell them apart, or else a number. A
/// file that is there twice has one name.
pub fn names_apart(files: &[PathBuf], name_of: fn(&Path) -> Option<&OsStr>) -> Vec<String> {
    let parts: Vec<Vec<String>> = files
        .iter()
        .map(|file| {
            let folders = file.parent().into_iter().flat_map(Path::components);
            let folders = folders.filter(|part| matches!(part, Component::Normal(_)));
            folders
                .map(|part| part.as_os_str().to_string_lossy().into_owned())
                .chain(name_of(file).map(|name| name.to_string_lossy().into_owned()))
                .collect()
        })
        .collect();
    let mut lengths = vec![1; files.len()];
    loop {
        let names: Vec<String> = std::iter::zip(&parts, &lengths)
            .map(|(parts, len)| parts[parts.len().saturating_sub(*len)..].join("_"))
            .collect();
        // Some file systems do not tell upper from lower case.
        let mut alike: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (i, name) in names.iter().enumerate() {
            alike.entry(name.to_lowercase()).or_default().push(i);
        }
        let is_told = |same: &Vec<usize>| same.iter().all(|i| files[*i] == files[same[0]]);
        alike.retain(|_, same| !is_told(same));
        let mut is_longer = false;
        for i in alike.values().flatten() {
            if lengths[*i] < parts[*i].len() {
                lengths[*i] += 1;
                is_longer = true;
            }
        }
        if is_longer {
            continue;
        }
        // Paths that differ in nothing that a name could show.
        return names
            .iter()
            .enumerate()
            .map(|(i, name)| {
                let same = alike.get(&name.to_lowercase());
                let before = same.and_then(|same| same.iter().position(|j| files[*j] == files[i]));
                match before {
                    Some(n @ 1..) => format!("{name}-{}", n + 1),
                    _ => name.clone(),
                }
            })
            .collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_one_name_are_told_apart_by_their_folders() {
        let names = |files: &[&str]| {
            let files: Vec<PathBuf> = files.iter().map(PathBuf::from).collect();
            names_apart(&files, Path::file_stem)
        };
        assert_eq!(names(&["x/a.png", "x/b.png"]), ["a", "b"]);
        assert_eq!(
            names(&["r/a/1.png", "r/b/1.png", "r/b/2.png", "r/a/1.png"]),
            ["a_1", "b_1", "2", "a_1"]
        );
        assert_eq!(names(&["r/a/x/1.png", "r/b/x/1.PNG"]), ["a_x_1", "b_x_1"]);
        assert_eq!(names(&["A.png", "a.jpg", "c/a.png"]), ["A", "a-2", "c_a"]);
        assert_eq!(names(&["1.png", "../1.png"]), ["1", "1-2"]);
    }

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
