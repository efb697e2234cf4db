//! The robot watches its own calibration while it drives.
//!
//! Localization and perception compare the sensors with each other anyway. What remains of these comparisons says how wheels, scanner
//! and camera differ from their configuration. A robot whose configuration is a little wrong from the beginning is left to
//! `firmware-host calibrate`; what is watched here is a *change* since the beginning of the run. It is reported once; parameters
//! are never changed. Of the camera's mount a report is withdrawn when what follows does not confirm it.
//!
//! | watched | beside | shown by |
//! |---|---|---|
//! | wheels: yaw per metre, yaw per yaw, distance | scans | driving, rotating, straight lines |
//! | scanner: yaw, forward, left | wheels | straight lines, rotations |
//! | scanner: latency | wheels | rotations that start and stop |
//! | camera: pitch, roll, yaw | scans | rotations, rotations, straight lines |
//! | camera: latency | scans | rotations that start and stop |

mod change_test;
mod leg_equations;
mod scanner_time;
mod sums;
#[cfg(test)]
mod tests;

use hal::Pose2;
use serde::{Deserialize, Serialize};

use crate::localization::{DrivenLeg, LocalizationConfig};
use crate::snapshot::{SnapshotError, State, remembers};
use change_test::{Begin, ChangeTest, Found, Limits};
use scanner_time::{ScannerTime, is_rather};

pub use change_test::Manner;
pub(crate) use scanner_time::{MatchedScan, rotation_starts_or_stops};
pub(crate) use sums::Sums;

/// A block of the drive ends when the rim of a wheel has travelled this distance, metres. It must not be used up by rotations, which say nothing of
/// yaw per metre or of the scanner's yaw.
const BLOCK_M: f64 = 0.5;
/// What a wheel's rim rolls when the robot rotates by one radian, metres: half of the default robot's track.
const RIM_M_PER_RAD: f64 = 0.12;
/// Steps between two ticks that are longer than this, metres or radians, are jumps of the odometry.
const LARGEST_STEP: f64 = 0.5;

/// What may have changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Watched {
    /// Yaw for each metre that the wheels do not report, rad/m: the radius of one wheel.
    WheelHeading,
    /// Yaw for each radian that the wheels do not report: the track.
    WheelTrack,
    /// Distance for each metre that the wheels do not report: the radius of both wheels.
    WheelDistance,
    /// Yaw of the scanner, rad, positive to the left.
    LidarYaw,
    /// Place of the scanner, metres forward.
    LidarForward,
    /// Place of the scanner, metres to the left.
    LidarLeft,
    /// Pitch of the camera, rad, positive down.
    CameraPitch,
    /// Yaw of the camera, rad, positive to the left.
    CameraYaw,
    /// Roll of the camera about its axis, rad, positive as `camera.roll_deg`.
    CameraRoll,
    /// Time from the exposure of a frame to its stamp, s.
    CameraLatency,
    /// Time from the measurement of a scan to its stamp, s.
    LidarLatency,
    /// Time from a motion of the wheels to the stamp of its report, s.
    WheelLatency,
}

impl Watched {
    /// Every watched parameter.
    pub const ALL: [Self; 12] = [
        Self::WheelHeading,
        Self::WheelTrack,
        Self::WheelDistance,
        Self::LidarYaw,
        Self::LidarForward,
        Self::LidarLeft,
        Self::CameraPitch,
        Self::CameraYaw,
        Self::CameraRoll,
        Self::CameraLatency,
        Self::LidarLatency,
        Self::WheelLatency,
    ];
}

/// A parameter as the last metres show it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    pub what: Watched,
    /// Its value less the configured one, in the unit of `what`.
    pub value: f64,
    /// Standard deviation of `value`.
    pub sigma: f64,
}

