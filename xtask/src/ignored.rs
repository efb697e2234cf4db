//! Ignored tests that need what neither this repository has nor a chore installs. They run where it is there, and are reported as
//! skipped elsewhere, so that no test passes without having done anything.

use std::process::Command;

use crate::test::{Outcome, Step, step};
use crate::{command, paths};

/// The names under which Debian and others install Chromium, as in `firmware-host/tests/live/devtools.rs`.
const BROWSERS: [&str; 4] =
    ["chromium-headless-shell", "chromium", "chromium-browser", "google-chrome"];

/// Tests with the same need.
struct Needing {
    step: &'static str,
    /// Their filter for nextest, without spaces.
    filter: &'static str,
    /// A text in their names, for `cargo test`.
    name: &'static str,
    is_there: fn() -> bool,
    /// What is missing, and how it gets there.
    missing: &'static str,
    /// Whether it is installed in CI (`.ci/run`).
    is_in_ci: bool,
}

const ALL: [Needing; 2] = [
    Needing {
        step: "tests in a browser",
        filter: "binary(live)&test(browser::)-test(screenshots_for_the_documentation)",
        name: "browser::",
        is_there: || {
            BROWSERS.iter().any(|name| command::works(command::program(name).arg("--version")))
        },
        missing: "chromium is missing: `apt-get install chromium-headless-shell`",
        is_in_ci: true,
    },
    Needing {
        step: "tests of the shared scenes",
        filter: "test(shared_scenes)",
        name: "shared_scenes",
        is_there: || {
            is_set("EMBODIED_DEPTH_DATA") || paths::root().join("../shared/data/scenes").is_dir()
        },
        missing: "they are not part of the project; EMBODIED_DEPTH_DATA names the folder that holds `scenes`",
        is_in_ci: false,
    },
];

fn is_set(variable: &str) -> bool {
    std::env::var_os(variable).is_some()
}

/// Arguments by which `cargo test -- --ignored` leaves all of these tests out.
pub fn skipped() -> String {
    ALL.map(|needing| format!("--skip {}", needing.name)).join(" ")
}

/// A step for each need. `tested` is what is built for all steps.
pub fn steps(
    cargo: &dyn Fn(&str) -> Command,
    tested: &str,
    has_nextest: bool,
    ci: bool,
) -> Vec<Step> {
    ALL.iter().map(|needing| (needing.step, run(needing, cargo, tested, has_nextest, ci))).collect()
}

fn run(
    needing: &Needing,
    cargo: &dyn Fn(&str) -> Command,
    tested: &str,
    has_nextest: bool,
    ci: bool,
) -> (Outcome, f64) {
    if !(needing.is_there)() {
        if ci && needing.is_in_ci {
            eprintln!("{}: {}", needing.step, needing.missing);
            return (Outcome::Failed, 0.0);
        }
        return (Outcome::Skipped(needing.missing), 0.0);
    }
    let Needing { filter, name, .. } = needing;
    step(&mut cargo(&match has_nextest {
        true => format!("nextest run {tested} --run-ignored only -E {filter}"),
        false => format!("test {tested} --tests -- --ignored {name} --skip screenshots"),
    }))
}
