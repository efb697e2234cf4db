//! Reads the scenarios in tests/rig/scenarios.

use anyhow::{Context, Result, bail};

use crate::paths;

/// One scenario and its requirements.
#[derive(Debug, Clone)]
pub struct Scenario {
    pub name: String,
    pub title: String,
    pub kernel: Kernel,
    /// Virtual time: an instruction takes two to this power nanoseconds. `None`: real time.
    pub icount: Option<u8>,
    pub modules: Vec<String>,
    /// Whether systemd is the guest's first process and runs the scenario.
    pub systemd: bool,
    pub seconds: u64,
    pub disk_mb: Option<u64>,
    pub long: bool,
    pub body: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kernel {
    Std,
    Rt,
}

impl Kernel {
    pub const ALL: [Self; 2] = [Self::Std, Self::Rt];

    pub fn name(self) -> &'static str {
        match self {
            Self::Std => "std",
            Self::Rt => "rt",
        }
    }

    /// Debian's package that depends on the newest kernel of this kind.
    pub fn package(self) -> &'static str {
        match self {
            Self::Std => "linux-image-amd64",
            Self::Rt => "linux-image-rt-amd64",
        }
    }
}

/// All scenarios, sorted by name.
pub fn all() -> Result<Vec<Scenario>> {
    let folder = paths::root().join("tests/rig/scenarios");
    let mut scenarios = Vec::new();
    for entry in
        std::fs::read_dir(&folder).with_context(|| format!("reading {}", folder.display()))?
    {
        let path = entry?.path();
        let Some(name) = path.file_stem().and_then(|name| name.to_str()) else { continue };
        if path.extension().is_some_and(|extension| extension == "sh") {
            let body = std::fs::read_to_string(&path)?;
            scenarios.push(parse(name, body).with_context(|| format!("in {}", path.display()))?);
        }
    }
    scenarios.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(scenarios)
}

fn parse(name: &str, body: String) -> Result<Scenario> {
    let mut scenario = Scenario {
        name: name.to_owned(),
        title: name.to_owned(),
        kernel: Kernel::Std,
        icount: None,
        modules: ["can", "video", "serial"].map(str::to_owned).to_vec(),
        systemd: false,
        seconds: 60,
        disk_mb: None,
        long: false,
        body: String::new(),
    };
    for line in body.lines().filter_map(|line| line.strip_prefix("#:")) {
        let (key, value) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        let value = value.trim();
        match key {
            "title" => value.clone_into(&mut scenario.title),
            "kernel" => {
                let found = Kernel::ALL.into_iter().find(|kernel| kernel.name() == value);
                scenario.kernel = found.with_context(|| format!("`kernel {value}`: std or rt"))?;
            }
            "icount" => {
                scenario.icount = Some(value.parse().with_context(|| format!("`icount {value}`"))?);
            }
            "modules" => scenario.modules = value.split_whitespace().map(str::to_owned).collect(),
            "seconds" => {
                scenario.seconds = value.parse().with_context(|| format!("`seconds {value}`"))?;
            }
            "disk" => {
                scenario.disk_mb = Some(value.parse().with_context(|| format!("`disk {value}`"))?);
            }
            "systemd" => scenario.systemd = true,
            "long" => scenario.long = true,
            _ => bail!("the key `#: {key}` is unknown; tests/rig/README.md lists the keys"),
        }
    }
    scenario.body = body;
    Ok(scenario)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scenario_says_what_machine_it_needs_and_a_line_that_is_not_known_is_refused() {
        let scenario =
            parse("loop", "#: kernel rt\n#: icount 1\n#: modules can\n#: long\ntrue\n".to_owned())
                .unwrap();
        assert_eq!((scenario.kernel, scenario.icount, scenario.long), (Kernel::Rt, Some(1), true));
        assert_eq!((scenario.modules, scenario.seconds), (vec!["can".to_owned()], 60));
        assert!(
            parse("loop", "#: kernal rt\n".to_owned()).unwrap_err().to_string().contains("kernal")
        );
    }

    #[test]
    fn every_scenario_of_the_project_can_be_read() {
        assert!(!all().unwrap().is_empty());
    }
}