/// A change of one parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Change {
    pub what: Watched,
    /// The value now less that at the beginning of the run, in the unit of `what`.
    pub by: f64,
    /// Standard deviation of `by`.
    pub sigma: f64,
    /// How far the robot had driven in this run when the change began, metres.
    pub since_m: f64,
    /// When that was, monotonic nanoseconds.
    pub since_ns: u64,
    /// Whether it came at once.
    pub manner: Manner,
}

/// A change that was reported, and is not confirmed by what came after it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Withdrawal {
    pub what: Watched,
    /// The value now less that before the change that was reported, in the unit of `what`.
    pub still: f64,
    /// Standard deviation of `still`.
    pub sigma: f64,
}

/// What the watch says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Report {
    Changed(Change),
    Withdrawn(Withdrawal),
}

/// What was reported of the camera's mount since it was measured last.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct CameraReport {
    /// Pitch, yaw and roll before, and their standard deviations, rad.
    before: [[f64; 3]; 2],
    /// By how much each of them has changed since, rad; `None` if it was not reported.
    turned: [Option<f64>; 3],
}

/// Least noise of equations whose errors are independent, as a share of the stated one.
const LEAST_NOISE: f64 = 0.05;
/// Noise of the camera's yaw, as a share of the stated one. On a straight line the image motion of the same few things gives the same
/// error in every frame, so that the noise from block to block does not show it: over eight blocks it was 0.4 to 3.4 in 15 simulated drives
/// (docs/calibration.md).
const YAW_NOISE: f64 = 3.0;
/// Least noise of the camera's pitch and roll, as a share of the stated one, because a few blocks have much more noise than the others.
/// In a simulated hour (docs/calibration.md) the largest false changes of both had 3.7 and 3.6 standard deviations; with a least noise
/// of 0.15 that of the pitch had 5.0. With the expected noise of 0.5 ([`CAMERA`]), 1 degree of pitch was named in nine of fourteen
/// stretches of that hour, with 1.0 in none.
const LEAST_PITCH_NOISE: f64 = 0.2;
const LEAST_ROLL_NOISE: f64 = 0.4;

/// Wheels: rad/m, share, share. 5 % of error are known of real robots (localization); a change of 1 % of one wheel of the default
/// robot is 0.042 rad/m. The stated noise of the wheels is twice that of a good base ([`LocalizationConfig`]). In 120 minutes of simulated
/// driving without a change the largest false ones had 3.9, 3.6 and 4.7 standard deviations.
const WHEELS: Limits<3> = Limits {
    expected: [0.05, 0.03, 0.02],
    noise: [0.5; 3],
    least_noise: [LEAST_NOISE; 3],
    least: [0.01, 0.01, 0.004],
    sigmas: 5.5,
};
/// Scanner: rad, m, m.
const LIDAR: Limits<3> = Limits {
    expected: [0.05, 0.03, 0.03],
    noise: [0.5; 3],
    least_noise: [LEAST_NOISE; 3],
    least: [0.006, 0.01, 0.01],
    sigmas: 6.0,
};

/// Camera: pitch, yaw, roll, rad.
const CAMERA: Limits<3> = Limits {
    expected: [0.05, 0.05, 0.05],
    noise: [0.5, YAW_NOISE, 0.5],
    least_noise: [LEAST_PITCH_NOISE, YAW_NOISE, LEAST_ROLL_NOISE],
    least: [0.007, 0.007, 0.007],
    sigmas: 6.0,
};
/// Latency of the camera, s.
const LATENCY: Limits<1> = Limits {
    expected: [0.03],
    noise: [1.0],
    least_noise: [LEAST_NOISE],
    least: [0.004],
    sigmas: 6.0,
};

const WHEEL_PARTS: [Watched; 3] =
    [Watched::WheelHeading, Watched::WheelTrack, Watched::WheelDistance];
