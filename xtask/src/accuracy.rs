//! `cargo xtask accuracy`: how right depth is, on sequences with ground truth.

use anyhow::Result;

use crate::{command, onnx_runtime};

/// What is measured when nothing else is asked for.
const HOMES: [&str; 2] = ["builtin:apartment?seed=3", "builtin:office?seed=3"];

pub fn run(arguments: &[String]) -> Result<()> {
    let mut accuracy = command::cargo();
    accuracy
        .args(["run", "--release", "--quiet", "--locked", "--package", "accuracy", "--"])
        .args(arguments);
    let names_input = arguments
        .iter()
        .any(|argument| argument.starts_with("--scene") || argument.starts_with("--dataset"));
    if !names_input {
        accuracy.args(HOMES.iter().flat_map(|home| ["--scene", home]));
    }
    if arguments.iter().any(|argument| argument.starts_with("--flow-model")) {
        accuracy.env("ORT_DYLIB_PATH", onnx_runtime::install()?);
    }
    command::run(&mut accuracy)
}
