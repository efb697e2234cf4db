//! `cargo xtask localization`: errors of localization along real logs, and along drives in simulated homes.

use anyhow::Result;

use crate::tables::{self, Table};
use crate::{command, peers};

/// Runs all logs in release, or with `drives` the drives in simulated homes. Writes the table to the documents if `update`.
pub fn run(drives: bool, update: bool) -> Result<()> {
    let mut localization = command::cargo();
    localization.args(["run", "--release", "--quiet", "--locked", "--package", "localization"]);
    if drives {
        localization.args(["--", "--drives"]);
        match peers::of_benchmarks() {
            Ok(packages) => {
                localization.env("LOCALIZATION_PYTHON", "python3").env("PYTHONPATH", packages);
            }
            Err(error) => eprintln!("KISS-ICP is not measured: {error:#}"),
        }
    }
    if !update {
        return command::run(&mut localization);
    }
    let printed = command::output(&mut localization)?;
    print!("{printed}");
    let (table, made_by) = match drives {
        true => ("drives", "cargo xtask localization --drives --update"),
        false => ("logs", "cargo xtask localization --update"),
    };
    tables::update("localization", table, made_by, &Table::printed(&printed)?)
}
