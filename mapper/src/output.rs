//! What the commands print: `println!` and its like as they are meant in a pipe.
//!
//! The standard library's panic when nobody reads any more (`landline inspect room.landline | head -1`) or when the disk that
//! the output goes to is full. These, which take their names in this crate, end the process in the first case as a signal
//! would, without a word, and in the second with one. What a command has written into files by then stays.

use std::fmt::Arguments;
use std::io::{self, Write as _};

/// Exit status of a process that a closed pipe ends: 128 and the number of SIGPIPE.
const CLOSED_PIPE: i32 = 141;

/// Text for standard output.
pub fn out(text: Arguments<'_>) {
    let written = io::stdout().lock().write_fmt(text);
    if let Err(error) = written {
        give_up("standard output", &error);
    }
}

/// Text for standard error.
pub fn err(text: Arguments<'_>) {
    let written = io::stderr().lock().write_fmt(text);
    if let Err(error) = written {
        give_up("standard error", &error);
    }
}

fn give_up(to: &str, error: &io::Error) -> ! {
    if error.kind() == io::ErrorKind::BrokenPipe {
        std::process::exit(CLOSED_PIPE);
    }
    // Where this cannot be said either, the status has to do.
    let _ = writeln!(io::stderr(), "error: cannot write to {to}: {error}");
    std::process::exit(1);
}

macro_rules! print {
    ($($text:tt)*) => { $crate::output::out(format_args!($($text)*)) };
}

macro_rules! println {
    () => { $crate::output::out(format_args!("\n")) };
    ($($text:tt)*) => { $crate::output::out(format_args!("{}\n", format_args!($($text)*))) };
}

macro_rules! eprintln {
    ($($text:tt)*) => { $crate::output::err(format_args!("{}\n", format_args!($($text)*))) };
}
