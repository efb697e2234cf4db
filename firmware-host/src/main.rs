//! `firmware-host`: see `firmware-host --help`.

use std::io::IsTerminal;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};

use clap::Parser;
use firmware_host::cli::{Cli, Command as Task};
use firmware_host::config::ConfigError;
use firmware_host::{
    buffer, camera_latency, check, explore, failure, health, model, perceive, replay_run,
    reproduce, run, views,
};

/// The run could not be done.
const FAILED: u8 = 1;
/// What was asked for cannot be: a wrong argument or configuration. As clap has it.
const MISUSED: u8 = 2;

fn main() -> ExitCode {
    keep_onnx_runtime_silent();
    let cli = Cli::parse();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into()),
        )
        .with_writer(std::io::stderr)
        // A journal shows colours as noise.
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let result = match cli.command {
        Task::Explore(args) => explore::run(&args).map(|()| ExitCode::SUCCESS),
        Task::Perceive(args) => perceive::run(&args).map(|()| ExitCode::SUCCESS),
        Task::Replay(args) => replay_run::run(&args),
        Task::Reproduce(args) => reproduce::run(&args),
        Task::Views(args) => views::run(&args).map(|()| ExitCode::SUCCESS),
        Task::Run(args) => run::run(&args).map(|()| ExitCode::SUCCESS),
        Task::Health(args) => health::run(&args),
        Task::Check(args) => check::run(&args),
        Task::CameraLatency(args) => camera_latency::run(&args).map(|()| ExitCode::SUCCESS),
        Task::Buffer(args) => buffer::run(&args),
        Task::Model(args) => model::run(&args),
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {}", failure::sentence(&error));
        ExitCode::from(if error.is::<ConfigError>() { MISUSED } else { FAILED })
    })
}

/// Since 1.29 ONNX Runtime's own builds report to their maker when they are loaded, also where the interface says no: only this
/// variable, set before, keeps them silent (<https://github.com/microsoft/onnxruntime/pull/27379>). A home is nobody's business.
/// A process cannot set its own variables safely, so the program starts itself once more, as the same process.
fn keep_onnx_runtime_silent() {
    const VARIABLE: &str = "ORT_DISABLE_TELEMETRY";
    if std::env::var_os(VARIABLE).is_none()
        && let Ok(program) = std::env::current_exe()
    {
        let mut args = std::env::args_os();
        let name = args.next().unwrap_or_default();
        let error = Command::new(program).arg0(name).args(args).env(VARIABLE, "1").exec();
        // It goes on as it is rather than not at all; the service sets the variable itself.
        eprintln!("warning: cannot set {VARIABLE} ({error}): ONNX Runtime may report to its maker");
    }
}
