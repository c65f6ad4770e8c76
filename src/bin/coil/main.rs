//! `coil`: the command line of coil-ps. One file a subcommand.

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Photometric stereo that decides for itself where to put the next light.
#[derive(Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {}

fn main() -> ExitCode {
    let result: anyhow::Result<ExitCode> = match Cli::parse().command {};
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::from(2)
    })
}
