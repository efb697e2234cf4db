//! The program on the robot. `firmware-host --help` lists its commands.

use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};

use anyhow::Result;
use clap::Parser;
use firmware_host::cli::{Cli, Command as Subcommand, TaskArgs};
use firmware_host::config::ConfigError;
use firmware_host::{
    buffer, calibrate, camera_latency, check, failure, health, identity, init, localize, logging,
    manual, map, model, mounts, output, perceive, replay_run, reproduce, run, task,
};
#[cfg(feature = "simulator")]
use firmware_host::{explore, views};
use runtime::task::Task;

/// Exit code if the command failed.
const FAILED: u8 = 1;
/// Exit code for a wrong argument or configuration; the same code as clap's.
const MISUSED: u8 = 2;

fn main() -> ExitCode {
    disable_onnx_runtime_telemetry();
    let cli = Cli::parse();
    logging::start();
    let result = match cli.command {
        #[cfg(feature = "simulator")]
        Subcommand::Explore(args) => explore::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Perceive(args) => perceive::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Replay(args) => replay_run::run(&args),
        Subcommand::Reproduce(args) => reproduce::run(&args),
        #[cfg(feature = "simulator")]
        Subcommand::Views(args) => views::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Run(args) => {
            run::run(&args, run::Arming::Configured).map(|_| ExitCode::SUCCESS)
        }
        Subcommand::Health(args) => health::run(&args),
        Subcommand::Identity(args) => identity::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Init(args) => init::run(&args),
        Subcommand::Mounts(args) => mounts::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Check(args) => check::run(&args),
        Subcommand::CameraLatency(args) => camera_latency::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Calibrate(args) => calibrate::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Localize(args) => localize::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::Map(args) => map::run(&args).map(|()| ExitCode::SUCCESS),
        Subcommand::GoTo(args) => {
            let [x_m, y_m] = args.place;
            give(Task::GoTo { x_m, y_m }, &args.task)
        }
        Subcommand::Return(args) => give(Task::Return, &args),
        Subcommand::Resume(args) => give(Task::Explore, &args),
        Subcommand::Buffer(args) => buffer::run(&args),
        Subcommand::Model(args) => model::run(&args),
        Subcommand::Completions { shell } => {
            manual::completions(shell);
            Ok(ExitCode::SUCCESS)
        }
        Subcommand::ManPages { dir } => manual::man_pages(&dir).map(|()| ExitCode::SUCCESS),
    };
    let code = result.unwrap_or_else(|error| {
        output::print_error(format_args!("error: {}\n", failure::sentence(&error)));
        ExitCode::from(if error.is::<ConfigError>() { MISUSED } else { FAILED })
    });
    match output::finish() {
        Ok(()) => code,
        Err(error) => {
            output::print_error(format_args!("error: cannot write to standard output: {error}\n"));
            ExitCode::from(FAILED)
        }
    }
}

fn give(task: Task, args: &TaskArgs) -> Result<ExitCode> {
    task::give(task, &args.task_file).map(|()| ExitCode::SUCCESS)
}

/// Disables the telemetry of ONNX Runtime, for privacy: the robot works in homes.
///
/// Since 1.29 the official builds of ONNX Runtime send telemetry to Microsoft as soon as they are
/// loaded, even if the API disables it. Only this environment variable, set before the program
/// starts, prevents that (<https://github.com/microsoft/onnxruntime/pull/27379>). A process cannot
/// set its own variables safely, so the program replaces itself with `exec`.
fn disable_onnx_runtime_telemetry() {
    const VARIABLE: &str = "ORT_DISABLE_TELEMETRY";
    if std::env::var_os(VARIABLE).is_none()
        && let Ok(program) = std::env::current_exe()
    {
        let mut args = std::env::args_os();
        let name = args.next().unwrap_or_default();
        let error = Command::new(program).arg0(name).args(args).env(VARIABLE, "1").exec();
        // Running with telemetry is better than not running. The systemd unit sets the variable, so
        // this cannot happen there.
        output::print_error(format_args!(
            "warning: cannot set {VARIABLE} ({error}): ONNX Runtime may send telemetry\n"
        ));
    }
}
