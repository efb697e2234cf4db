//! The configuration of a robot's scanner.

use hal::ScanGeometry;
use serde::{Deserialize, Serialize};

use super::AnyLidarError;
use crate::hokuyo::{HokuyoConfig, HokuyoError};
use crate::ld06::{ACCURACY_M, Ld06Config};
use crate::rotary::{Mount, Place, SLOWER};
use crate::rplidar::RplidarConfig;
use crate::scanner::Port;
use crate::scip::Model;

/// The kinds of scanners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarKind {
    #[default]
    Hokuyo,
    Rplidar,
    /// LD06 and LD19.
    Ld06,
}

hal::choices!(LidarKind: "hokuyo", "rplidar", "ld06");

/// Bytes wait in a USB serial adapter for up to 16 ms, and in the computer for a few more.
const CABLE_S: f64 = 0.03;

hal::settings! {
    /// The safety LiDAR: a Hokuyo scanner (SCIP 2), a Slamtec RPLIDAR, or an LDROBOT LD06 or LD19.
    pub struct LidarConfig {
        /// Kind of the scanner.
        kind: LidarKind = LidarKind::default();
        /// Connection: `/dev/serial/by-id/...`, which stays the same after the scanner was unplugged, or
        /// `tcp:192.168.0.10:10940`.
        port: Port = Port::Serial("/dev/ttyACM0".into());
        /// Model of a Hokuyo scanner. Another model is refused, because its beams would be misinterpreted.
        model: Model = Model::default();
        /// Bit rate of a Hokuyo scanner on RS-232. USB and Ethernet ignore it. The URG-04LX starts with 19200.
        baud: u32 = 115200, in 9600..=4000000, unit "bit/s";
        /// Whether the scanner is mounted upside down, so that its beams run in the opposite direction.
        upside_down: bool = false;
        /// Direction in which the zero of an RPLIDAR, LD06 or LD19 points, counter-clockwise from forward as seen from above. The driver makes
        /// it the scanner's front, so that a revolution begins behind the robot; `lidar.yaw_deg` is what remains.
        zero_deg: f64 = 0.0, in -180.0..=180.0, unit "degrees";
        /// Time from a scan to its timestamp: what the scanner and the cable add. It is subtracted from every timestamp. The
        /// safety plane counts it into its reaction time, and adds it to `safety.scan_timeout_s`. `firmware-host calibrate` measures it.
        latency_ms: f64 = 0.0, in 0.0..=250.0, unit "ms";
        /// Consecutive valid scans that are needed before the scanner counts as working, at the start and after each fault.
        good_scans: u32 = 3, in 1..=100, unit "scans";
        rplidar: RplidarConfig;
        ld06: Ld06Config;
    }
}

impl LidarConfig {
    /// The configuration of the driver for Hokuyo scanners.
    #[must_use]
    pub fn hokuyo(&self) -> HokuyoConfig {
        HokuyoConfig {
            port: self.port.clone(),
            model: self.model,
            baud: self.baud,
            upside_down: self.upside_down,
            good_scans: self.good_scans,
        }
    }

    /// How a rotating scanner is mounted.
    fn mount(&self) -> Mount {
        Mount { zero_rad: self.zero_deg.to_radians(), upside_down: self.upside_down }
    }

    /// Connection and mount for the drivers of rotating scanners.
    #[must_use]
    pub fn place(&self) -> Place {
        Place { port: self.port.clone(), mount: self.mount(), good_scans: self.good_scans }
    }

    /// The scanner's name in messages.
    #[must_use]
    pub fn name(&self) -> String {
        match self.kind {
            LidarKind::Hokuyo => self.model.to_string(),
            LidarKind::Rplidar => self.rplidar.model.spec().name.to_owned(),
            LidarKind::Ld06 => "LD06".to_owned(),
        }
    }

    /// The geometry of the scans.
    #[must_use]
    pub fn geometry(&self) -> ScanGeometry {
        match self.kind {
            LidarKind::Hokuyo => self.model.geometry(self.upside_down),
            LidarKind::Rplidar => self.mount().geometry(self.rplidar.geometry()),
            LidarKind::Ld06 => self.mount().geometry(self.ld06.geometry()),
        }
    }

