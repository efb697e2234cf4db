//! `cargo xtask rig`: tests the drivers with a real kernel's devices in a virtual machine; see tests/rig/README.md.

mod boot;
mod scenario;
mod setup;
mod table;

use std::time::Instant;

use anyhow::{Context, Result, bail};

use crate::dist::{Arch, package};
use crate::{command, paths, test};
use boot::Machine;
use scenario::Scenario;
use table::Row;

pub fn run(all: bool, filter: Option<&str>) -> Result<()> {
    let chosen: Vec<Scenario> = scenario::all()?
        .into_iter()
        .filter(|scenario| {
            filter.map_or(all || !scenario.long, |part| scenario.name.contains(part))
        })
        .collect();
    if chosen.is_empty() {
        bail!(
            "no scenario's name contains `{}`; the scenarios are in tests/rig/scenarios",
            filter.unwrap_or_default()
        );
    }
    for place in ["/tmp", "/run", "/dev"] {
        if paths::target().starts_with(place) {
            bail!(
                "the guest has its own {place} and would not see this checkout; move it elsewhere"
            );
        }
    }
    let start = Instant::now();
    setup::install()?;
    let programs = build(&chosen)?;
    let built = start.elapsed().as_secs_f64();
    let mut rows: Vec<Row> = Vec::new();
    for machine in Machine::for_scenarios(&chosen) {
        rows.extend(boot::run(&machine, &programs)?);
    }
    table::print(&rows);
    let failed = rows.iter().filter(|row| !row.passed).count();
    println!(
        "\n{} checks, {failed} failed; {:.0} s, of it {built:.0} s of setup and building",
        rows.len(),
        start.elapsed().as_secs_f64()
    );
    if failed > 0 {
        bail!("the rig's logs are in {}", paths::target().join("rig/run").display());
    }
    Ok(())
}

/// Builds the programs that the scenarios run. Returns their names and paths in the guest.
fn build(scenarios: &[Scenario]) -> Result<Vec<(&'static str, String)>> {
    let uses_package = uses("$PACKAGE", scenarios);
    let mut programs = vec![("HIL", "hil")];
    if uses_package || uses("$FIRMWARE", scenarios) {
        programs.push(("FIRMWARE", "firmware-host"));
    }
    let mut cargo = test::cargo_build()?;
    cargo.arg("--quiet");
    for (_, program) in &programs {
        cargo.args(["--bin", program]);
    }
    if uses_package {
        cargo.args(package::PROGRAMS.iter().flat_map(|program| ["--bin", program]));
    }
    command::run(&mut cargo)?;
    let folder = paths::target().join("debug");
    let mut found: Vec<_> =
        programs.into_iter().map(|(variable, name)| (variable, folder.join(name))).collect();
    if uses_package {
        let packages = paths::target().join("rig/package");
        found.push(("PACKAGE", package::make(Arch::of_this_computer(), &folder, &packages)?));
    }
    let mut texts = Vec::new();
    for (variable, path) in found {
        let text = path.to_str().context("the checkout's path is not UTF-8")?;
        texts.push((variable, text.to_owned()));
    }
    Ok(texts)
}

fn uses(variable: &str, scenarios: &[Scenario]) -> bool {
    scenarios.iter().any(|scenario| scenario.body.contains(variable))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn read_sources(folder: &Path, into: &mut String) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                read_sources(&path, into);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                *into += &std::fs::read_to_string(&path).unwrap();
            }
        }
    }

    #[test]
    fn every_test_and_scenario_that_the_table_of_faults_names_is_there() {
        let table = std::fs::read_to_string(paths::root().join("docs/faults.md")).unwrap();
        let mut sources = String::new();
        for folder in ["tests", "firmware-host", "runtime", "drivers"] {
            read_sources(&paths::root().join(folder), &mut sources);
        }
        let scenarios = scenario::all().unwrap();
        let mut named = 0;
        for row in
            table.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| what fails"))
        {
            let [_, _, _, _, simulated, rig, _] = row.split('|').collect::<Vec<_>>()[..] else {
                continue;
            };
            for name in simulated.split('`').skip(1).step_by(2) {
                // A part of a test's name, which may match several tests.
                let part = name.rsplit("::").next().unwrap().trim_matches(['.', '*']);
                let text = if part == name || name.contains("::") && !name.ends_with('*') {
                    format!("fn {part}(")
                } else {
                    part.to_owned()
                };
                assert!(sources.contains(&text), "{name}");
                named += 1;
            }
            let rig = rig.split(',').next().unwrap().trim();
            assert!(
                rig.is_empty() || scenarios.iter().any(|scenario| scenario.name == rig),
                "{rig}"
            );
        }
        assert!(named > 40, "{named}");
    }
}