const LIDAR_PARTS: [Watched; 3] = [Watched::LidarYaw, Watched::LidarForward, Watched::LidarLeft];
const CAMERA_PARTS: [Watched; 3] = [Watched::CameraPitch, Watched::CameraYaw, Watched::CameraRoll];
/// A scanner whose yaw is suspected of a change by this many standard deviations may be why the camera seems to have turned: the
/// camera is compared with the pose by scans.
const SUSPECTED: f64 = 3.0;
/// The camera's mount is known well enough to confirm or withdraw a report when this many of its standard deviations are smaller than
/// what matters.
const CONFIRMED: f64 = 3.0;
/// The wheels are not waited for any longer after this many blocks, most of the window: the camera is said to be late. With 20 of them,
/// two of 20 robots with a late scanner named the camera first, with 36 one (docs/calibration.md).
const UNDECIDED_BLOCKS: usize = 36;
/// The changes of the first ten parameters are in the part of the memory that old snapshots have.
const OLD_PARAMETERS: usize = Watched::LidarLatency as usize;

/// Watches the calibration of one robot.
#[derive(Debug, Default)]
pub struct CalibrationWatch {
    wheels: ChangeTest<3>,
    lidar: ChangeTest<3>,
    camera: ChangeTest<3>,
    latency: ChangeTest<1>,
    scanner_time: ScannerTime,
    last_odom: Option<Pose2>,
    driven_m: f64,
    /// Distance that the rim of a wheel has rolled in the current block, metres.
    rolled_m: f64,
    begin: Begin,
    /// The last change of each parameter, but for the latencies of scanner and wheels, which are in `late`.
    changes: [Option<Change>; OLD_PARAMETERS],
    late: [Option<Change>; 2],
    camera_report: Option<CameraReport>,
    /// Sums of earlier changes of the camera's pitch, yaw and roll, which cannot be confirmed any more, rad.
    camera_turned: [f64; 3],
}

// Not what snapshots of layout 12 and before do not have.
remembers!(CalibrationWatch: wheels, lidar, camera, latency, last_odom, driven_m, rolled_m, begin, changes, camera_turned);

impl CalibrationWatch {
    /// The last change of each parameter that has changed in this run.
    pub fn changes(&self) -> impl Iterator<Item = &Change> {
        self.changes.iter().chain(&self.late).flatten()
    }

    /// How far the camera was turned in this run, as far as it was noticed, rad.
    pub fn camera_turned_rad(&self) -> f64 {
        let reported = self.camera_report.map_or([None; 3], |report| report.turned);
        let turned = self.camera_turned.iter().zip(reported);
        turned.map(|(earlier, now)| (earlier + now.unwrap_or(0.0)).powi(2)).sum::<f64>().sqrt()
    }

    /// Every parameter as the last metres show it: its value less the configured one.
    pub fn measured(&self) -> impl Iterator<Item = Measured> {
        Watched::ALL.into_iter().filter_map(|what| {
            let index = what as usize;
            let (value, sigma) = match what {
                Watched::WheelHeading | Watched::WheelTrack | Watched::WheelDistance => {
                    self.wheels.estimate(index, &WHEELS)?
                }
                Watched::LidarYaw | Watched::LidarForward | Watched::LidarLeft => {
                    self.lidar.estimate(index - 3, &LIDAR)?
                }
                Watched::CameraPitch | Watched::CameraYaw | Watched::CameraRoll => {
                    self.camera.estimate(index - 6, &CAMERA)?
                }
                Watched::CameraLatency => self.latency.estimate(0, &LATENCY)?,
                Watched::LidarLatency => self.scanner_time.estimate()?,
                // Wheels are not compared with another clock than the scanner's.
                Watched::WheelLatency => return None,
            };
            Some(Measured { what, value, sigma })
        })
    }

    /// Takes the stretch of the drive that a scan ended.
    pub(crate) fn see_leg(&mut self, leg: &DrivenLeg, config: &LocalizationConfig) {
        self.wheels.add(&leg_equations::wheels(leg, config), &WHEELS);
        self.lidar.add(&leg_equations::scanner(leg, config), &LIDAR);
    }

