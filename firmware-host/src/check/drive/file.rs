//! `commissioning.toml`: the measured numbers with their date, beside the configuration. `run` compares them with what the
//! configuration assumes, if `run.commissioning` is `measured`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use drivers::can::{BaseConfig, Protocol};
use serde::{Deserialize, Serialize};

use super::assumed::Assumed;
use super::judge::{self, Judgement, lidar_yaw_deg};
use super::measure::Measured;
use crate::config::{Commissioning, Config, ConfigError};
use crate::report::atomic::write_atomically;

/// Name of the file.
const NAME: &str = "commissioning.toml";
/// Begins the file.
const HEADER: &str = "# Measured by `firmware-host check --drive`. With run.commissioning = \"measured\", `run` compares the numbers below\n\
                      # [measured] with those that the configuration assumes, and refuses to start if one is worse.\n";
/// `calibrate` may change radius and track by this factor without another commissioning.
const GEOMETRY: f64 = 1.05;

#[derive(Serialize)]
struct File<'a> {
    /// When it was measured, in universal time.
    date: String,
    speed_mps: f64,
    start_s: f64,
    response_s: f64,
    reaction_s: f64,
    braking_m: f64,
    roll_out_speed_mps: f64,
    roll_out_m: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    lidar_yaw_deg: Option<f64>,
    /// What was worse than the safety plane assumes.
    worse: Vec<&'a str>,
    advice: Vec<&'a str>,
    wheels: Wheels,
    measured: Measured,
}

/// What is read again.
#[derive(Deserialize)]
struct Kept {
    wheels: Wheels,
    measured: Measured,
}

/// The wheels that were measured.
#[derive(Serialize, Deserialize)]
struct Wheels {
    protocol: Protocol,
    wheel_radius_m: f64,
    track_m: f64,
    gear_ratio: f64,
    swap_wheels: bool,
    invert_left: bool,
    invert_right: bool,
}

impl Wheels {
    fn of(base: &BaseConfig) -> Self {
        Self {
            protocol: base.protocol,
            wheel_radius_m: base.wheel_radius_m,
            track_m: base.track_m,
            gear_ratio: base.gear_ratio,
            swap_wheels: base.swap_wheels,
            invert_left: base.invert_left,
            invert_right: base.invert_right,
        }
    }

    /// The first key in which the wheels of a configuration are others.
    fn difference(&self, now: &Self) -> Option<&'static str> {
        let keys = [
            ("protocol", self.protocol != now.protocol),
            ("wheel_radius_m", is_far(self.wheel_radius_m, now.wheel_radius_m)),
            ("track_m", is_far(self.track_m, now.track_m)),
            ("gear_ratio", self.gear_ratio.to_bits() != now.gear_ratio.to_bits()),
            ("swap_wheels", self.swap_wheels != now.swap_wheels),
            ("invert_left", self.invert_left != now.invert_left),
            ("invert_right", self.invert_right != now.invert_right),
        ];
        keys.into_iter().find_map(|(key, differs)| differs.then_some(key))
    }
}

fn is_far(one: f64, other: f64) -> bool {
    (one / other).max(other / one) > GEOMETRY
}

/// The file of a configuration at `path`.
fn place(config: &Config, path: &Path) -> PathBuf {
    match config.run.commissioning_file.as_str() {
        "" => path.with_file_name(NAME),
        named => PathBuf::from(named),
    }
}

/// Writes the file of a configuration at `path`, and returns the file's path.
///
/// # Errors
/// The folder cannot be written.
pub fn write(
    config: &Config,
    path: &Path,
    measured: &Measured,
    assumed: &Assumed,
    judgements: &[Judgement],
) -> Result<PathBuf> {
    let worse: Vec<&Judgement> = judgements.iter().filter(|judgement| judgement.is_worse).collect();
    let file = File {
        date: jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        speed_mps: rounded(measured.speed_mps),
        start_s: rounded(measured.start_s),
        response_s: rounded(measured.response_s),
        reaction_s: rounded(assumed.sight_s + measured.response_s),
        braking_m: rounded(measured.braking_m),
        roll_out_speed_mps: rounded(measured.last_speed_mps),
        roll_out_m: rounded(measured.roll_out_m),
        lidar_yaw_deg: lidar_yaw_deg(measured).map(rounded),
        worse: worse.iter().map(|judgement| judgement.what).collect(),
        advice: worse.iter().map(|judgement| judgement.advice.as_str()).collect(),
        wheels: Wheels::of(&config.devices.base),
        measured: *measured,
    };
    let path = place(config, path);
    write_atomically(&path, (HEADER.to_owned() + &toml::to_string(&file)?).as_bytes())?;
    Ok(path)
}

/// Whether `run` may start with this configuration: what it assumes is known as `run.commissioning` says.
///
/// # Errors
/// There is no measurement beside the configuration, it is of other wheels, or worse than what is assumed.
pub fn require(config: &Config, path: &Path) -> Result<(), ConfigError> {
    match config.run.commissioning {
        Commissioning::Unchecked | Commissioning::ByHand => Ok(()),
        Commissioning::Measured => borne_out(config, &place(config, path))
            .map_err(|why| ConfigError::NotCommissioned { path: path.to_owned(), why }),
    }
}

fn borne_out(config: &Config, file: &Path) -> Result<(), String> {
    let text = fs::read_to_string(file).map_err(|error| in_file(file, &error))?;
    let kept: Kept = toml::from_str(&text).map_err(|error| in_file(file, &error.message()))?;
    if let Some(key) = kept.wheels.difference(&Wheels::of(&config.devices.base)) {
        return Err(in_file(
            file,
            &format!("devices.base.{key} has changed since `check --drive` measured the robot"),
        ));
    }
    let judgements = judge::all(&kept.measured, &Assumed::new(config));
    match judgements.iter().find(|judgement| judgement.is_worse) {
        None => Ok(()),
        Some(Judgement { what, assumed, measured, advice, .. }) => {
            Err(format!("{what} was measured as {measured}, and {assumed} is assumed: {advice}"))
        }
    }
}

fn in_file(file: &Path, why: &dyn std::fmt::Display) -> String {
    format!("{}: {why}", file.display())
}

/// Three digits behind the point: a millimetre, or a millisecond.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
