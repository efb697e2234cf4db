//! `firmware-host camera-latency`: measures the time from the capture of a frame to its time stamp.
//!
//! If a frame is assigned the robot's pose of 50 ms later while the robot rotates at 1 rad/s, its
//! heading is wrong by 50 mrad, which is more than all parallax. The kernel's time stamps do not
//! include the camera's readout, processing and USB transfer. The recording of a robot that rotates
//! left and right shows them.

mod rotation;
mod shift;

use anyhow::{Context, Result, bail};
use drivers::v4l2::CameraDeviceConfig;

use crate::cli::CameraLatencyArgs;
use crate::config::Config;
use crate::recorded::Recorded;
use rotation::{FrameRotation, RotationMeter};
use shift::{Heading, Shift, fit};

/// Longest time between two frames that are compared, seconds. Later frames overlap too little.
const MAX_INTERVAL_S: f64 = 0.25;
/// Maximum number of frame pairs (ten minutes at 10 Hz). More do not improve the result.
const MAX_PAIRS: usize = 6000;

/// Measures the latency in a recording and prints the values to configure.
///
/// # Errors
/// If the recording cannot be read, or the robot rotated too little in it.
pub fn run(args: &CameraLatencyArgs) -> Result<()> {
    let recording = Recorded::open(&args.run)?;
    let header = recording.run();
    if !header.images {
        bail!(
            "the run was recorded without images (recording.images = false), but the latency is measured from them"
        );
    }
    let config: Config = serde_json::from_value(header.config.clone())
        .context("the recording's configuration cannot be read; record with this version")?;
    let mut camera = config.devices.camera;
    if header.scene.is_some() {
        // The simulated camera of `explore` does not use this setting.
        camera.latency_ms = 0.0;
    }
    let (heading, rotations) = read(&recording)?;
    println!("{}", report(&fit(&heading, &rotations)?, &camera));
    Ok(())
}

/// The result as text. `camera` is the configuration with which the recording was made.
fn report(shift: &Shift, camera: &CameraDeviceConfig) -> String {
    let configured_ms = camera.latency_ms;
    let Shift { latency_s, error_s, residual_rad, residual_without_rad, rotations } = shift;
    let total_ms = configured_ms + 1000.0 * latency_s;
    let error_ms = 1000.0 * error_s;
    let found = if total_ms < 0.0 {
        format!(
            "The wheel odometry lags behind the frames by {:.1} ms (standard error {error_ms:.1} ms)",
            -total_ms
        )
    } else {
        format!(
            "Frames are stamped {total_ms:.1} ms (standard error {error_ms:.1} ms) after their capture"
        )
    };
    let advice = if (1000.0 * latency_s).abs() <= (2.0 * error_ms).max(1.0) {
        "The configuration already has this value.".to_owned()
    } else {
        let least_ms =
            CameraDeviceConfig { latency_ms: total_ms, ..camera.clone() }.least_max_age_ms();
        let raised = if camera.max_age_ms < least_ms {
            format!("\nmax_age_ms = {least_ms}")
        } else {
            String::new()
        };
        format!(
            "Write into the configuration:\n\n[devices.camera]\nlatency_ms = {total_ms:.1}{raised}"
        )
    };
    format!(
        "{found}, measured from {rotations} rotations between two frames.\nWith this latency, 90 % of the \
         rotations agree with the wheel odometry within {:.1} mrad; with latency_ms = {configured_ms}, within \
         {:.1} mrad.\n{advice}",
        1000.0 * residual_rad,
        1000.0 * residual_without_rad,
    )
}

/// Reads the heading by the wheel odometry and the rotations between frames.
fn read(recording: &Recorded) -> Result<(Heading, Vec<FrameRotation>)> {
    let header = recording.run();
    let mut meter = RotationMeter::new(header.camera, &header.t_base_camera)?;
    let mut heading = Heading::default();
    let mut rotations = Vec::new();
    for tick in recording.ticks() {
        let tick = tick?;
        heading.push(&tick.wheel);
        let Some(frame) = tick.frame else { continue };
        // The recorded wheel feedback of a tick has the time of its frame.
        let rotation = meter.measure(heading.seconds(tick.wheel.time_ns), &frame.rgb)?;
        rotations.extend(rotation.filter(|rotation| {
            rotation.to_s > rotation.from_s && rotation.to_s - rotation.from_s <= MAX_INTERVAL_S
        }));
        if rotations.len() == MAX_PAIRS {
            break;
        }
    }
    Ok((heading, rotations))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHIFT: Shift = Shift {
        latency_s: 0.0323,
        error_s: 0.0004,
        residual_rad: 0.0015,
        residual_without_rad: 0.0074,
        rotations: 244,
    };

    fn camera(latency_ms: f64) -> CameraDeviceConfig {
        CameraDeviceConfig { latency_ms, ..CameraDeviceConfig::default() }
    }

    #[test]
    fn the_printed_configuration_is_valid() {
        let text = report(&Shift { latency_s: 0.18, ..SHIFT }, &camera(50.0));
        assert!(text.ends_with("latency_ms = 230.0\nmax_age_ms = 264"), "{text}");
        CameraDeviceConfig { max_age_ms: 264, ..camera(230.0) }.check().unwrap();
    }

    #[test]
    fn the_configured_latency_is_added_to_the_measured_one() {
        let text = report(&SHIFT, &camera(5.0));
        assert!(
            text.starts_with(
                "Frames are stamped 37.3 ms (standard error 0.4 ms) after their capture, measured from 244"
            ),
            "{text}"
        );
        assert!(text.ends_with("\n\n[devices.camera]\nlatency_ms = 37.3"), "{text}");
    }

    #[test]
    fn a_negative_latency_means_that_the_odometry_lags_and_a_small_one_changes_nothing() {
        let text = report(&Shift { latency_s: -0.0005, ..SHIFT }, &camera(0.0));
        assert!(
            text.starts_with("The wheel odometry lags behind the frames by 0.5 ms")
                && text.ends_with("already has this value."),
            "{text}"
        );
    }
}
