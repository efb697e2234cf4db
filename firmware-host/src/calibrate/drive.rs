//! A recorded drive, as far as calibration needs it: reports of the wheels, scans, and what was configured.

use anyhow::{Result, bail};
use hal::{CameraModel, LaserScan, Pose2, Pose3, ScanGeometry};
use runtime::recording::RecordedTick;

use crate::config::Config;
use crate::localize::log::Log;

use super::frames::{FrameMatcher, FramePair};
use super::regular_times::regular;
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
pub struct Drive {
    pub(super) configured: Configured,
    pub(super) geometry: ScanGeometry,
    pub(super) wheels: WheelPath,
    pub(super) scans: Vec<TimedScan>,
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
        let geometry = ScanGeometry { period_ns: log.sweep_ns, ..log.geometry };
        let begin_s = log.lines.first().map_or(0.0, |line| line.time_s);
        let mut drive =
            Self { configured, geometry, wheels: WheelPath::default(), scans: Vec::new() };
        for line in &log.lines {
            let time_s = line.time_s - begin_s;
            drive.wheels.push(time_s, &line.wheel, configured.track_m);
            if let Some(ranges) = &line.ranges {
                let time_ns = (time_s.max(0.0) * 1e9) as u64;
                let scan = LaserScan { time_ns, geometry, ranges: ranges.clone() };
                drive.scans.push(TimedScan { time_s, scan });
            }
        }
        let times_s: Vec<f64> = drive.scans.iter().map(|timed| timed.time_s).collect();
        for (timed, time_s) in drive.scans.iter_mut().zip(regular(&times_s)) {
            timed.time_s = time_s;
        }
        drive
    }
}

/// Takes the ticks of a drive one after the other.
pub struct DriveReader {
    configured: Configured,
    clock: Clock,
    wheels: WheelPath,
    scans: Vec<TimedScan>,
    frames: Option<FrameMatcher>,
    camera: CameraModel,
    t_base_camera: Pose3,
}

impl DriveReader {
    /// A reader for the ticks of a robot that was configured like this. Without `with_frames`, frames are left out.
    ///
    /// # Errors
    /// A camera that is too small for optical flow.
    pub fn new(
        config: &Config,
        camera: CameraModel,
        mounts: Mounts,
        with_frames: bool,
    ) -> Result<Self> {
        let base = &config.devices.base;
        let Mounts { t_base_laser, t_base_camera } = mounts;
        Ok(Self {
            configured: Configured {
                wheel_radius_m: base.wheel_radius_m,
                track_m: base.track_m,
                t_base_laser: Pose2::of_level(&t_base_laser),
            },
            clock: Clock::default(),
            wheels: WheelPath::default(),
            scans: Vec::new(),
            frames: if with_frames { Some(FrameMatcher::new(&camera)?) } else { None },
            camera,
            t_base_camera,
        })
    }

    /// Takes one tick.
    ///
    /// # Errors
    /// A frame of another size than the camera's.
    pub fn see(&mut self, tick: RecordedTick) -> Result<()> {
        let track_m = self.configured.track_m;
        let time_s = self.clock.seconds(tick.wheel.time_ns);
        if let Some(scan) = tick.scan {
            let middle_s = self.clock.seconds(scan.middle_ns());
            // Where the pose at the scan was not known, that of the tick stands in its place.
            if middle_s < time_s && tick.scan_odom != tick.wheel.odom {
                self.wheels.push(middle_s, &tick.scan_odom, track_m);
            }
            if self.scans.last().is_none_or(|last| middle_s > last.time_s) {
                self.scans.push(TimedScan { time_s: middle_s, scan });
            }
        }
        self.wheels.push(time_s, &tick.wheel.odom, track_m);
        if let (Some(frame), Some(frames)) = (&tick.frame, &mut self.frames) {
            frames.see(time_s, &tick.wheel.odom, frame)?;
        }
        Ok(())
    }

    /// The drive up to now, and its camera.
    ///
    /// # Errors
    /// A drive without scans.
    pub fn finish(self) -> Result<(Drive, Option<CameraDrive>)> {
        let Some(first) = self.scans.first() else {
            bail!("the drive has no scans, but wheels and mounts are measured against them");
        };
        let drive = Drive {
            configured: self.configured,
            geometry: first.scan.geometry,
            wheels: self.wheels,
            scans: self.scans,
        };
        let Self { camera: model, t_base_camera, .. } = self;
        let camera =
            self.frames.map(|frames| CameraDrive { model, t_base_camera, pairs: frames.pairs });
        Ok((drive, camera))
    }
}

/// Where the sensors were configured to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounts {
    pub t_base_laser: Pose3,
    pub t_base_camera: Pose3,
}

/// The camera of a drive, as it was configured, and what it saw.
pub struct CameraDrive {
    pub(super) model: CameraModel,
    pub(super) t_base_camera: Pose3,
    pub(super) pairs: Vec<FramePair>,
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
