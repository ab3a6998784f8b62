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
    #[cfg(not(feature = "train"))]
    #[command(hide = true)]
    Train(cmd::untrained::Args),
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
        Command::MapAll(args) => cmd::map_all::run(args),
        Command::Paper(args) => cmd::paper::run(args),
        Command::Place(args) => cmd::place::run(args),
        Command::Poses(args) => cmd::poses::run(args),
        #[cfg(feature = "train")]
        Command::Train(args) => cmd::train::run(args),
        #[cfg(not(feature = "train"))]
        Command::Train(args) => cmd::untrained::run(args),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The tool's arguments as a shell would hand them over.
    fn parsed(line: &str) -> Result<Cli, clap::Error> {
        Cli::try_parse_from(["landline"].into_iter().chain(line.split(' ')))
    }
    use clap::CommandFactory as _;

    #[test]
    fn commands_and_their_words_are_taken() {
        Cli::command().debug_assert();
        for line in [
            "map room --out x --precision f16 --privacy sparse,no-lines --refine-poses auto --units metres",
            "map room --out x --privacy coarse-descriptors,no-second-look --refine-poses on",
            "convert in out --precision int8 --units arbitrary --privacy sparse",
            "landmarks scene labels --out x --max-bytes 1 --precision f32",
            "locate scene picture --device gpu --kernels portable",
            "eval scene room --device auto --kernels auto",
            "paper 7scenes root",
            "paper indoor6 root",
        ] {
            if let Err(error) = parsed(line) {
                panic!("{line}: {error}");
            }
        }
        for (line, said) in [
            (
                "map room --out x --precision f64",
                "[possible values: f32, f16, int8]",
            ),
            (
                "locate scene picture --device tpu",
                "[possible values: auto, gpu, cpu]",
            ),
            (
                "paper cambridge root",
                "[possible values: 7scenes, indoor6]",
            ),
        ] {
            let error = parsed(line).expect_err("no such word").to_string();
            assert!(error.contains(said), "{line}: {error}");
        }
    }

    #[cfg(not(feature = "train"))]
    #[test]
    fn options_of_training_are_refused_with_how_to_have_them() {
        for line in [
            "map room --out x --minutes 5",
            "map room --out x --training always",
            "map room --out x --resume",
            "map room --out x --set a=1",
            "paper 7scenes root --preset paper",
        ] {
            let error = parsed(line).expect_err("no training");
            assert!(
                error.to_string().contains("made without training"),
                "{line}: {error}"
            );
        }
        for line in [
            "map room --out x --training never",
            "train labels --out x --steps 5",
        ] {
            assert!(parsed(line).is_ok(), "{line}");
        }
    }

    #[test]
    fn several_paths_in_place_of_a_folder_are_told() {
        for line in [
            "map a.jpg b.jpg --out x",
            "poses a.jpg b.jpg --out x",
            "data a b",
        ] {
            let error = parsed(line).expect_err("too many").to_string();
            assert!(error.contains("give the folder"), "{line}: {error}");
        }
    }

    #[cfg(feature = "train")]
    #[test]
    fn words_of_training_are_taken() {
        for when in ["auto", "always", "never"] {
            let line = ["landline", "map", "room", "--out", "x", "--training", when];
            assert!(Cli::try_parse_from(line).is_ok(), "{when}");
        }
    }
}
