//! A folder of an earlier run, put aside while another one is made in its place.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Comes back when it is dropped, unless another folder stands in its place by then.
#[derive(Debug)]
pub struct Aside {
    folder: PathBuf,
    kept: PathBuf,
}

impl Aside {
    /// Puts a folder aside if it is there, or takes over what a run that was killed had put aside. It may hold nothing but files of
    /// the names in `known`: whatever else lies there is somebody's, and not for us to move.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] that names what is not known; others of the operating system, with the path in the text.
    pub fn put(folder: &Path, known: &[&str]) -> io::Result<Option<Self>> {
        let mut kept = folder.as_os_str().to_owned();
        kept.push(".before");
        let kept = PathBuf::from(kept);
        for place in [folder, &kept] {
            only_known(place, known)?;
        }
        let named = |e: io::Error| io::Error::new(e.kind(), format!("{}: {e}", folder.display()));
        match (folder.exists(), kept.exists()) {
            (false, false) => return Ok(None),
            (true, false) => fs::rename(folder, &kept).map_err(named)?,
            // A run was killed before it had anything to put in the place.
            (false, true) => {}
            // Or while it wrote: what it kept is whole, what it wrote may not be.
            (true, true) => fs::remove_dir_all(folder).map_err(named)?,
        }
        Ok(Some(Self {
            folder: folder.to_owned(),
            kept,
        }))
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        // Nobody is left to tell of a failure; what is kept then stays where it is, under its own name.
        if self.folder.exists() {
            drop(fs::remove_dir_all(&self.kept));
        } else {
            drop(fs::rename(&self.kept, &self.folder));
        }
    }
}

fn only_known(folder: &Path, known: &[&str]) -> io::Result<()> {
    if !folder.exists() {
        return Ok(());
    }
    let all = if folder.is_dir() {
        crate::files::entries(folder)?
    } else {
        vec![folder.to_owned()]
    };
    let is_known = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        path.is_file() && name.is_some_and(|name| known.contains(&name))
    };
    match all.into_iter().find(|path| !is_known(path)) {
        None => Ok(()),
        Some(other) => Err(io::Error::new(
            io::ErrorKind::AlreadyExists,
            format!(
                "{} is no file of an earlier run, and {} would be made anew: move it away, or name another folder",
                other.display(),
                folder.display()
            ),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_run_had_put_aside_comes_back_with_the_next_one() -> io::Result<()> {
        let root = std::env::temp_dir().join(format!("landline-killed-{}", std::process::id()));
        let folder = root.join("poses");
        let write = |text: &[u8]| {
            fs::create_dir_all(&folder)?;
            fs::write(folder.join("a.txt"), text)
        };
        let read = || fs::read(folder.join("a.txt"));
        write(b"first")?;
        // Nothing of a process that is killed is dropped.
        let killed = |half: Option<&[u8]>| {
            std::mem::forget(Aside::put(&folder, &["a.txt"])?);
            half.map_or(Ok(()), write)
        };
        for half in [None, Some(b"half".as_slice())] {
            killed(half)?;
            drop(Aside::put(&folder, &["a.txt"])?);
            assert_eq!(read()?, b"first", "{half:?}: the next run failed");
        }
        killed(None)?;
        let aside = Aside::put(&folder, &["a.txt"])?;
        write(b"second")?;
        drop(aside);
        assert_eq!(read()?, b"second", "the next run did not fail");
        assert_eq!(crate::files::entries(&root)?.len(), 1, "nothing is left");
        fs::remove_dir_all(&root)
    }

    #[test]
    fn what_is_not_ours_stays_and_what_is_ours_comes_back() -> io::Result<()> {
        let root = std::env::temp_dir().join(format!("landline-aside-{}", std::process::id()));
        let folder = root.join("poses");
        assert!(Aside::put(&folder, &["a.txt"])?.is_none());
        fs::create_dir_all(&folder)?;
        fs::write(folder.join("a.txt"), b"first")?;
        fs::write(folder.join("precious.txt"), b"somebody's")?;
        let error = Aside::put(&folder, &["a.txt"]).expect_err("is not ours");
        assert!(error.to_string().contains("precious.txt"), "{error}");
        assert_eq!(fs::read(folder.join("precious.txt"))?, b"somebody's");

        fs::remove_file(folder.join("precious.txt"))?;
        drop(Aside::put(&folder, &["a.txt"])?);
        assert_eq!(
            fs::read(folder.join("a.txt"))?,
            b"first",
            "nothing came instead"
        );
        let aside = Aside::put(&folder, &["a.txt"])?;
        assert!(aside.is_some() && !folder.exists());
        fs::create_dir(&folder)?;
        fs::write(folder.join("a.txt"), b"second")?;
        drop(aside);
        assert_eq!(fs::read(folder.join("a.txt"))?, b"second");
        assert_eq!(crate::files::entries(&root)?.len(), 1, "nothing is left");
        fs::remove_dir_all(&root)
    }
}
