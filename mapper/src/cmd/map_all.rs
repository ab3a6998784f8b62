//! `landline map-all`: `landline map` for every folder of a folder, and the place of them.

use crate::files;
use crate::place::PlaceFiles;
use crate::run_lock::RunLock;
use crate::shown::{shown, told};
use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::time::{Instant, UNIX_EPOCH};

/// Teach many rooms: `landline map` for each folder of a folder, then one place of all of them.
///
/// One line a room; what each run prints goes to OUT/ROOM.log. A run that broke off goes on where it was: rooms whose pictures
/// and options are as they were are not taught again. A room that fails does not keep the others.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with a folder for each room: whatever `landline map` takes.
    rooms: PathBuf,
    /// Folder to write to: ROOM.landline, ROOM.log, `map-all.json` and the place.
    #[arg(long, short)]
    out: PathBuf,
    /// Name of the place: OUT/NAME.place.json.
    #[arg(long, default_value = "all")]
    place: String,
    /// Rooms at a time. One room uses all cores in most of its steps.
    #[arg(long, default_value_t = 1)]
    jobs: usize,
    /// What is handed to `landline map` for each room, after `--`.
    #[arg(last = true)]
    options: Vec<String>,
}

/// `map-all.json`: what was done.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Done {
    rooms: BTreeMap<String, DoneRoom>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct DoneRoom {
    /// Names, lengths and times of the files, and the options.
    made_of: String,
    /// Bytes of the scene; none where teaching failed.
    bytes: Option<u64>,
    seconds: f64,
}

/// Teaches them.
///
/// # Errors
/// When nothing is there to teach, the disk refuses, or, once all others are done, when a room failed.
pub fn run(args: Args) -> Result<()> {
    let mut rooms = files::entries(&args.rooms)?;
    rooms.retain(|path| path.is_dir());
    if rooms.is_empty() {
        bail!("{} has no folders: each room is one", args.rooms.display());
    }
    let _held = RunLock::hold(&args.out)?;
    let state = args.out.join("map-all.json");
    let done = Mutex::new(read_state(&state)?);
    let next = Mutex::new(rooms.iter());
    let failed = Mutex::new(0_usize);
    let work = || -> Result<()> {
        loop {
            let Some(room) = next.lock().map_err(poisoned)?.next() else {
                return Ok(());
            };
            let id = room.file_name().unwrap_or_default().to_string_lossy();
            let made_of = made_of(room, &args.options)?;
            let scene = args.out.join(format!("{id}.landline"));
            let before = done.lock().map_err(poisoned)?.rooms.get(&*id).cloned();
            let is_done = |d: &DoneRoom| {
                let len = std::fs::metadata(&scene).map(|m| m.len()).ok();
                d.made_of == made_of && d.bytes.is_some() && d.bytes == len
            };
            if let Some(before) = before.filter(is_done) {
                println!("{}: as before, {:.0} s", shown(&id), before.seconds);
                continue;
            }
            let start = Instant::now();
            let taught = teach(room, &scene, &args);
            let seconds = start.elapsed().as_secs_f64();
            match &taught {
                Ok(bytes) => println!("{}: {bytes} bytes, {seconds:.0} s", shown(&id)),
                Err(error) => {
                    println!("{}: failed, {}", shown(&id), told(error));
                    *failed.lock().map_err(poisoned)? += 1;
                }
            }
            let mut done = done.lock().map_err(poisoned)?;
            done.rooms.insert(
                id.into_owned(),
                DoneRoom {
                    made_of,
                    bytes: taught.ok(),
                    seconds,
                },
            );
            files::write_bytes(&state, serde_json::to_string_pretty(&*done)?.as_bytes())?;
        }
    };
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..args.jobs.min(rooms.len()))
            .map(|_| scope.spawn(work))
            .collect();
        let own = work();
        for other in others {
            match other.join() {
                Ok(outcome) => outcome?,
                Err(_) => bail!("a thread that teaches ended early"),
            }
        }
        own
    })?;
    let out = args.out.join(format!("{}.place.json", args.place));
    let place = PlaceFiles::build(&out, &args.out)?;
    println!(
        "wrote {}: {} rooms, index of {} bytes",
        out.display(),
        place.manifest.rooms.len(),
        place.manifest.index.bytes
    );
    let failed = failed.into_inner().map_err(poisoned)?;
    ensure!(
        failed == 0,
        "{failed} of {} rooms failed; their logs say why",
        rooms.len()
    );
    Ok(())
}

