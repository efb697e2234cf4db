//! `commissioning.toml`: the measured numbers with their date, beside the configuration.

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde::Serialize;

use super::judge::{Assumed, Judgement, lidar_yaw_deg};
use super::measure::Measured;
use crate::report::atomic::write_atomically;

/// Begins the file.
const HEADER: &str = "# Measured by `firmware-host check --drive`. The robot does not read this file: its numbers are to be compared with\n\
                      # those of the configuration, and with those of the next commissioning.\n";

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
}

/// Writes the file and returns its path.
///
/// # Errors
/// The folder cannot be written.
pub fn write(
    config: &Path,
    measured: &Measured,
    assumed: &Assumed,
    judgements: &[Judgement],
) -> Result<PathBuf> {
    let worse = || judgements.iter().filter(|judgement| judgement.is_worse);
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
        worse: worse().map(|judgement| judgement.what).collect(),
        advice: worse().map(|judgement| judgement.advice.as_str()).collect(),
    };
    let path = config.with_file_name("commissioning.toml");
    write_atomically(&path, (HEADER.to_owned() + &toml::to_string(&file)?).as_bytes())?;
    Ok(path)
}

/// Three digits behind the point: a millimetre, or a millisecond.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
