//! `firmware-host camera-latency`: how much later the camera stamps its pictures than it takes them.
//!
//! A picture that is put where the robot was 50 ms later is put wrong by 50 mrad when the robot begins to turn at 1 rad/s: more
//! than all parallax. Kernel stamps do not know readout, processing and USB; the recording of a robot that turns to and fro
//! does.

mod shift;
mod turn;

use std::io::Write;

use anyhow::{Context, Result, bail};
use drivers::v4l2::CameraDeviceConfig;

use crate::cli::CameraLatencyArgs;
use crate::config::Config;
use crate::recorded::Recorded;
use shift::{Heading, Shift, fit};
use turn::{TurnMeter, Turned};

/// Pictures that are farther apart have too little in common, seconds.
const LONGEST_S: f64 = 0.25;
/// More pairs of pictures than this, ten minutes, tell nothing new.
const ENOUGH: usize = 6000;

/// Reads a recording and tells what to configure.
///
/// # Errors
/// A recording that cannot be read, or in which the robot turned too little.
pub fn run(args: &CameraLatencyArgs) -> Result<()> {
    let recording = Recorded::open(&args.run)?;
    let header = recording.run();
    if !header.pictures {
        bail!(
            "the run was recorded without pictures (recording.images = false): they do not show how it turned"
        );
    }
    let config: Config = serde_json::from_value(header.config.clone())
        .context("the recording's configuration cannot be read; record with this version")?;
    let mut camera = config.devices.camera;
    if header.scene.is_some() {
        // The camera of `explore` is no device.
        camera.latency_ms = 0.0;
    }
    let (heading, turned) = read(&recording)?;
    writeln!(std::io::stdout(), "{}", words(&fit(&heading, &turned)?, &camera))?;
    Ok(())
}

/// What was found, beside what the recording was made with.
fn words(shift: &Shift, camera: &CameraDeviceConfig) -> String {
    let configured_ms = camera.latency_ms;
    let Shift { latency_s, error_s, off_rad, off_without_rad, turns } = shift;
    let (total_ms, error_ms) = (configured_ms + 1000.0 * latency_s, 1000.0 * error_s);
    let found = if total_ms < 0.0 {
        format!(
            "The wheels are {:.1} ms (+-{error_ms:.1} by chance) later than pictures",
            -total_ms
        )
    } else {
        format!(
            "Pictures are stamped {total_ms:.1} ms (+-{error_ms:.1} by chance) after they are taken"
        )
    };
    let advice = if (1000.0 * latency_s).abs() <= (2.0 * error_ms).max(1.0) {
        "It is configured like that.".to_owned()
    } else {
        let least_ms =
            CameraDeviceConfig { latency_ms: total_ms, ..camera.clone() }.least_max_age_ms();
        let raised = if camera.max_age_ms < least_ms {
            format!("\nmax_age_ms = {least_ms}")
        } else {
            String::new()
        };
        format!("In the configuration:\n\n[devices.camera]\nlatency_ms = {total_ms:.1}{raised}")
    };
    format!(
        "{found}, by {turns} turns between two pictures.\nNine of ten turns are then within {:.1} mrad of what the wheels say, \
         with latency_ms = {configured_ms} within {:.1}.\n{advice}",
        1000.0 * off_rad,
        1000.0 * off_without_rad,
    )
}

/// What wheels and pictures say of a run.
fn read(recording: &Recorded) -> Result<(Heading, Vec<Turned>)> {
    let header = recording.run();
    let mut meter = TurnMeter::new(header.camera, &header.t_base_camera)?;
    let (mut heading, mut turned) = (Heading::default(), Vec::new());
    for tick in recording.ticks() {
        let tick = tick?;
        heading.push(&tick.wheel);
        let Some(picture) = tick.frame else { continue };
        // The wheels of a turn are those of its picture's moment.
        let seen = meter.turned(heading.seconds(tick.wheel.time_ns), &picture.rgb)?;
        turned.extend(
            seen.filter(|seen| seen.to_s > seen.from_s && seen.to_s - seen.from_s <= LONGEST_S),
        );
        if turned.len() == ENOUGH {
            break;
        }
    }
    Ok((heading, turned))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHIFT: Shift = Shift {
        latency_s: 0.0323,
        error_s: 0.0004,
        off_rad: 0.0015,
        off_without_rad: 0.0074,
        turns: 244,
    };

    fn camera(latency_ms: f64) -> CameraDeviceConfig {
        CameraDeviceConfig { latency_ms, ..CameraDeviceConfig::default() }
    }

    #[test]
    fn what_it_advises_is_a_configuration_that_is_taken() {
        let text = words(&Shift { latency_s: 0.18, ..SHIFT }, &camera(50.0));
        assert!(text.ends_with("latency_ms = 230.0\nmax_age_ms = 264"), "{text}");
        CameraDeviceConfig { max_age_ms: 264, ..camera(230.0) }.check().unwrap();
    }

    #[test]
    fn it_says_what_to_write_into_the_configuration_on_top_of_what_is_there() {
        let text = words(&SHIFT, &camera(5.0));
        assert!(
            text.starts_with(
                "Pictures are stamped 37.3 ms (+-0.4 by chance) after they are taken, by 244 turns"
            ),
            "{text}"
        );
        assert!(text.ends_with("\n\n[devices.camera]\nlatency_ms = 37.3"), "{text}");
    }

    #[test]
    fn what_is_right_already_stays_and_wheels_may_be_the_later_ones() {
        let text = words(&Shift { latency_s: -0.0005, ..SHIFT }, &camera(0.0));
        assert!(
            text.starts_with("The wheels are 0.5 ms") && text.ends_with("configured like that."),
            "{text}"
        );
    }
}
