//! `cargo xtask bench`: builds the benchmarks as they will be deployed and runs them.

use anyhow::Result;

use crate::{command, models, onnx_runtime, paths, peers, trainer};

pub fn run(json: bool, filter: Option<&str>) -> Result<()> {
    let mut bench = command::cargo();
    bench.args(["run", "--release", "--quiet", "--locked", "--package", "bench", "--"]);
    if json {
        bench.arg("--json");
    }
    bench.args(filter);
    match onnx_runtime::install() {
        Ok(library) => _ = bench.env("ORT_DYLIB_PATH", library),
        Err(error) => eprintln!("no rows of the network: {error}"),
    }
    // `cargo xtask models` makes them; without them their rows are absent.
    if models::folder().is_dir() && std::env::var_os("BENCH_MODELS").is_none() {
        bench.env("BENCH_MODELS", models::folder());
    }
    match peers::of_benchmarks() {
        Ok(packages) => _ = bench.env("BENCH_PYTHON", "python3").env("PYTHONPATH", packages),
        Err(error) => eprintln!("no peers in Python: {error:#}"),
    }
    // What is measured as a program, over ssh.
    let programs = ["--package=firmware-host", "--package=pull-buffer"];
    command::run(
        command::cargo().args(["build", "--release", "--quiet", "--locked"]).args(programs),
    )?;
    bench.env("BENCH_PROGRAMS", paths::target().join("release"));
    // PyTorch is large: only who asks for its room gets it installed.
    if filter == Some("trainer") || trainer::is_installed() {
        bench.env("BENCH_TRAINER", trainer::install()?);
    } else {
        eprintln!("no rows of the trainer: `cargo xtask bench trainer` installs it");
    }
    command::run(&mut bench)
}
