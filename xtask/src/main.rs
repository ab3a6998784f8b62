//! Developer commands of landline: `cargo xtask <command>`. This file is only the table of commands.

mod audit;
mod bench;
mod ci;
mod demo;
mod files;
mod metadata;
mod paths;
mod pins;
mod reproduce;
mod rooms;
mod sbom;
mod serve;
mod setup;
mod shell;
mod site;
mod soak;
mod tally;
mod test;
mod tiers;
mod web;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Developer commands of landline. `demo` and `test` set up by themselves whatever they need.
#[derive(Debug, Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Api(web::api::Args),
    Audit(audit::Args),
    Bench(bench::Args),
    Ci(ci::Args),
    Demo(demo::Args),
    Reproduce(reproduce::Args),
    Rooms(rooms::Args),
    Sample(demo::SampleArgs),
    Sbom(sbom::Args),
    Serve(serve::Args),
    Setup(setup::Args),
    Site(site::Args),
    Size(web::size::Args),
    Soak(soak::Args),
    Test(test::Args),
    Web(web::Args),
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Api(args) => web::api::run(&args),
        Command::Audit(args) => audit::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Ci(args) => ci::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Reproduce(args) => reproduce::run(&args),
        Command::Rooms(args) => rooms::run(&args),
        Command::Sample(args) => demo::sample(&args),
        Command::Sbom(args) => sbom::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Setup(args) => setup::run(&args),
        Command::Site(args) => site::run(&args),
        Command::Size(args) => web::size::run(&args),
        Command::Soak(args) => soak::run(&args),
        Command::Test(args) => test::run(&args),
        Command::Web(args) => web::run(&args),
    }
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // `{:#}` joins the causes in one line: what failed, why, what to do.
            eprintln!("\nerror: {error:#}");
            ExitCode::FAILURE
        }
    }
}