fn poisoned<T>(_: std::sync::PoisonError<T>) -> anyhow::Error {
    anyhow::anyhow!("a thread that teaches ended early")
}

fn read_state(path: &Path) -> Result<Done> {
    if !path.exists() {
        return Ok(Done::default());
    }
    let text = std::fs::read_to_string(path);
    let text = text.with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text)
        .with_context(|| format!("{} is damaged: remove it to begin anew", path.display()))
}

/// What a room's scene depends on, as text: the files of its folder and the options.
fn made_of(room: &Path, options: &[String]) -> Result<String> {
    let mut listed = Vec::new();
    let mut folders = vec![room.to_owned()];
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(&folder)
            .with_context(|| format!("cannot list {}", folder.display()))?;
        for entry in entries {
            let path = entry?.path();
            let about = std::fs::metadata(&path)
                .with_context(|| format!("cannot find {}", path.display()))?;
            if about.is_dir() {
                folders.push(path);
                continue;
            }
            let changed = about.modified().ok().and_then(|at| {
                let since = at.duration_since(UNIX_EPOCH).ok()?;
                Some(since.as_secs())
            });
            listed.push(format!("{} {} {changed:?}", path.display(), about.len()));
        }
    }
    listed.sort();
    let text = format!("{}\n{}", listed.join("\n"), options.join("\n"));
    Ok(crate::import::sha256_hex(text.as_bytes()))
}

/// Teaches a room in a process of its own, so that one that fails or is too large takes nothing with it.
fn teach(room: &Path, scene: &Path, args: &Args) -> Result<u64> {
    let log = scene.with_extension("log");
    let out = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
    let own = std::env::current_exe().context("which program this is")?;
    let status = Command::new(own)
        .arg("map")
        .arg(room)
        .arg("--out")
        .arg(scene)
        .args(&args.options)
        .stdout(out.try_clone()?)
        .stderr(out)
        .status()?;
    if !status.success() {
        let text = std::fs::read_to_string(&log).unwrap_or_default();
        let last = text.lines().rev().find(|line| line.contains("error"));
        bail!("{}", last.unwrap_or("it ended without a word"));
    }
    Ok(std::fs::metadata(scene)?.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_pictures_and_other_options_are_told_from_those_before() -> Result<()> {
        let folder = std::env::temp_dir().join(format!("landline-all-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("a"))?;
        std::fs::write(folder.join("a/1.jpg"), b"one")?;
        let first = made_of(&folder, &[])?;
        assert_eq!(first, made_of(&folder, &[])?);
        assert_ne!(first, made_of(&folder, &["--no-lines".to_owned()])?);
        std::fs::write(folder.join("a/2.jpg"), b"two")?;
        assert_ne!(first, made_of(&folder, &[])?);
        std::fs::remove_dir_all(&folder)?;
        Ok(())
    }

    #[test]
    fn a_damaged_state_is_an_error_that_says_what_helps() -> Result<()> {
        let path = std::env::temp_dir().join(format!("landline-state-{}", std::process::id()));
        std::fs::write(&path, b"{\"rooms\": [")?;
        let text = format!("{:#}", read_state(&path).expect_err("is damaged"));
        assert!(text.contains("remove it"), "{text}");
        std::fs::remove_file(&path)?;
        assert!(read_state(&path)?.rooms.is_empty());
        Ok(())
    }
}
