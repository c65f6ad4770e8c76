//! `coil train`: trains a network in resumable pieces.

#[cfg(feature = "train")]
use crate::train_policy;
use crate::train_solver;
use std::process::ExitCode;

/// What to train.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    network: Network,
}

#[derive(clap::Subcommand)]
enum Network {
    /// The illumination policy (COIL-PS), end to end through pictures, solver and all steps.
    #[cfg(feature = "train")]
    Policy(Box<train_policy::Args>),
    /// The solver `pixel`, on synthetic pixels.
    Solver(train_solver::Args),
}

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.network {
        #[cfg(feature = "train")]
        Network::Policy(args) => train_policy::run(&args),
        Network::Solver(args) => train_solver::run(args),
    }
}
