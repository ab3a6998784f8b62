//! Running other programs: what is run is printed, a missing program and a failed one give different messages.

use anyhow::{Context as _, Result, bail};
use std::ffi::OsStr;
use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A program in the checkout's root, without standard input: nothing here may wait for a person.
pub(crate) fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command
        .current_dir(crate::paths::root())
        .stdin(Stdio::null());
    command
}

/// Cargo, the one that runs this program.
pub(crate) fn cargo() -> Command {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// `command` as one would type it, for messages.
pub(crate) fn shown(command: &Command) -> String {
    let mut words = vec![
        Path::new(command.get_program())
            .file_name()
            .unwrap_or(command.get_program()),
    ];
    words.extend(command.get_args());
    words
        .iter()
        .map(|word| word.to_string_lossy())
        .collect::<Vec<_>>()
        .join(" ")
}

/// Runs a program with its output on the terminal.
///
/// # Errors
///
/// When it is missing or fails.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let status = spawn(command)?
        .wait()
        .with_context(|| format!("lost `{}`", shown(command)))?;
    if status.success() {
        Ok(())
    } else {
        bail!("`{}` failed ({status})", shown(command))
    }
}

/// Runs a program and returns what it printed; when it fails, the error carries the end of its messages.
///
/// # Errors
///
/// When it is missing or fails.
pub(crate) fn output(command: &mut Command) -> Result<String> {
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let output = spawn(command)?
        .wait_with_output()
        .with_context(|| format!("lost `{}`", shown(command)))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let stderr = String::from_utf8_lossy(&output.stderr);
    let stdout = String::from_utf8_lossy(&output.stdout);
    let said = if stderr.trim().is_empty() {
        stdout
    } else {
        stderr
    };
    let lines: Vec<&str> = said.lines().collect();
    let tail = lines[lines.len().saturating_sub(20)..].join("\n");
    bail!("`{}` failed ({}):\n{tail}", shown(command), output.status)
}

/// Runs a program, passes its standard output on line by line and gives each line to `read`. Returns whether it
/// succeeded: test runners fail as a matter of course, and their caller wants to count on.
///
/// # Errors
///
/// When it is missing.
pub(crate) fn stream(command: &mut Command, mut read: impl FnMut(&str)) -> Result<bool> {
    let mut child = spawn(command.stdout(Stdio::piped()))?;
    if let Some(stdout) = child.stdout.take() {
        let mut terminal = std::io::stdout().lock();
        for line in BufReader::new(stdout).split(b'\n') {
            let line = line.with_context(|| format!("lost the output of `{}`", shown(command)))?;
            let line = String::from_utf8_lossy(&line);
            // A closed terminal must not stop the run: the exit status still counts.
            drop(writeln!(terminal, "{line}"));
            read(&line);
        }
    }
    Ok(child
        .wait()
        .with_context(|| format!("lost `{}`", shown(command)))?
        .success())
}

fn spawn(command: &mut Command) -> Result<Child> {
    command.spawn().map_err(|error| {
        let name = shown(command);
        if error.kind() == ErrorKind::NotFound {
            anyhow::anyhow!(
                "`{}` is not installed, or not on PATH",
                command.get_program().to_string_lossy()
            )
        } else {
            anyhow::Error::new(error).context(format!("cannot start `{name}`"))
        }
    })
}

/// Where `program` is on PATH.
pub(crate) fn find(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .map(|dir| dir.join(program))
        .find(|file| file.is_file())
}
