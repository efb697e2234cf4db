//! The project's chores, such as `cargo xtask demo`, `cargo xtask test` and `cargo xtask bench`. Each installs the tools that
//! it needs into the target directory.
#![forbid(unsafe_code)]

mod accuracy;
mod arrows;
mod bench;
mod calibrated_depth;
mod calibration;
mod command;
mod contributing;
mod coverage;
mod data_loop;
mod demo;
mod dist;
mod docs;
mod explore;
mod fuzz;
mod ignored;
mod licences;
mod live;
mod localization;
mod memory_folder;
mod models;
mod mutants;
mod nextest;
mod odometry;
mod onnx_runtime;
mod paths;
mod peers;
mod policies;
mod python;
mod quality;
mod real_time;
mod rig;
mod safety_alone;
mod shards;
mod stairs;
mod tables;
mod test;
mod trainer;
mod words;

use std::process::ExitCode;

use clap::Parser;

/// The project's chores.
#[derive(Parser)]
#[command(name = "cargo xtask", version)]
enum Chore {
    /// Explore a simulated home and write depth and map as images, a summary and a recording.
    Demo,
    /// Let a simulated robot explore in real time, and serve its live view to browsers and Foxglove until Ctrl-C.
    Live {
        /// Make the images of docs/live-view.md instead. Needs Chromium.
        #[arg(long)]
        screenshots: bool,
    },
    /// Run the whole data loop on this computer: a simulated robot records, pull-buffer copies over ssh, the trainer trains,
    /// push-model sends the network back, and the robot's gate judges it. Takes about 15 minutes; the first time it installs
    /// PyTorch (5 GB).
    Loop,
    /// Check format and lints, and run all tests and the quality gate.
    Test {
        /// Also check licences, the documentation site and other people's software, install PyTorch (5 GB) for the trainer's
        /// tests if it is missing, and kill programs 200 times instead of 6 in the tests that do so.
        #[arg(long)]
        all: bool,
    },
    /// Measure speed, beside other implementations of the same work.
    Bench {
        /// Print JSON instead of a table.
        #[arg(long)]
        json: bool,
        /// Write the table to docs/data/bench.json and docs/benchmarks.md; with `shards`, to docs/data/shards.json and
        /// docs/shards.md.
        #[arg(long, conflicts_with = "json")]
        update: bool,
        /// Name of an area, such as `mapping`, or a part of a row's name; or `shards`: how the trainer reads, which has a table of
        /// its own.
        filter: Option<String>,
    },
    /// Measure the accuracy of depth, with and without disturbances. `cargo xtask accuracy --help` lists the options;
    /// `--update` writes the table to docs/data/accuracy.json and docs/accuracy.md.
    #[command(disable_help_flag = true)]
    Accuracy {
        /// Options of the accuracy tool.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Localize along real logs of other robots, and print the errors against ground truth. The logs are not part of the project:
    /// without `../shared/data/lidar` it says so and does nothing.
    Localization {
        /// Instead of the logs: errors and costs of drives in simulated homes, beside KISS-ICP. Takes half an hour.
        #[arg(long)]
        drives: bool,
        /// Write the table to docs/data/localization.json and docs/localization.md.
        #[arg(long)]
        update: bool,
    },
    /// Drive simulated robots whose configuration is wrong, calibrate them, and print the errors. Takes half an hour.
    Calibration {
        /// Instead: compare depth and map of the robots before and after their calibration.
        #[arg(long)]
        depth: bool,
        /// Number of robots.
        #[arg(long, default_value_t = 30)]
        robots: u64,
        /// Write the tables to docs/data/calibration.json and docs/calibration.md.
        #[arg(long)]
        update: bool,
    },
    /// Explore the built-in homes with every policy, with the errors of real odometry, and print tables. Takes an hour on two cores.
    Policies {
        /// Number of camera frames of each run.
        #[arg(long, default_value_t = 3000)]
        frames: u64,
        /// Number of seeds of each home.
        #[arg(long, default_value_t = 2)]
        seeds: u64,
        /// Write the table to docs/data/policies.json and docs/policies.md.
        #[arg(long)]
        update: bool,
    },
    /// Explore 20 homes with stairs down with the default camera mount, and ten of them with the paper's level one, and print how often the
    /// robot came near an edge. Takes 25 minutes on two cores.
    Stairs {
        /// Number of camera frames of each run.
        #[arg(long, default_value_t = 3000)]
        frames: u64,
        /// Write the table to docs/data/stairs.json and docs/faults.md.
        #[arg(long)]
        update: bool,
    },
    /// Write the tables of README and docs again after a file in docs/data was changed by hand. Chores with --update do it themselves.
    Tables,
    /// Explore homes with the errors of real odometry (also with the default network), with wheels alone and without errors, and
    /// print a table. Takes an hour on two cores.
    Odometry {
        /// Number of camera frames of each run.
        #[arg(long, default_value_t = 1500)]
        frames: u64,
        /// Number of seeds of each home.
        #[arg(long, default_value_t = 2)]
        seeds: u64,
        /// Further scene files, beside the built-in homes.
        #[arg(long)]
        scene: Vec<String>,
        /// Write the table to docs/data/odometry.json and docs/accuracy.md.
        #[arg(long)]
        update: bool,
    },
    /// Explore four homes and compare depth, map and touches with the committed figures. The drives take about a minute on two cores.
    Quality {
        /// Write the figures to docs/data/quality.json instead of comparing with them.
        #[arg(long)]
        update: bool,
    },
    /// Check the links of the documentation and build it as a site in target/book. The first time it installs mdBook.
    Docs,
    /// Export the networks that the benchmarks measure. The first time it installs PyTorch (5 GB).
    Models,
    /// Test the drivers with a real kernel's devices in a virtual machine. The first time it installs QEMU with apt.
    Rig {
        /// Also run the long scenarios.
        #[arg(long)]
        all: bool,
        /// Run only the scenarios whose names contain this.
        filter: Option<String>,
    },
    /// Build the Debian package for the robot's computer in target/dist, and try its content on this computer.
    Dist {
        /// Architecture of the robot's computer [default: this computer's]. aarch64 on a PC installs Debian's cross toolchain
        /// with apt.
        #[arg(long, value_enum)]
        target: Option<dist::Arch>,
    },
    /// Fuzz everything that reads bytes from outside. The first time it builds the project's crates once more.
    Fuzz {
        /// Time for each target, seconds.
        #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
        seconds: u64,
        /// Afterwards add the inputs that reach new code to the committed corpora, and minimize these.
        #[arg(long)]
        keep: bool,
        /// Names of the targets [default: all].
        targets: Vec<String>,
    },
    /// Check that the safety plane's tests detect every mutant of its code. Takes several hours.
    Mutants {
        /// Options of `cargo mutants`, such as `--shard 0/20`; `cargo mutants --help` lists them.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// List the lines and branches of the safety plane that its own tests do not reach. Needs LLVM's tools of the compiler's
    /// version.
    Coverage,
    /// Install the tools that the other chores need.
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
        Chore::Live { screenshots: false } => live::run(),
        Chore::Live { screenshots: true } => live::screenshots(),
        Chore::Loop => data_loop::run(),
        Chore::Test { all } => test::run(*all),
        Chore::Bench { json, update, filter } => bench::run(*json, *update, filter.as_deref()),
        Chore::Accuracy { arguments } => accuracy::run(arguments),
        Chore::Localization { drives, update } => localization::run(*drives, *update),
        Chore::Calibration { depth: true, robots, update } => {
            calibrated_depth::run(*robots, *update)
        }
        Chore::Calibration { depth: false, robots, update } => calibration::run(*robots, *update),
        Chore::Policies { frames, seeds, update } => policies::run(*frames, *seeds, *update),
        Chore::Stairs { frames, update } => stairs::run(*frames, *update),
        Chore::Odometry { frames, seeds, scene, update } => {
            odometry::run(*frames, *seeds, scene, *update)
        }
        Chore::Quality { update } => quality::build_and_run(*update),
        Chore::Tables => tables::write_documents(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::error::ErrorKind;

    #[test]
    fn help_about_mutants_runs_no_mutants_and_their_options_are_passed_on() {
        let help = Chore::try_parse_from(["xtask", "mutants", "--help"]).err();
        assert_eq!(help.map(|error| error.kind()), Some(ErrorKind::DisplayHelp));
        let chore = Chore::try_parse_from(["xtask", "mutants", "--shard", "0/20"]);
        assert!(
            matches!(chore, Ok(Chore::Mutants { arguments }) if arguments == ["--shard", "0/20"])
        );
    }
}
