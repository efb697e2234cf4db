//! One robot: a simulated drive, and what is measured from it.

use std::sync::Arc;

use anyhow::{Context, Result};
use firmware_host::calibrate::{self, DriveReader, Finding, Mounts};
use firmware_host::config::Config;
use firmware_host::simulation::simulated_robot;
use hal::{Base, Camera, Clock, DriveCommand, Frame, LaserScan, Lidar, Pose2};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use runtime::recording::{RecordedTick, RgbImage};
use simulator::{SimulatedRobot, World};

use crate::pattern::Pattern;

/// Steps of the base's loop in a tick of 100 ms.
const STEPS: u64 = 10;
const STEP_NS: u64 = 10_000_000;

/// How long a drive is, and during how much of it frames are taken, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    pub drive_s: f64,
    pub frames_s: f64,
}

/// Drives robot number `seed` as `config` says, and measures it.
///
/// # Errors
/// A scene that cannot be opened, or a drive that cannot be measured.
pub fn run(world: &Arc<World>, config: &Config, seed: u64, length: Length) -> Result<Vec<Finding>> {
    let camera = config.camera.model();
    let mounts = Mounts {
        t_base_laser: config.lidar.t_base_laser_3d(),
        t_base_camera: config.camera.t_base_camera(),
    };
    let mut reader = DriveReader::new(config, camera, mounts, length.frames_s > 0.0)?;
    drive(world, config, seed, length, |input| reader.see(input).map(|()| true))?;
    let (drive, camera) = reader.finish()?;
    let measured = calibrate::measure(&drive, camera.as_ref())?;
    Ok(measured.findings)
}

/// Drives robot number `seed` as `config` says, and hands over each tick, until `see` returns false.
///
/// # Errors
/// A scene that cannot be opened, and errors of `see`.
pub fn drive(
    world: &Arc<World>,
    config: &Config,
    seed: u64,
    length: Length,
    mut see: impl FnMut(RecordedTick) -> Result<bool>,
) -> Result<()> {
    let robot = SimulatedRobot::new(world.clone(), simulated_robot(config, seed, None))?;
    let mut devices = robot.devices();
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut pattern = Pattern::new();
    let mut scan = LaserScan::empty(devices.lidar.geometry());
    let mut frame = Frame::empty();
    let mut counter = 0;
    let mut history = Vec::new();
    for tick in 0..(10.0 * length.drive_s) as u64 {
        let twist = pattern.next(&scan, &mut rng);
        for _ in 0..STEPS {
            counter += 1;
            devices.base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 })?;
            let next_ns = devices.clock.now_ns() + STEP_NS;
            devices.clock.sleep_until_ns(next_ns);
            history.extend(devices.base.poll_feedback()?);
        }
        let now_ns = devices.clock.now_ns();
        let mut input = RecordedTick::new(tick, now_ns);
        input.wheel = *history.last().context("no wheel feedback")?;
        if devices.lidar.poll_scan(&mut scan)? {
            input.scan_odom = odom_at(&history, scan.middle_ns());
            input.scan = Some(scan.clone());
        }
        if now_ns as f64 * 1e-9 < length.frames_s && devices.camera.poll_frame(&mut frame)? {
            // A tick is at the time of its frame.
            input.wheel.odom = odom_at(&history, frame.time_ns);
            input.wheel.time_ns = frame.time_ns;
            let rgb = frame.data.clone();
            input.frame = Some(RgbImage { width: frame.width, height: frame.height, rgb });
        }
        if !see(input)? {
            break;
        }
        let old = history.len().saturating_sub(2 * STEPS as usize);
        history.drain(..old);
    }
    Ok(())
}

/// The pose by the wheels at a time between two reports.
fn odom_at(history: &[hal::WheelFeedback], time_ns: u64) -> Pose2 {
    let after = history.partition_point(|report| report.time_ns <= time_ns);
    let (Some(from), Some(to)) = (history.get(after.saturating_sub(1)), history.get(after)) else {
        return history.last().map_or(Pose2::IDENTITY, |report| report.odom);
    };
    let share = (time_ns as f64 - from.time_ns as f64) / (to.time_ns as f64 - from.time_ns as f64);
    let motion = from.odom.inverse().compose(&to.odom);
    from.odom.compose(&Pose2::new(share * motion.x_m, share * motion.y_m, share * motion.yaw_rad))
}
