//! `firmware-host calibrate`: wheels, mounts and latencies from a drive, which it records itself or which was recorded.
//!
//! | file | idea |
//! |---|---|
//! | `course` | the drive of `--drive` |
//! | `drive`, `regular_times` | what a recording or a log holds |
//! | `wheels`, `scan_path` | the path by the wheels, and by matched scans |
//! | `laser` | wheels and scanner together |
//! | `base_path` | where the robot was at any time |
//! | `klt`, `frames` | points that were followed between frames |
//! | `camera`, `floor` | the camera's mount and latency, and its height |
//! | `least_squares` | robust fits whose standard deviations hold |
//! | `finding`, `against`, `measure`, `file` | what is said and written |

mod against;
mod base_path;
mod camera;
mod camera_parameters;
mod course;
mod drive;
mod file;
mod finding;
mod floor;
mod frames;
mod klt;
mod laser;
mod laser_parameters;
mod least_squares;
mod measure;
mod regular_times;
mod scan_path;
mod span_noise;
mod wheels;

use std::path::Path;

use anyhow::{Context, Result, bail};
use runtime::recording::RunHeader;

use crate::cli::CalibrateArgs;
use crate::config::Config;
use crate::localize::log::Log;
use crate::recorded::Recorded;
use crate::report::atomic::{check_file, write_atomically};
use against::against;
pub use drive::{CameraDrive, Drive, DriveReader, Mounts};
use file::Provenance;
pub use finding::{Finding, Nature, Parameter, Verdict};
pub use laser::Residuals;
pub use measure::{Measured, measure};

/// The file that is written by default, beside the robot's configuration.
const DEFAULT_FILE: &str = "calibration.toml";
/// Below this change of the focal length there is no warning: in a simulated drive the check was off by 0.8 %, six times its stated standard
/// deviation, and a calibration board is exact to some tenths of a per cent.
const LEAST_FOCAL_CHANGE: f64 = 0.015;
/// The wheels carry everything else: a drive that does not show them calibrates nothing.
const ESSENTIAL: [Parameter; 3] = [Parameter::LeftRadius, Parameter::RightRadius, Parameter::Track];

/// Measures, and writes the file if every result is plausible.
///
/// # Errors
/// A drive that cannot be read or shows too little, or an implausible result. Nothing is written then.
pub fn run(args: &CalibrateArgs) -> Result<()> {
    match (&args.recording, &args.log, &args.config) {
        (Some(recording), _, _) => of_recording(recording, args),
        (None, Some(log), _) => of_log(log, args),
        (None, None, Some(config)) if args.drive => {
            of_recording(&course::drive(config, args)?, args)
        }
        _ => bail!("give --recording RUN, --log FILE, or --drive with --config FILE"),
    }
}

fn of_recording(path: &Path, args: &CalibrateArgs) -> Result<()> {
    // What cannot succeed is refused before the measurement, which takes minutes.
    let config = args.config.as_deref().map(Config::load).transpose()?;
    let beside = args.config.as_deref().and_then(Path::parent).unwrap_or(Path::new(""));
    let out = args.out.clone().unwrap_or_else(|| beside.join(DEFAULT_FILE));
    check_file(&out)?;
    let recording = Recorded::open(path)?;
    let (drive, camera) = read(&recording)?;
    let measured = measure(&drive, camera.as_ref())?;
    let header = recording.run();
    let recorded = config_of(header)?;
    let config = config.unwrap_or_else(|| recorded.clone());
    let is_simulated = header.scene.is_some();
    let mut findings = measured.findings.clone();
    for finding in &mut findings {
        *finding = against(finding, &recorded, &config, is_simulated);
    }
    print(&findings, &measured);
    refuse(&findings)?;
    write(&findings, path, &out)
}

