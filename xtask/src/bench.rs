//! `cargo xtask bench`: builds the benchmarks in release and runs them.

use anyhow::{Result, ensure};

use crate::tables::{self, Table};
use crate::{command, models, onnx_runtime, paths, peers, shards, trainer};

/// Runs the benchmarks. With `update`, the table goes into docs/data/bench.json and
/// docs/benchmarks.md.
pub fn run(json: bool, update: bool, filter: Option<&str>) -> Result<()> {
    if filter == Some("shards") {
        ensure!(!json, "`cargo xtask bench shards` prints a table only; omit --json");
        return shards::run(update);
    }
    ensure!(!update || filter.is_none(), "--update writes the whole table; omit the filter");
    let mut bench = command::cargo();
    bench.args(["run", "--release", "--quiet", "--locked", "--package", "bench", "--"]);
    if json {
        bench.arg("--json");
    }
    bench.args(filter);
    match onnx_runtime::install() {
        Ok(library) => _ = bench.env("ORT_DYLIB_PATH", library),
        Err(error) => eprintln!("the depth network is not measured: {error}"),
    }
    // Networks that `cargo xtask models` has exported. Without them, their rows are missing.
    if models::folder().is_dir() && std::env::var_os("BENCH_MODELS").is_none() {
        bench.env("BENCH_MODELS", models::folder());
    }
    match peers::of_benchmarks() {
        Ok(packages) => _ = bench.env("BENCH_PYTHON", "python3").env("PYTHONPATH", packages),
        Err(error) => eprintln!("the peers in Python are not measured: {error:#}"),
    }
    // Programs that are measured as a whole, over ssh.
    let programs = ["--package=firmware-host", "--package=pull-buffer"];
    command::run(
        command::cargo().args(["build", "--release", "--quiet", "--locked"]).args(programs),
    )?;
    bench.env("BENCH_PROGRAMS", paths::target().join("release"));
    // PyTorch takes 5 GB, so it is installed on demand only.
    if filter == Some("trainer") || trainer::is_installed() {
        bench.env("BENCH_TRAINER", trainer::install()?);
    } else {
        eprintln!("the trainer is not measured: `cargo xtask bench trainer` installs it");
    }
    if !update {
        return command::run(&mut bench);
    }
    let printed = command::output(&mut bench)?;
    print!("{printed}");
    tables::update("bench", "speed", "cargo xtask bench --update", &Table::printed(&printed)?)
}
