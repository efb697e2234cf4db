//! `cargo xtask accuracy`: the accuracy of depth on sequences with ground truth.

use anyhow::Result;

use crate::tables::{self, Table};
use crate::{command, onnx_runtime};

/// The scenes that are measured when the arguments name neither a scene nor a dataset.
const HOMES: [&str; 2] = ["builtin:apartment?seed=3", "builtin:office?seed=3"];
/// Handled here and not passed on: the table goes into docs/data/accuracy.json and docs/accuracy.md.
const UPDATE: &str = "--update";

pub fn run(arguments: &[String]) -> Result<()> {
    let mut accuracy = command::cargo();
    accuracy
        .args(["run", "--release", "--quiet", "--locked", "--package", "accuracy", "--"])
        .args(arguments.iter().filter(|argument| *argument != UPDATE));
    let names_input = arguments
        .iter()
        .any(|argument| argument.starts_with("--scene") || argument.starts_with("--dataset"));
    if !names_input {
        accuracy.args(HOMES.iter().flat_map(|home| ["--scene", home]));
    }
    let uses_network = ["--flow-model", "--depth-model"];
    if arguments.iter().any(|argument| uses_network.iter().any(|key| argument.starts_with(key))) {
        accuracy.env("ORT_DYLIB_PATH", onnx_runtime::install()?);
    }
    if !arguments.iter().any(|argument| argument == UPDATE) {
        return command::run(&mut accuracy);
    }
    let printed = command::output(&mut accuracy)?;
    print!("{printed}");
    let made_by = format!("cargo xtask accuracy {}", arguments.join(" "));
    tables::update("accuracy", "disturbed", &made_by, &Table::printed(&printed)?)
}
