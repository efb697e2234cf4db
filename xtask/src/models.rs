//! `cargo xtask models`: exports the networks that the benchmarks measure, with the trainer.

use std::path::PathBuf;

use anyhow::Result;

use crate::{command, paths, trainer};

/// File names of the networks, and the trainer's arguments that export them. Their weights are random, because inference
/// takes as long as with trained ones.
const MODELS: [(&str, &[&str]); 4] = [
    ("monodepth2_r18", &["export-depth", "--network", "monodepth2_r18", "--random"]),
    ("edn_r18", &["export-depth", "--network", "edn_r18", "--random"]),
    ("raft_small_12", &["export-flow", "--network", "raft_small", "--random"]),
    ("raft_large_12", &["export-flow", "--network", "raft_large", "--random"]),
];

/// The folder with the exported networks.
pub fn folder() -> PathBuf {
    paths::target().join("models")
}

/// Exports every network that is missing. The first time, PyTorch (5 GB) is installed into the target directory.
///
/// # Errors
/// When the trainer cannot be installed or an export fails.
pub fn run() -> Result<()> {
    let missing = MODELS.iter().filter(|(name, _)| !file(name).is_file()).collect::<Vec<_>>();
    if missing.is_empty() {
        println!("all networks are in {}", folder().display());
        return Ok(());
    }
    let python = trainer::install()?;
    for (name, arguments) in missing {
        let mut export = command::program(&python);
        export.args(["-m", "embodied_depth_trainer"]).args(*arguments);
        command::run(export.arg("--out").arg(file(name)))?;
    }
    Ok(())
}

fn file(name: &str) -> PathBuf {
    folder().join(name).with_extension("onnx")
}
