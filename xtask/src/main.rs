//! The project's chores. `cargo xtask demo` shows it, `cargo xtask test` proves it, `cargo xtask bench` measures it; each
//! installs what it needs for itself into the target directory.
#![forbid(unsafe_code)]

mod accuracy;
mod bench;
mod command;
mod coverage;
mod data_loop;
mod demo;
mod dist;
mod docs;
mod fuzz;
mod licences;
mod models;
mod mutants;
mod nextest;
mod onnx_runtime;
mod paths;
mod peers;
mod policies;
mod python;
mod quality;
mod rig;
mod safety_alone;
mod test;
mod trainer;
mod words;

use std::process::ExitCode;

use clap::Parser;

/// The project's chores.
#[derive(Parser)]
#[command(name = "cargo xtask", version)]
enum Chore {
    /// Explore a built-in home and show depth, map, path and recording.
    Demo,
    /// The whole loop on this computer: a simulated robot, ssh, pull-buffer, the trainer, push-model, the robot's gate. Installs
    /// PyTorch (5 GB) the first time; takes about a quarter of an hour.
    Loop,
    /// Format, lints, every test, licences.
    Test {
        /// The trainer as well, also where PyTorch (5 GB) must be installed for it (CI always does), and 200 kills instead of 6
        /// in every test that kills programs.
        #[arg(long)]
        all: bool,
    },
    /// The benchmark table.
    Bench {
        /// Print JSON instead of a table.
        #[arg(long)]
        json: bool,
        /// A room's name, or a part of the name of a row.
        filter: Option<String>,
    },
    /// How right depth is, with and without disturbances; `cargo xtask accuracy --help` shows what else it can measure.
    #[command(disable_help_flag = true)]
    Accuracy {
        /// Passed on.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Every policy on the built-in homes, as a table. Takes an hour on two cores.
    Policies {
        /// Camera frames of each run.
        #[arg(long, default_value_t = 3000)]
        frames: u64,
        /// Seeds of each home.
        #[arg(long, default_value_t = 2)]
        seeds: u64,
    },
    /// Depth, map and touches in four homes against the committed figures. Two minutes on two cores.
    Quality {
        /// Write the figures to docs/data/quality.json instead of comparing with them.
        #[arg(long)]
        update: bool,
    },
    /// The documentation as a site in target/book. Installs mdBook the first time.
    Docs,
    /// Export the networks that the benchmark times, with the trainer. Installs PyTorch (5 GB) the first time.
    Models,
    /// The drivers against a real kernel's devices, in a virtual machine. The first time it installs QEMU by apt.
    Rig {
        /// The long scenarios as well.
        #[arg(long)]
        all: bool,
        /// A part of the names of scenarios.
        filter: Option<String>,
    },
    /// The Debian package for the robot's computer, in target/dist, tried out as far as that is possible here.
    Dist {
        /// For which computers [default: those like this one]. aarch64 on a PC installs Debian's cross toolchain by apt.
        #[arg(long, value_enum)]
        target: Option<dist::Arch>,
    },
    /// Whatever reads bytes from outside, with all sorts of bytes. Builds our crates once more the first time.
    Fuzz {
        /// For each target.
        #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
        seconds: u64,
        /// Afterwards put inputs that reach new code into the committed corpora, made as small as that allows.
        #[arg(long)]
        keep: bool,
        /// Targets [default: all].
        targets: Vec<String>,
    },
    /// Every mutant of the safety plane against its own tests. Takes an hour on one core.
    #[command(disable_help_flag = true)]
    Mutants {
        /// Passed on to `cargo mutants`.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Which lines and branches of the safety plane its own tests reach. Needs LLVM's tools of the compiler's version.
    Coverage,
    /// Install what the other chores need, and nothing else.
    Setup,
}

fn main() -> ExitCode {
    if let Some(code) = fuzz::as_wrapper() {
        return code;
    }
    match run(&Chore::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(chore: &Chore) -> anyhow::Result<()> {
    match chore {
        Chore::Demo => demo::run(),
        Chore::Loop => data_loop::run(),
        Chore::Test { all } => test::run(*all),
        Chore::Bench { json, filter } => bench::run(*json, filter.as_deref()),
        Chore::Accuracy { arguments } => accuracy::run(arguments),
        Chore::Policies { frames, seeds } => policies::run(*frames, *seeds),
        Chore::Quality { update } => quality::build_and_run(*update),
        Chore::Docs => docs::run(),
        Chore::Models => models::run(),
        Chore::Fuzz { seconds, keep, targets } => fuzz::run(*seconds, *keep, targets),
        Chore::Coverage => coverage::run(),
        Chore::Mutants { arguments } => mutants::run(arguments),
        Chore::Rig { all, filter } => rig::run(*all, filter.as_deref()),
        Chore::Dist { target } => dist::run(*target),
        Chore::Setup => {
            println!("ONNX Runtime: {}", onnx_runtime::install()?.display());
            println!(
                "test runner:  {}",
                if nextest::install() { "cargo nextest" } else { "cargo test" }
            );
            Ok(())
        }
    }
}
