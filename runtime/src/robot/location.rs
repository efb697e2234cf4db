//! Where the robot is during a tick, from wheels and scans.

use hal::{LaserScan, Pose2, ScanGeometry, Twist2, WheelFeedback};
use serde::{Deserialize, Serialize};

use crate::localization::{
    DrivenLeg, Estimate, Gyroscope, Joined, LocalizationConfig, LocalizationError, Localizer,
    LostReason, PoseSource, WheelError, Whereabouts,
};
use crate::snapshot::{SnapshotError, State};
use crate::tick::TickInput;

/// Poses of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TickPoses {
    /// Pose at the time of the tick's wheel feedback, in `odom`: smooth, never jumps.
    pub t_odom_base: Pose2,
    /// Pose when the frame was exposed, in `odom`. Depth is made from it.
    pub t_odom_base_at_frame: Pose2,
    /// Pose of `odom` in `map`, the frame of map, path and goals.
    pub t_map_odom: Pose2,
    /// Pose at the middle of the scan, in `odom`.
    pub t_odom_base_at_scan: Pose2,
}

impl TickPoses {
    /// Before the first tick.
    pub(super) const START: Self = Self {
        t_odom_base: Pose2::IDENTITY,
        t_odom_base_at_frame: Pose2::IDENTITY,
        t_map_odom: Pose2::IDENTITY,
        t_odom_base_at_scan: Pose2::IDENTITY,
    };

    /// Pose at the time of the tick's wheel feedback, in `map`.
    #[must_use]
    pub fn t_map_base(&self) -> Pose2 {
        self.t_map_odom.compose(&self.t_odom_base)
    }

    /// Pose when the frame was exposed, in `map`.
    #[must_use]
    pub fn t_map_base_at_frame(&self) -> Pose2 {
        self.t_map_odom.compose(&self.t_odom_base_at_frame)
    }
}

/// What localization made of a tick.
#[derive(Debug, Clone, Copy)]
pub(super) struct Located {
    pub poses: TickPoses,
    /// Velocity between the last two reports of wheels and gyroscope; with wheels alone that which they report.
    pub twist: Twist2,
    /// Whether `t_map_odom` is known.
    pub whereabouts: Whereabouts,
    pub wheel_error: Option<WheelError>,
    /// The gyroscope is not used any more, since this tick.
    pub gyro_refused: bool,
    /// The stretch of the drive that this tick's scan ended, if it ended one.
    pub leg: Option<DrivenLeg>,
    /// `t_odom_base` at this tick's scan, if the scan fits.
    pub matched_scan: Option<Pose2>,
    /// Two maps have become one, in this tick.
    pub joined: Option<Joined>,
}

impl Located {
    fn by_wheels(wheel: &WheelFeedback, at_scan: Pose2) -> Self {
        let poses = TickPoses {
            t_odom_base: wheel.odom,
            t_odom_base_at_frame: wheel.odom,
            t_map_odom: Pose2::IDENTITY,
            t_odom_base_at_scan: at_scan,
        };
        Self {
            poses,
            twist: wheel.twist,
            whereabouts: Whereabouts::Localized,
            wheel_error: None,
            gyro_refused: false,
            leg: None,
            matched_scan: None,
            joined: None,
        }
    }
}

/// Localization within the robot. The localizer is made for the first scan that comes; before it, and without a scanner, the
/// wheels give the pose.
pub(super) struct Location {
    config: LocalizationConfig,
    t_base_laser: Pose2,
    localizer: Option<Localizer>,
    geometry: Option<Geometry>,
    /// `t_odom_base` when the localizer was made: its own first pose is the identity.
    origin: Pose2,
}

impl Location {
    /// # Errors
    /// A configuration that is out of range.
    pub(super) fn new(
        config: LocalizationConfig,
        t_base_laser: Pose2,
    ) -> Result<Self, LocalizationError> {
        config.validate()?;
        let localizer = None;
        Ok(Self { config, t_base_laser, localizer, geometry: None, origin: Pose2::IDENTITY })
    }

