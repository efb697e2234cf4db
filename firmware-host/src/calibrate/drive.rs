//! A recorded drive, as far as calibration needs it: reports of the wheels, scans, and what was configured.

use anyhow::{Result, bail};
use hal::{LaserScan, Pose2, ScanGeometry};

use crate::config::Config;
use crate::localize::log::Log;
use crate::recorded::Recorded;

use super::wheels::WheelPath;

/// The track that is assumed for a log that does not say it, metres. Only the ratio to it is found then.
const UNKNOWN_TRACK_M: f64 = 0.4;

/// What the robot was taken for when it drove.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Configured {
    pub wheel_radius_m: f64,
    pub track_m: f64,
    pub t_base_laser: Pose2,
}

/// One scan, on the clock of the drive.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimedScan {
    /// Time of its middle as it was stamped, seconds.
    pub time_s: f64,
    pub scan: LaserScan,
}

/// Wheels and scans of a drive. Times are seconds since its first report.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drive {
    pub configured: Configured,
    pub geometry: ScanGeometry,
    pub wheels: WheelPath,
    pub scans: Vec<TimedScan>,
}

impl Drive {
    /// Reads a log of another robot.
    pub fn of_log(log: &Log) -> Self {
        let wheels_of_log = log.wheels;
        let configured = Configured {
            wheel_radius_m: wheels_of_log.map_or(1.0, |wheels| wheels.radius_m),
            track_m: wheels_of_log.map_or(UNKNOWN_TRACK_M, |wheels| wheels.track_m),
            t_base_laser: log.t_base_laser,
        };
        let begin_s = log.lines.first().map_or(0.0, |line| line.time_s);
        let mut drive = Self {
            configured,
            geometry: log.geometry,
            wheels: WheelPath::default(),
            scans: Vec::new(),
        };
        for line in &log.lines {
            let time_s = line.time_s - begin_s;
            drive.wheels.push(time_s, &line.wheel, configured.track_m);
            if let Some(ranges) = &line.ranges {
                let time_ns = (time_s.max(0.0) * 1e9) as u64;
                let scan = LaserScan { time_ns, geometry: log.geometry, ranges: ranges.clone() };
                drive.scans.push(TimedScan { time_s, scan });
            }
        }
        drive
    }

    /// Reads the wheels and scans of a recorded run. `on_tick` sees every tick with its time in seconds.
    ///
    /// # Errors
    /// A run that cannot be read, or that has no scans.
    pub fn of_run(recording: &Recorded, frames: &mut impl FrameUser) -> Result<Self> {
        let header = recording.run();
        let config: Config = serde_json::from_value(header.config.clone()).map_err(|error| {
            anyhow::anyhow!(
                "the recording's configuration cannot be read ({error}); record with this version"
            )
        })?;
        let base = &config.devices.base;
        let configured = Configured {
            wheel_radius_m: base.wheel_radius_m,
            track_m: base.track_m,
            t_base_laser: in_the_plane(&header.t_base_laser),
        };
        let mut clock = Clock::default();
        let mut wheels = WheelPath::default();
        let mut scans: Vec<TimedScan> = Vec::new();
        for tick in recording.ticks() {
            let tick = tick?;
            let time_s = clock.seconds(tick.wheel.time_ns);
            if let Some(scan) = tick.scan {
                let middle_s = clock.seconds(scan.middle_ns());
                // Where the pose at the scan was not known, that of the tick stands in its place.
                if middle_s < time_s && tick.scan_odom != tick.wheel.odom {
                    wheels.push(middle_s, &tick.scan_odom, base.track_m);
                }
                if scans.last().is_none_or(|last| middle_s > last.time_s) {
                    scans.push(TimedScan { time_s: middle_s, scan });
                }
            }
            wheels.push(time_s, &tick.wheel.odom, base.track_m);
            if let Some(frame) = &tick.frame {
                frames.see(time_s, &tick.wheel.odom, frame)?;
            }
        }
        let Some(first) = scans.first() else {
            bail!("the recording has no scans, but wheels and mounts are measured against them");
        };
        let geometry = first.scan.geometry;
        Ok(Self { configured, geometry, wheels, scans })
    }
}

/// What wants to see the frames of a drive while it is read.
pub(super) trait FrameUser {
    /// A frame, its time in seconds, and the pose by the wheels at that time.
    fn see(
        &mut self,
        time_s: f64,
        odom: &Pose2,
        frame: &runtime::recording::RgbImage,
    ) -> Result<()>;
}

/// Seconds since the first time that was asked for.
#[derive(Debug, Default)]
struct Clock {
    begin_ns: Option<u64>,
}

impl Clock {
    fn seconds(&mut self, time_ns: u64) -> f64 {
        let begin_ns = *self.begin_ns.get_or_insert(time_ns);
        (time_ns as f64 - begin_ns as f64) * 1e-9
    }
}

/// The planar part of a level mount.
pub(super) fn in_the_plane(mount: &hal::Pose3) -> Pose2 {
    let ahead = mount.rotation * nalgebra::Vector3::x();
    Pose2::new(mount.translation.x, mount.translation.y, ahead.y.atan2(ahead.x))
}