fn of_log(path: &Path, args: &CalibrateArgs) -> Result<()> {
    args.out.as_deref().map_or(Ok(()), check_file)?;
    let log = Log::read(path)?;
    println!("odometry: {}", log.odometry);
    let measured = measure(&Drive::of_log(&log), None)?;
    print(&measured.findings, &measured);
    refuse(&measured.findings)?;
    match &args.out {
        Some(out) => {
            // The clock of a log is not that of this robot.
            let is_of_robot = |finding: &Finding| finding.parameter != Parameter::LidarLatency;
            let findings: Vec<Finding> =
                measured.findings.into_iter().filter(is_of_robot).collect();
            write(&findings, path, out)
        }
        None => Ok(()),
    }
}

/// Reads the wheels, scans and frames of a recorded run. There is no camera in a run that was recorded without images.
///
/// # Errors
/// A run that cannot be read, or that has no scans.
pub fn read(recording: &Recorded) -> Result<(Drive, Option<CameraDrive>)> {
    let header = recording.run();
    let config = config_of(header)?;
    let mounts = Mounts { t_base_laser: header.t_base_laser, t_base_camera: header.t_base_camera };
    let mut reader = DriveReader::new(&config, header.camera, mounts, header.images)?;
    for tick in recording.ticks() {
        reader.see(tick?)?;
    }
    reader.finish()
}

fn config_of(header: &RunHeader) -> Result<Config> {
    serde_json::from_value(header.config.clone())
        .context("the recording's configuration cannot be read; record with this version")
}

fn print(findings: &[Finding], measured: &Measured) {
    for finding in findings {
        println!("{finding}");
    }
    if let Some(reason) = &measured.no_camera {
        println!("{reason}");
    }
    let Measured { before, after, spans, .. } = measured;
    println!(
        "Wheels and scans disagree by {:.2} mrad over {} short spans (before: {:.2}) and by {:.2} mm over {} long ones (before: {:.2}).",
        1000.0 * after.yaw_rad,
        spans[0],
        1000.0 * before.yaw_rad,
        1000.0 * after.translation_m,
        spans[1],
        1000.0 * before.translation_m
    );
    if let Some([before_px, after_px]) = measured.points_px {
        println!("Followed points are off by {after_px:.2} pixels (before: {before_px:.2}).");
    }
    warn_of_focal_length(findings);
}

/// The focal length is a check: it is corrected with a calibration board.
fn warn_of_focal_length(findings: &[Finding]) {
    let focal = findings.iter().find(|finding| finding.parameter == Parameter::FocalLength);
    let is_far_off = |focal: &&Finding| {
        focal.verdict() == Verdict::Changed && (focal.new - focal.old).abs() > LEAST_FOCAL_CHANGE
    };
    if let Some(focal) = focal.filter(is_far_off) {
        println!(
            "warning: the configured focal length does not fit this drive; its true value is {:.3} +- {:.3} times that. Measure it with a \
             calibration board: set `devices.lens`, or `camera.horizontal_fov_deg` for a camera without distortion",
            focal.new, focal.sigma
        );
    }
}

/// Nothing is written when one result is implausible, or when the drive did not show the wheels.
fn refuse(findings: &[Finding]) -> Result<()> {
    for finding in findings {
        let is_essential = ESSENTIAL.contains(&finding.parameter);
        match finding.verdict() {
            Verdict::Implausible => bail!("nothing is written: {finding}"),
            Verdict::NotObserved if is_essential => bail!("nothing is written: {finding}"),
            _ => {}
        }
    }
    Ok(())
}

fn write(findings: &[Finding], drive: &Path, out: &Path) -> Result<()> {
    let provenance = Provenance {
        drive: drive.display().to_string(),
        date: jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        software: concat!("firmware-host ", env!("CARGO_PKG_VERSION")).to_owned(),
    };
    let text = file::text(findings, &provenance);
    Config::parse(&text, out).context("the result is no valid configuration")?;
    write_atomically(out, text.as_bytes())?;
    let out = out.display();
    println!(
        "Wrote {out}. The robot's configuration includes it with the line: calibration = \"{out}\""
    );
    Ok(())
}
