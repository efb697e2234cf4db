//! `firmware-host`: see `firmware-host --help`.

use std::io::IsTerminal;
use std::process::ExitCode;

use clap::Parser;
use firmware_host::cli::{Cli, Command};
use firmware_host::config::ConfigError;
use firmware_host::{check, explore, health, perceive, replay_run, run, views};

/// The run could not be done.
const FAILED: u8 = 1;
/// What was asked for cannot be: a wrong argument or configuration. As clap has it.
const MISUSED: u8 = 2;

fn main() -> ExitCode {
    let cli = Cli::parse();
    tracing_subscriber::fmt()
        .with_env_filter(tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into()))
        .with_writer(std::io::stderr)
        // A journal shows colours as noise.
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let result = match cli.command {
        Command::Explore(args) => explore::run(&args).map(|()| ExitCode::SUCCESS),
        Command::Perceive(args) => perceive::run(&args).map(|()| ExitCode::SUCCESS),
        Command::Replay(args) => replay_run::run(&args),
        Command::Views(args) => views::run(&args).map(|()| ExitCode::SUCCESS),
        Command::Run(args) => run::run(&args).map(|()| ExitCode::SUCCESS),
        Command::Health(args) => health::run(&args),
        Command::Check(args) => check::run(&args),
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::from(if error.is::<ConfigError>() { MISUSED } else { FAILED })
    })
}
