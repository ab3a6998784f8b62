//! What the tool prints, and into what.

use crate::folder::Folder;
use std::io::pipe;
use std::path::Path;
use std::process::{Command, Stdio};

/// `landline lines` on a picture: it prints, and needs nothing.
fn lines(folder: &Folder) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_landline"));
    command
        .arg("lines")
        .arg(folder.picture("a/1.png", 64, 48))
        .stderr(Stdio::piped());
    command
}

#[test]
fn a_pipe_that_nobody_reads_ends_the_tool_without_a_word() {
    let folder = Folder::new();
    let (reader, writer) = pipe().expect("a pipe");
    drop(reader);
    let run = lines(&folder).stdout(writer).output().expect("starts");
    assert_eq!(run.status.code(), Some(141));
    assert!(run.stderr.is_empty(), "{:?}", run.stderr);

    // Nor does an error that nobody reads become a panic.
    let (reader, writer) = pipe().expect("a pipe");
    drop(reader);
    let mut command = lines(&folder);
    let run = command.arg("--svg").arg("a.gif").stderr(writer);
    assert_eq!(run.output().expect("starts").status.code(), Some(141));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_under_the_output_is_told() {
    let folder = Folder::new();
    let full = std::fs::File::create("/dev/full").expect("a device of Linux");
    let run = lines(&folder).stdout(full).output().expect("starts");
    let message = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{message}");
    assert!(
        message.starts_with("error: cannot write to standard output: "),
        "{message}"
    );
}

#[test]
fn drawings_of_pictures_of_one_name_do_not_replace_each_other() {
    let folder = Folder::new();
    let out = folder.0.join("drawn");
    let run = lines(&folder)
        .arg(folder.picture("b/1.png", 48, 64))
        .arg("--svg")
        .arg(&out)
        .output()
        .expect("starts");
    assert!(run.status.success(), "{:?}", run.stderr);
    for (name, size) in [("a_1.png.svg", "64"), ("b_1.png.svg", "48")] {
        let drawn = std::fs::read_to_string(out.join(Path::new(name))).expect(name);
        assert!(drawn.contains(&format!("width=\"{size}\"")), "{drawn:.200}");
    }
}
