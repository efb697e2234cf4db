//! `firmware-host camera-latency`: how much later the camera stamps its pictures than it takes them.
//!
//! A picture that is put where the robot was 50 ms later is put wrong by 50 mrad when the robot begins to turn at 1 rad/s: more
//! than all parallax. Kernel stamps do not know readout, processing and USB; the recording of a robot that turns to and fro
//! does.

mod shift;
mod turn;

use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result};
use runtime::recording::RunHeader;

use crate::cli::CameraLatencyArgs;
use crate::config::Config;
use crate::replay::{ReplayError, open_segment, segments};
use shift::{Heading, Shift, Turned, fit};
use turn::TurnMeter;

/// Pictures that are farther apart have too little in common, seconds.
const LONGEST_S: f64 = 0.25;
/// More pairs of pictures than this, ten minutes, tell nothing new.
const ENOUGH: usize = 6000;

/// Reads a recording and tells what to configure.
///
/// # Errors
/// A recording that cannot be read, or in which the robot turned too little.
pub fn run(args: &CameraLatencyArgs) -> Result<()> {
    let (header, heading, turned) = read(&args.run)?;
    let shift = fit(&heading, &turned)?;
    let config: Config = serde_json::from_value(header.config)
        .context("the recording's configuration cannot be read; the program that recorded it can")?;
    writeln!(std::io::stdout(), "{}", words(&shift, config.devices.camera.latency_ms))?;
    Ok(())
}

/// What was found, beside what the recording was made with.
fn words(shift: &Shift, configured_ms: f64) -> String {
    let Shift { latency_s, error_s, off_rad, off_without_rad, turns } = shift;
    let (total_ms, error_ms) = (configured_ms + 1000.0 * latency_s, 1000.0 * error_s);
    let found = if total_ms < 0.0 {
        format!("The wheels are {:.1} ms (+-{error_ms:.1} by chance) later than pictures", -total_ms)
    } else {
        format!("Pictures are stamped {total_ms:.1} ms (+-{error_ms:.1} by chance) after they are taken")
    };
    let advice = if (1000.0 * latency_s).abs() <= (2.0 * error_ms).max(1.0) {
        "It is configured like that.".to_owned()
    } else {
        format!("In the configuration:\n\n[devices.camera]\nlatency_ms = {total_ms:.1}")
    };
    format!(
        "{found}, by {turns} turns between two pictures.\nNine of ten turns are then within {:.1} mrad of what the wheels say, \
         with latency_ms = {configured_ms} within {:.1}.\n{advice}",
        1000.0 * off_rad,
        1000.0 * off_without_rad,
    )
}

/// What wheels and pictures say of a run. A damaged segment is named and read as far as it goes.
fn read(path: &Path) -> Result<(RunHeader, Heading, Vec<Turned>)> {
    let (mut run, mut heading, mut turned) = (None, Heading::default(), Vec::new());
    for path in segments(path)? {
        let damaged = |error: &dyn std::fmt::Display| {
            tracing::warn!("{} is damaged and read only as far as it goes: {error}", path.display());
        };
        let segment = match open_segment(&path) {
            Ok(segment) => segment,
            Err(error) => {
                damaged(&error);
                continue;
            }
        };
        let header = run.get_or_insert_with(|| segment.header().run.clone());
        let (mut meter, mut last_s) = (TurnMeter::new(header.camera, &header.t_base_camera)?, None);
        for tick in segment.map_while(|tick| tick.inspect_err(|error| damaged(error)).ok()) {
            heading.push(&tick.wheel);
            let Some(picture) = tick.frame else { continue };
            // The wheels of a turn are those of its picture's moment.
            let to_s = heading.seconds(tick.wheel.time_ns);
            let seen = meter.turn_rad(&picture.rgb)?;
            if let Some((yaw_rad, from_s)) = seen.zip(last_s.replace(to_s))
                && (0.0..=LONGEST_S).contains(&(to_s - from_s))
            {
                turned.push(Turned { from_s, to_s, yaw_rad });
            }
        }
        if turned.len() >= ENOUGH {
            break;
        }
    }
    let run = run.ok_or_else(|| ReplayError::NoSegments { dir: path.to_owned() })?;
    Ok((run, heading, turned))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHIFT: Shift =
        Shift { latency_s: 0.0323, error_s: 0.0004, off_rad: 0.0015, off_without_rad: 0.0074, turns: 244 };

    #[test]
    fn it_says_what_to_write_into_the_configuration_on_top_of_what_is_there() {
        let text = words(&SHIFT, 5.0);
        assert!(
            text.starts_with("Pictures are stamped 37.3 ms (+-0.4 by chance) after they are taken, by 244 turns"),
            "{text}"
        );
        assert!(text.ends_with("\n\n[devices.camera]\nlatency_ms = 37.3"), "{text}");
    }

    #[test]
    fn what_is_right_already_stays_and_wheels_may_be_the_later_ones() {
        let text = words(&Shift { latency_s: -0.0005, ..SHIFT }, 0.0);
        assert!(text.starts_with("The wheels are 0.5 ms") && text.ends_with("configured like that."), "{text}");
    }
}