    /// The longest time from the end of one scan to the end of the next while the scanner works,
    /// seconds. A slower scanner is a fault.
    #[must_use]
    pub fn longest_period_s(&self) -> f64 {
        let period_s = 1e-9 * self.geometry().period_ns as f64;
        match self.kind {
            LidarKind::Hokuyo => period_s,
            LidarKind::Rplidar | LidarKind::Ld06 => SLOWER * period_s,
        }
    }

    /// The time that the end of a scan takes to this program at most, seconds. A Hokuyo's scans have
    /// the scanner's own time. A measured latency is a mean, and the cable may add to it.
    #[must_use]
    pub fn arrival_s(&self) -> f64 {
        let cable_s = match self.kind {
            LidarKind::Hokuyo => 0.0,
            LidarKind::Rplidar | LidarKind::Ld06 => CABLE_S,
        };
        self.late_s() + cable_s
    }

    /// The time by which scans are known later than their corrected time stamps say, seconds.
    #[must_use]
    pub fn late_s(&self) -> f64 {
        1e-3 * self.latency_ms
    }

    /// Largest error of a distance near the robot, metres, from the scanner's data sheet, and at least
    /// that of the UTM-30LX: a data sheet is written for white paper.
    #[must_use]
    pub fn accuracy_m(&self) -> f64 {
        let of_this_scanner_m = match self.kind {
            LidarKind::Hokuyo => self.model.spec().accuracy_m,
            LidarKind::Rplidar => self.rplidar.model.spec().accuracy_m,
            LidarKind::Ld06 => ACCURACY_M,
        };
        of_this_scanner_m.max(Model::Utm30lx.spec().accuracy_m)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The value and its range.
    pub fn validate(&self) -> Result<(), AnyLidarError> {
        self.check_ranges().map_err(HokuyoError::from)?;
        if self.kind == LidarKind::Hokuyo && self.zero_deg.abs() > 0.0 {
            let what = format!(
                "`zero_deg = {}` is not for Hokuyo scanners: remove the key, and set `lidar.yaw_deg` for a \
                 scanner that is mounted turned",
                self.zero_deg
            );
            return Err(HokuyoError::Config { what }.into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> LidarConfig {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn a_file_from_before_there_were_kinds_means_the_same_hokuyo() {
        let config = parsed("port = \"/dev/lidar\"\nmodel = \"ust-10lx\"\nupside_down = true");
        assert_eq!(config.kind, LidarKind::Hokuyo);
        let alone: HokuyoConfig =
            toml::from_str("port = \"/dev/lidar\"\nmodel = \"ust-10lx\"\nupside_down = true")
                .unwrap();
        assert_eq!(config.hokuyo(), alone);
        assert_eq!(config.geometry(), alone.model.geometry(true));
    }

    #[test]
    fn each_kind_has_its_own_geometry_and_name() {
        let rplidar = parsed("kind = \"rplidar\"\nzero_deg = 180.0\n[rplidar]\nmodel = \"a2\"");
        assert_eq!((rplidar.name().as_str(), rplidar.geometry().beams), ("RPLIDAR A2", 360));
        assert!((rplidar.place().mount.zero_rad - std::f64::consts::PI).abs() < 1e-12);
        let ld06 = parsed("kind = \"ld06\"");
        assert_eq!((ld06.name().as_str(), ld06.geometry().beams), ("LD06", 400));
        assert!((ld06.longest_period_s() - 0.115).abs() < 1e-12);
        assert!((parsed("").longest_period_s() - 0.025).abs() < 1e-12);
    }

    #[test]
    fn a_value_of_any_kind_that_is_out_of_range_is_refused_by_name() {
        let config = parsed("kind = \"rplidar\"\n[ld06]\nrotation_hz = 40.0");
        assert!(config.validate().unwrap_err().to_string().contains("rotation_hz"));
        let turned = parsed("zero_deg = 90.0").validate().unwrap_err().to_string();
        assert!(turned.contains("zero_deg = 90") && turned.contains("remove the key"), "{turned}");
    }
}
