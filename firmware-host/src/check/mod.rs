//! `firmware-host check`: is this configuration sound, what is in effect, and how are the devices that it names?

mod devices;
mod nearby;

use std::process::ExitCode;

use anyhow::{Result, bail};
use comfy_table::{ContentArrangement, Table, presets::NOTHING};

use crate::cli::CheckArgs;
use crate::config::{Config, DEFAULT_FILE};
use crate::run::status::{STALE_S, Status, unix_s};
use devices::Finding;

/// Prints the effective configuration, or the documented defaults when there is no file; with `--devices`, how each device is.
///
/// # Errors
/// Everything that is wrong with the file.
pub fn run(args: &CheckArgs) -> Result<ExitCode> {
    let Some(path) = &args.config else {
        print!("{DEFAULT_FILE}");
        return Ok(ExitCode::SUCCESS);
    };
    let config = Config::load(path)?;
    if !args.devices {
        print!("# {} is sound. In effect:\n\n{}", path.display(), config.to_toml()?);
        return Ok(ExitCode::SUCCESS);
    }
    config.check_devices(path)?;
    refuse_beside_a_running_robot(&config)?;
    let findings = devices::look(&config);
    println!("{} is sound. What is connected:\n\n{}", path.display(), screen(&findings));
    Ok(if findings.iter().all(|finding| finding.is_well) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Setting a motor up again while another program drives it would take the wheels from under that one.
fn refuse_beside_a_running_robot(config: &Config) -> Result<()> {
    if let Ok(status) = Status::read(config.run.status_file.as_ref())
        && unix_s() - status.written_unix_s < STALE_S
    {
        bail!(
            "`firmware-host run` (pid {}) uses these devices: `firmware-host health --status {}` shows how they are; to check \
             them, end it first (`systemctl stop embodied-depth`)",
            status.pid,
            config.run.status_file
        );
    }
    Ok(())
}

fn screen(findings: &[Finding]) -> String {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["device", "path", "state", "what it is"]);
    for finding in findings {
        table.add_row([finding.device, &finding.path, &finding.state, &finding.what]);
    }
    let mut text = table.to_string();
    for finding in findings.iter().filter(|finding| !finding.to_do.is_empty()) {
        text += "\n";
        let mark = if finding.is_well { ' ' } else { '!' };
        for line in &finding.to_do {
            // Some drivers name their device themselves.
            let line = line.strip_prefix(finding.device).map_or(line.as_str(), str::trim_start);
            text += &format!("\n  {mark} {}: {line}", finding.device);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_screen_has_a_row_for_each_device_and_below_it_what_to_do() {
        let finding = |device, is_well, to_do: &[&str]| Finding {
            device,
            path: "/dev/x".to_owned(),
            is_well,
            state: "working".to_owned(),
            what: "UTM-30LX".to_owned(),
            to_do: to_do.iter().map(ToString::to_string).collect(),
        };
        let text = screen(&[finding("LiDAR", true, &[]), finding("base", false, &["plug it in"])]);
        assert!(
            text.lines().nth(1).unwrap().contains("LiDAR") && text.contains("UTM-30LX"),
            "{text}"
        );
        assert!(text.ends_with("  ! base: plug it in"), "{text}");
    }

    #[test]
    fn a_robot_that_runs_is_left_alone_and_one_that_ended_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("status.json");
        let mut config = Config::default();
        config.run.status_file = file.to_str().unwrap().to_owned();
        refuse_beside_a_running_robot(&config).unwrap();
        Status { written_unix_s: unix_s(), pid: 77, ..Status::default() }.write(&file).unwrap();
        let said = refuse_beside_a_running_robot(&config).unwrap_err().to_string();
        assert!(said.contains("pid 77") && said.contains("systemctl stop"), "{said}");
        Status { written_unix_s: unix_s() - 60.0, ..Status::default() }.write(&file).unwrap();
        refuse_beside_a_running_robot(&config).unwrap();
    }
}
