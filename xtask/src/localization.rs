//! `cargo xtask localization`: errors of localization along real logs.

use anyhow::Result;

use crate::command;
use crate::tables::{self, Table};

/// Runs all logs in release, and writes the table to the documents if `update`.
pub fn run(update: bool) -> Result<()> {
    let mut localization = command::cargo();
    localization.args(["run", "--release", "--quiet", "--locked", "--package", "localization"]);
    if !update {
        return command::run(&mut localization);
    }
    let printed = command::output(&mut localization)?;
    print!("{printed}");
    let made_by = "cargo xtask localization --update";
    tables::update("localization", "logs", made_by, &Table::printed(&printed)?)
}