    /// The poses of a tick whose wheel odometry is finite. `scan` is sound, or absent.
    pub(super) fn update(&mut self, input: &TickInput<'_>, scan: Option<&LaserScan>) -> Located {
        let wheel = input.wheel.odom;
        if self.config.source == PoseSource::Wheels {
            return Located::by_wheels(&input.wheel, input.scan_odom);
        }
        if self.localizer.is_none()
            && let Some(scan) = scan
        {
            self.start(&scan.geometry, wheel);
        }
        let Some(localizer) = &mut self.localizer else {
            return Located::by_wheels(&input.wheel, wheel);
        };
        let scan = scan.map(|scan| (scan, &input.scan_odom));
        let imu = input.imu.as_ref();
        let estimate = localizer.update_with_imu(&wheel, input.wheel.time_ns, scan, imu);
        Located {
            poses: self.poses(&estimate),
            twist: estimate.twist,
            whereabouts: estimate.whereabouts,
            wheel_error: estimate.wheel_error,
            gyro_refused: estimate.gyro_refused,
            leg: estimate.leg,
            matched_scan: estimate.t_odom_base_at_scan.filter(|_| estimate.matched),
            joined: estimate.joined.map(|joined| Joined {
                correction: self.origin.compose(&joined.correction).compose(&self.origin.inverse()),
                ..joined
            }),
        }
    }

    fn poses(&self, estimate: &Estimate) -> TickPoses {
        let t_odom_base = self.origin.compose(&estimate.t_odom_base);
        let at_scan = estimate.t_odom_base_at_scan;
        TickPoses {
            t_odom_base,
            t_odom_base_at_frame: t_odom_base,
            t_map_odom: self.origin.compose(&estimate.t_map_odom).compose(&self.origin.inverse()),
            t_odom_base_at_scan: at_scan.map_or(t_odom_base, |pose| self.origin.compose(&pose)),
        }
    }

    /// See [`Localizer::lose`]. Without a localizer there is no map yet.
    pub(super) fn lose(&mut self, why: LostReason) {
        if let Some(localizer) = &mut self.localizer {
            localizer.lose(why);
        }
    }

    /// See [`Localizer::begin_map`].
    pub(super) fn begin_map(&mut self) {
        if let Some(localizer) = &mut self.localizer {
            localizer.begin_map();
        }
    }

    /// See [`Localizer::stay_in_map`].
    pub(super) fn stay_in_map(&mut self, stays: bool) {
        if let Some(localizer) = &mut self.localizer {
            localizer.stay_in_map(stays);
        }
    }

    /// Whether a scan did not fit a moment ago.
    pub(super) fn is_doubtful(&self) -> bool {
        self.localizer.as_ref().is_some_and(Localizer::is_doubtful)
    }

    /// The numbers of all maps, in order.
    pub(super) fn maps(&self) -> Vec<u16> {
        self.localizer.as_ref().map_or(Vec::new(), |localizer| localizer.map_numbers().collect())
    }

    /// Number of the map that the robot is in.
    pub(super) fn map(&self) -> u16 {
        self.localizer.as_ref().map_or(0, Localizer::map)
    }

    /// Number of the map that a submap belongs to.
    pub(super) fn map_of(&self, submap: usize) -> u16 {
        self.localizer.as_ref().map_or(0, |localizer| localizer.map_of(submap))
    }

    /// Pose of `odom` in `map`, as corrected so far.
    pub(super) fn t_map_odom(&self) -> Pose2 {
        let estimate = self.localizer.as_ref().map(Localizer::estimate);
        estimate.map_or(Pose2::IDENTITY, |estimate| self.poses(&estimate).t_map_odom)
    }

    /// Standard deviations of the position, metres, and of the yaw, radians, against the scans of the last metres. `None` before
    /// the first scan.
    pub(super) fn pose_std(&self) -> Option<[f64; 2]> {
        let covariance = self.localizer.as_ref()?.estimate().covariance;
        let position_m = (covariance[(0, 0)] + covariance[(1, 1)]).max(0.0).sqrt();
        Some([position_m, covariance[(2, 2)].max(0.0).sqrt()])
    }

    /// What was learnt of the gyroscope; `None` before the first scan.
    pub(super) fn gyroscope(&self) -> Option<Gyroscope> {
        self.localizer.as_ref().map(Localizer::gyroscope)
    }