    /// Takes the scan of a tick; `None` when it did not fit.
    pub(crate) fn see_scan(&mut self, scan: Option<MatchedScan>, config: &LocalizationConfig) {
        self.scanner_time.see(scan, config);
    }

    /// Takes what a frame says of the camera's mount.
    pub(crate) fn see_camera(&mut self, mount: &Sums<3>) {
        self.camera.add(mount, &CAMERA);
    }

    /// Takes what a frame says of the camera's latency.
    pub(crate) fn see_latency(&mut self, latency: &Sums<1>) {
        self.latency.add(latency, &LATENCY);
    }

    /// The robot is at `odom` by its wheels. Returns a change when it is found, and when it is withdrawn.
    pub(crate) fn advance(&mut self, odom: &Pose2, time_ns: u64) -> Option<Report> {
        let step = self.last_odom.map_or(Pose2::IDENTITY, |last| last.inverse().compose(odom));
        self.last_odom = Some(*odom);
        let step_m = step.x_m.hypot(step.y_m);
        if step_m > LARGEST_STEP || step.yaw_rad.abs() > LARGEST_STEP {
            return None;
        }
        self.driven_m += step_m;
        self.rolled_m += step_m + RIM_M_PER_RAD * step.yaw_rad.abs();
        if self.rolled_m < BLOCK_M {
            return None;
        }
        self.rolled_m = 0.0;
        let next = Begin { driven_m: self.driven_m, time_ns };
        let begin = std::mem::replace(&mut self.begin, next);
        if let Some(change) = self.end_block(begin) {
            *self.last_change(change.what) = Some(change);
            return Some(Report::Changed(change));
        }
        let withdrawal = self.confirm_camera()?;
        *self.last_change(withdrawal.what) = None;
        Some(Report::Withdrawn(withdrawal))
    }

    fn last_change(&mut self, what: Watched) -> &mut Option<Change> {
        match what {
            Watched::LidarLatency => &mut self.late[0],
            Watched::WheelLatency => &mut self.late[1],
            _ => &mut self.changes[what as usize],
        }
    }

    fn end_block(&mut self, begin: Begin) -> Option<Change> {
        self.wheels.end_block(begin, &WHEELS);
        self.lidar.end_block(begin, &LIDAR);
        self.camera.end_block(begin, &CAMERA);
        self.latency.end_block(begin, &LATENCY);
        self.scanner_time.end_block(begin);
        if let Some(found) = self.lidar.find(&LIDAR) {
            self.lidar.restart();
            self.camera.restart();
            self.settle_camera();
            return Some(change(&found, &LIDAR_PARTS));
        }
        if let Some(found) = self.wheels.find(&WHEELS) {
            self.wheels.restart();
            return Some(change(&found, &WHEEL_PARTS));
        }
        if self.lidar.suspicion(0, &LIDAR) < SUSPECTED
            && let Some(found) = self.camera.find(&CAMERA)
        {
            self.note_camera(&found);
            self.camera.restart();
            return Some(change(&found, &CAMERA_PARTS));
        }
        self.find_latency()
    }

    fn note_camera(&mut self, found: &Found) {
        let before = self.camera.known_before(found.begin, &CAMERA);
        let first = before.map(|before| CameraReport { before, turned: [None; 3] });
        self.camera_report = self.camera_report.or(first);
        match &mut self.camera_report {
            Some(report) => *report.turned[found.index].get_or_insert(0.0) += found.by,
            None => self.camera_turned[found.index] += found.by,
        }
    }

    /// The camera is compared with a scanner that has changed: what was reported of the camera stays as it is.
    fn settle_camera(&mut self) {
        let Some(report) = self.camera_report.take() else { return };
        for (sum, turned) in self.camera_turned.iter_mut().zip(report.turned) {
            *sum += turned.unwrap_or(0.0);
        }
    }

