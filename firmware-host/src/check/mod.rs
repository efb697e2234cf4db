//! `firmware-host check`: checks a configuration file, prints the effective values, and tests the devices that it names.

mod devices;
mod drive;
mod imu;
pub(crate) mod nearby;
mod speed;
mod view;

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Result, bail};
use comfy_table::{ContentArrangement, Table, presets::NOTHING};

use crate::cli::CheckArgs;
use crate::config::{Config, DEFAULT_FILE};
use crate::report::fit;
use crate::run::status::{STALE_S, Status, unix_s};
use devices::Finding;
pub use drive::{confirm, require};
pub use speed::Speed;
use view::View;

/// Prints the effective configuration, or the commented defaults if there is no file. With `--devices` it prints the state of
/// each device instead.
///
/// # Errors
/// All problems of the file.
pub fn run(args: &CheckArgs) -> Result<ExitCode> {
    let Some(path) = &args.config else {
        print!("{DEFAULT_FILE}");
        return Ok(ExitCode::SUCCESS);
    };
    let config = Config::load(path)?;
    let real_robot = config.check_devices(path);
    if !args.devices && !args.drive {
        // A file without devices is for `explore`, which does not use them.
        let remark = match real_robot {
            Ok(()) => drive::require(&config, path)
                .err()
                .map_or_else(String::new, |refused| format!(" `run` refuses to start: {refused}.")),
            Err(_) if !names_devices(path)? => {
                " It is for `explore`: `run` needs a section [devices].".to_owned()
            }
            Err(error) => return Err(error.into()),
        };
        print!(
            "# {} is valid.{remark}\n{}\n# Effective configuration:\n\n{}",
            path.display(),
            comments(&config),
            config.to_toml()?
        );
        return Ok(ExitCode::SUCCESS);
    }
    real_robot?;
    refuse_beside_a_running_robot(&config)?;
    if args.drive {
        return drive::run(&config, path, args.yes);
    }
    let findings = devices::test_all(&config);
    let columns = fit::columns();
    println!("{} is valid. Devices:\n\n{}", path.display(), screen(&findings, columns));
    for sentence in View::new(&config).sentences() {
        println!("{}", fit::text(&format!("    view: {sentence}"), columns));
    }
    let speed = format!("    speed: {}", Speed::new(&config).sentence());
    println!("{}", fit::text(&speed, columns));
    Ok(if findings.iter().all(|finding| finding.is_usable) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Whether the file has a section about the devices of a real robot.
fn names_devices(path: &Path) -> Result<bool> {
    let table: toml::Table = std::fs::read_to_string(path)?.parse()?;
    Ok(table.contains_key("devices"))
}

/// What is not seen and how fast the robot may drive, as comments of a configuration file.
fn comments(config: &Config) -> String {
    let view = View::new(config).sentences();
    let view = view.into_iter().map(|sentence| format!("# View: {sentence}."));
    let speed = format!("# Speed: {}.", Speed::new(config).sentence());
    view.chain(std::iter::once(speed)).collect::<Vec<_>>().join("\n")
}

/// Initializing a motor that another program drives would disturb that program.
fn refuse_beside_a_running_robot(config: &Config) -> Result<()> {
    if let Ok(status) = Status::read(config.run.status_file.as_ref())
        && unix_s() - status.written_unix_s < STALE_S
    {
        bail!(
            "`firmware-host run` (pid {}) uses these devices: `firmware-host health --status {}` shows their state; to check \
             them, stop it first (`systemctl stop embodied-depth`)",
            status.pid,
            config.run.status_file
        );
    }
    Ok(())
}

fn screen(findings: &[Finding], columns: Option<usize>) -> String {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["device", "path", "state", "details"]);
    for finding in findings {
        table.add_row([finding.device, &finding.path, &finding.state, &finding.details]);
    }
    let mut text = fit::table(&table, columns);
    for finding in findings.iter().filter(|finding| !finding.advice.is_empty()) {
        text += "\n";
        let mark = if finding.is_usable { ' ' } else { '!' };
        for line in &finding.advice {
            // The messages of some drivers begin with the name of the device.
            let line = line.strip_prefix(finding.device).map_or(line.as_str(), str::trim_start);
            text += &format!("\n  {mark} {}: {line}", finding.device);
        }
    }
    fit::text(&text, columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_screen_has_a_row_for_each_device_and_its_advice_below() {
        let lidar = Finding {
            device: "LiDAR",
            path: "/dev/x".to_owned(),
            is_usable: true,
            state: "working".to_owned(),
            details: "UTM-30LX".to_owned(),
            advice: Vec::new(),
        };
        let base = Finding {
            device: "base",
            path: "can0".to_owned(),
            is_usable: false,
            state: "disconnected".to_owned(),
            details: String::new(),
            advice: vec!["plug it in".to_owned()],
        };
        let text = screen(&[lidar, base], None);
        assert!(
            text.lines().nth(1).unwrap().contains("LiDAR") && text.contains("UTM-30LX"),
            "{text}"
        );
        assert!(text.ends_with("  ! base: plug it in"), "{text}");
    }

    #[test]
    fn the_devices_of_a_running_robot_are_not_tested() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("status.json");
        let mut config = Config::default();
        config.run.status_file = file.to_str().unwrap().to_owned();
        refuse_beside_a_running_robot(&config).unwrap();
        Status { written_unix_s: unix_s(), pid: 77, ..Status::default() }.write(&file).unwrap();
        let refusal = refuse_beside_a_running_robot(&config).unwrap_err().to_string();
        assert!(refusal.contains("pid 77") && refusal.contains("systemctl stop"), "{refusal}");
        Status { written_unix_s: unix_s() - 60.0, ..Status::default() }.write(&file).unwrap();
        refuse_beside_a_running_robot(&config).unwrap();
    }
}