    /// The scanner that localization was made for.
    pub(super) fn scanner(&self) -> Option<Geometry> {
        self.geometry
    }

    /// Index of the submap that the robot is in.
    pub(super) fn submap(&self) -> usize {
        self.localizer.as_ref().map_or(0, Localizer::submap)
    }

    /// Pose of a submap in `odom`: fixed once the submap exists.
    pub(super) fn submap_in_odom(&self, submap: usize) -> Option<Pose2> {
        let pose = self.localizer.as_ref()?.submap_in_odom(submap)?;
        Some(self.origin.compose(&pose))
    }

    /// Pose of a submap in `map`, as corrected so far.
    pub(super) fn submap_in_map(&self, submap: usize) -> Option<Pose2> {
        let pose = self.localizer.as_ref()?.submap_in_map(submap)?;
        Some(self.origin.compose(&pose))
    }

    /// Counts the corrections of the path.
    pub(super) fn revision(&self) -> u64 {
        self.localizer.as_ref().map_or(0, Localizer::revision)
    }

    /// The memory of the gyroscope, which is in snapshots and not in saved maps.
    pub(super) fn write_gyro(&self, to: &mut Vec<u8>) {
        if let Some(localizer) = &self.localizer {
            localizer.write_gyro(to);
        }
    }

    /// Restores what [`write_gyro`](Self::write_gyro) wrote, after the rest of the memory.
    pub(super) fn read_gyro(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.localizer.as_mut().map_or(Ok(()), |localizer| localizer.read_gyro(from))
    }

    /// What robots with several maps remember, in snapshots and saved maps.
    pub(super) fn write_layout_14(&self, to: &mut Vec<u8>) {
        if let Some(localizer) = &self.localizer {
            localizer.write_layout_14(to);
        }
    }

    /// Restores what [`write_layout_14`](Self::write_layout_14) wrote, after the rest of the memory.
    pub(super) fn read_layout_14(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.localizer.as_mut().map_or(Ok(()), |localizer| localizer.read_layout_14(from))
    }

    /// A scanner that cannot localize (too few beams) leaves the robot to its wheels.
    fn start(&mut self, geometry: &ScanGeometry, wheel: Pose2) {
        self.localizer = Localizer::new(&self.config, *geometry, self.t_base_laser).ok();
        if self.localizer.is_some() {
            self.geometry = Some(Geometry::from(geometry));
            self.origin = wheel;
        }
    }
}

/// The scanner that a localizer was made for, in a snapshot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Geometry {
    angle_min_rad: f64,
    angle_increment_rad: f64,
    beams: usize,
    range_min_m: f32,
    range_max_m: f32,
    period_ns: u64,
}

impl From<&ScanGeometry> for Geometry {
    fn from(geometry: &ScanGeometry) -> Self {
        Self {
            angle_min_rad: geometry.angle_min_rad,
            angle_increment_rad: geometry.angle_increment_rad,
            beams: geometry.beams,
            range_min_m: geometry.range_min_m,
            range_max_m: geometry.range_max_m,
            period_ns: geometry.period_ns,
        }
    }
}

/// Which way the scanner rotates is not among it: every scan says so.
impl From<Geometry> for ScanGeometry {
    fn from(geometry: Geometry) -> Self {
        Self {
            angle_min_rad: geometry.angle_min_rad,
            angle_increment_rad: geometry.angle_increment_rad,
            beams: geometry.beams,
            range_min_m: geometry.range_min_m,
            range_max_m: geometry.range_max_m,
            period_ns: geometry.period_ns,
            clockwise: false,
        }
    }
}

impl State for Location {
    fn write(&self, to: &mut Vec<u8>) {
        self.geometry.write(to);
        self.origin.write(to);
        if let Some(localizer) = &self.localizer {
            localizer.write(to);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.geometry.read(from)?;
        self.origin.read(from)?;
        self.localizer = None;
        let Some(geometry) = self.geometry else { return Ok(()) };
        let mut localizer = Localizer::new(&self.config, geometry.into(), self.t_base_laser);
        if let Ok(localizer) = &mut localizer {
            localizer.read(from)?;
        }
        self.localizer =
            Some(localizer.map_err(|error| SnapshotError::Damaged(error.to_string()))?);
        Ok(())
    }
}