    /// Compares the camera with its mount before the changes that were reported, as soon as enough blocks came after the last one. If
    /// it is there, it was not turned, or was turned back: the report is withdrawn, so that one wrong report does not keep the
    /// camera's depth out of the map for the rest of the run. Else it is turned by what is measured now, because a large change is
    /// first reported as smaller than it is.
    fn confirm_camera(&mut self) -> Option<Withdrawal> {
        let [now, now_sigma] = self.camera.known(&CAMERA)?;
        if self.lidar.suspicion(0, &LIDAR) >= SUSPECTED {
            return None;
        }
        let CameraReport { before: [before, before_sigma], turned } =
            self.camera_report.as_mut()?;
        for (index, turned) in turned.iter_mut().enumerate().filter(|(_, turned)| turned.is_some())
        {
            let what = CAMERA_PARTS[index];
            let still = now[index] - before[index];
            let sigma = now_sigma[index].hypot(before_sigma[index]);
            let least = CAMERA.least[index];
            if still.abs() < least && CONFIRMED * sigma < least {
                *turned = None;
                return Some(Withdrawal { what, still, sigma });
            }
            if CONFIRMED * sigma < still.abs() {
                *turned = Some(still);
                if let Some(change) = &mut self.changes[what as usize] {
                    change.by = still;
                    change.sigma = sigma;
                }
            }
        }
        None
    }

    /// A change of the time stamps. Scans are compared with the wheels, and frames with the scans: two of the three clocks agree.
    fn find_latency(&mut self) -> Option<Change> {
        if let Some(found) = self.scanner_time.find() {
            // Late scans make frames seem early by as much; late wheels do not.
            let frames = self.latency.change_since(found.begin, 0, &LATENCY);
            let is_scanner = frames.and_then(|frames| is_rather(frames, -found.by, found.sigma));
            self.scanner_time.restart();
            self.latency.restart();
            if is_scanner == Some(false) {
                return Some(change(&opposite(&found), &[Watched::WheelLatency]));
            }
            return Some(change(&found, &[Watched::LidarLatency]));
        }
        let found = self.latency.find(&LATENCY)?;
        let scans = self.scanner_time.change_since(found.begin);
        match scans.and_then(|scans| is_rather(scans, -found.by, found.sigma)) {
            Some(true) => {
                self.scanner_time.restart();
                self.latency.restart();
                return Some(change(&opposite(&found), &[Watched::LidarLatency]));
            }
            None if self.waits_for_wheels(&found) => return None,
            Some(false) | None => {}
        }
        self.latency.restart();
        Some(change(&found, &[Watched::CameraLatency]))
    }

    /// Whether the wheels may still say if a change between frames and scans is one of the scans.
    fn waits_for_wheels(&self, found: &Found) -> bool {
        let blocks = self.latency.blocks_since(found.begin).unwrap_or(UNDECIDED_BLOCKS);
        self.scanner_time.has_equations() && blocks < UNDECIDED_BLOCKS
    }

    /// The part of the memory that snapshots of layout 12 and before do not have.
    pub(crate) fn write_layout_13(&self, to: &mut Vec<u8>) {
        self.scanner_time.write(to);
        self.late.write(to);
        self.camera_report.write(to);
    }

    /// Restores what [`write_layout_13`](Self::write_layout_13) wrote.
    pub(crate) fn read_layout_13(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.scanner_time.read(from)?;
        self.late.read(from)?;
        self.camera_report.read(from)
    }

    /// Nothing is known of this part: the snapshot that was read does not have it.
    pub(crate) fn forget_layout_13(&mut self) {
        self.scanner_time = ScannerTime::default();
        self.late = [None; 2];
        self.camera_report = None;
    }
}

/// What the same change is of the other one of two clocks.
fn opposite(found: &Found) -> Found {
    Found { by: -found.by, ..*found }
}

fn change(found: &Found, parts: &[Watched]) -> Change {
    let Found { index, by, sigma, begin, manner } = *found;
    Change {
        what: parts[index],
        by,
        sigma,
        since_m: begin.driven_m,
        since_ns: begin.time_ns,
        manner,
    }
}
