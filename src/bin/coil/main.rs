//! `coil`: the command line of coil-ps. One file a subcommand.

// As the standard library's, which panic where the reader has gone (`| head`): no reason to stop in the middle of a file or
// to leave an arm moving.
macro_rules! print {
    ($($text:tt)*) => { crate::output::say(format_args!($($text)*)) };
}
macro_rules! println {
    ($($text:tt)*) => { crate::output::say(format_args!("{}\n", format_args!($($text)*))) };
}
macro_rules! eprintln {
    ($($text:tt)*) => { crate::output::tell(format_args!("{}\n", format_args!($($text)*))) };
}

mod arm;
mod calibrate;
mod capture;
mod eval;
mod export;
mod files;
mod info;
#[cfg(feature = "policy")]
mod model;
mod models;
mod objects;
mod output;
mod render;
mod serve;
mod solve;
mod study;
mod train;
#[cfg(feature = "train")]
mod train_policy;
mod train_solver;
mod tune;

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
enum Command {
    /// Compare planners and solvers on datasets or rendered objects.
    Eval(eval::EvalArgs),
    /// Studies that need the ground truth: study k.
    Study(study::StudyArgs),
    /// Solve objects and write normals, expected errors and surfaces.
    Solve(solve::Args),
    /// Tune the solvers without training on synthetic pixels.
    Tune(tune::Args),
    /// Tell what datasets are and what is wrong with them.
    Info(info::Args),
    /// Write lights, normals or whole objects in another format.
    Export(export::Args),
    /// Render synthetic objects under many lights.
    Render(render::Args),
    /// Drive the arm of a rig, real or simulated.
    Arm(arm::Args),
    /// Measure light directions with a mirror sphere, and fit how the arm stands.
    Calibrate(calibrate::Args),
    /// Take a whole session with a rig, real or simulated: plan, move, expose, merge, solve.
    Capture(Box<capture::Args>),
    /// Build what is stale of the page and serve it on this machine.
    Serve(serve::ServeArgs),
    /// What a trained model says of itself.
    #[cfg(feature = "policy")]
    Model(model::Args),
    /// Train a network (in resumable pieces).
    Train(train::Args),
}

fn main() -> ExitCode {
    let result: anyhow::Result<ExitCode> = match Cli::parse().command {
        Command::Eval(args) => eval::run(args),
        Command::Study(args) => study::run(args),
        Command::Solve(args) => solve::run(args),
        Command::Tune(args) => tune::run(args),
        Command::Info(args) => info::run(args),
        Command::Export(args) => export::run(args),
        Command::Render(args) => render::run(args),
        Command::Arm(args) => arm::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Capture(args) => capture::run(*args),
        Command::Serve(args) => serve::run(args),
        #[cfg(feature = "policy")]
        Command::Model(args) => model::run(args),
        Command::Train(args) => train::run(args),
    };
    let status = result.and_then(|status| output::all_said().map(|()| status));
    status.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::from(2)
    })
}
