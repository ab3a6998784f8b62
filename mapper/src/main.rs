//! Native tool of landline. This file is only the table of commands: each is one file in `cmd`, with its `Args` and
//! `run`.

use clap::{Parser, Subcommand};
use landline_mapper::cmd;
use std::process::ExitCode;

/// Teaches a place, evaluates scenes, locates pictures, converts models.
#[derive(Debug, Parser)]
#[command(name = "landline", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

// Keep alphabetical; the first doc line of a command's `Args` is its help.
#[derive(Debug, Subcommand)]
enum Command {
    Convert(cmd::convert::Args),
    Data(cmd::data::Args),
    Demo(cmd::demo::Args),
    Eval(cmd::eval::Args),
    Export(cmd::export::Args),
    Features(cmd::features::Args),
    Flow(cmd::flow::Args),
    Inspect(cmd::inspect::Args),
    Labels(cmd::labels::Args),
    Landmarks(cmd::landmarks::Args),
    Lines(cmd::lines::Args),
    Locate(cmd::locate::Args),
    // Much the largest.
    Map(Box<cmd::map::Args>),
    MapAll(cmd::map_all::Args),
    Paper(cmd::paper::Args),
    Place(cmd::place::Args),
    Poses(cmd::poses::Args),
    #[cfg(feature = "train")]
    Train(cmd::train::Args),
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Convert(args) => cmd::convert::run(args),
        Command::Data(args) => cmd::data::run(args),
        Command::Demo(args) => cmd::demo::run(args),
        Command::Eval(args) => cmd::eval::run(args),
        Command::Export(args) => cmd::export::run(args),
        Command::Features(args) => cmd::features::run(args),
        Command::Flow(args) => cmd::flow::run(args),
        Command::Inspect(args) => cmd::inspect::run(args),
        Command::Labels(args) => cmd::labels::run(args),
        Command::Landmarks(args) => cmd::landmarks::run(args),
        Command::Lines(args) => cmd::lines::run(args),
        Command::Locate(args) => cmd::locate::run(args),
        Command::Map(args) => cmd::map::run(*args),
        Command::Paper(args) => cmd::paper::run(args),
        Command::MapAll(args) => cmd::map_all::run(args),
        Command::Place(args) => cmd::place::run(args),
        Command::Poses(args) => cmd::poses::run(args),
        #[cfg(feature = "train")]
        Command::Train(args) => cmd::train::run(args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let told = landline_mapper::shown::told(&error);
            landline_mapper::output::err(format_args!("error: {told}\n"));
            ExitCode::FAILURE
        }
    }
}
