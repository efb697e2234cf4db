//! Configuration of a Hokuyo scanner.

use hal::settings::OutOfRange;

use super::HokuyoError;
use crate::scanner::{Port, PortError};
use crate::scip::Model;

hal::choices!(Model: "urg-04lx", "utm-30lx", "ust-10lx", "ust-20lx");

hal::settings! {
    /// The safety LiDAR: a Hokuyo scanner, by SCIP 2.
    #[derive(Eq)]
    pub struct HokuyoConfig {
        /// Connection: `/dev/serial/by-id/...`, which stays the same after the scanner was unplugged, or
        /// `tcp:192.168.0.10:10940`.
        port: Port = Port::Serial("/dev/ttyACM0".into());
        /// Model of the scanner. Another model is refused, because its beams would be misinterpreted.
        model: Model = Model::default();
        /// Bit rate of RS-232. USB and Ethernet ignore it. The URG-04LX starts with 19200.
        baud: u32 = 115200, in 9600..=4000000, unit "bit/s";
        /// Whether the scanner is mounted upside down, so that its beams run in the opposite direction.
        upside_down: bool = false;
        /// Consecutive valid scans that are needed before the scanner counts as working, at the start and after each fault.
        good_scans: u32 = 3, in 1..=100, unit "scans";
    }
}

impl From<OutOfRange> for HokuyoError {
    fn from(error: OutOfRange) -> Self {
        Self::Config { what: error.to_string() }
    }
}

impl From<PortError> for HokuyoError {
    fn from(error: PortError) -> Self {
        Self::Config { what: error.to_string() }
    }
}

impl HokuyoConfig {
    /// A UTM-30LX that is mounted upright.
    #[must_use]
    pub fn new(port: Port) -> Self {
        Self { port, ..Self::default() }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`HokuyoError::Config`] with the value and its range.
    pub fn validate(&self) -> Result<(), HokuyoError> {
        Ok(self.check_ranges()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_a_complete_configuration() {
        let config: HokuyoConfig = toml::from_str("port = \"/dev/lidar\"").unwrap();
        assert_eq!(config, HokuyoConfig::new("/dev/lidar".parse().unwrap()));
        let config: HokuyoConfig =
            toml::from_str("port = \"tcp:10.0.0.2\"\nmodel = \"ust-20lx\"\nupside_down = true")
                .unwrap();
        assert_eq!((config.model, config.upside_down), (Model::Ust20lx, true));
        assert!(
            toml::from_str::<HokuyoConfig>("port = \"/dev/lidar\"\nupsidedown = true").is_err()
        );
    }

    #[test]
    fn values_out_of_range_are_refused_with_the_range() {
        let config = HokuyoConfig::new("/dev/lidar".parse().unwrap());
        assert!(config.validate().is_ok());
        let error = HokuyoConfig { good_scans: 0, ..config.clone() }.validate().unwrap_err();
        assert!(error.to_string().contains("1 to 100"));
        assert!(HokuyoConfig { baud: 300, ..config }.validate().is_err());
    }
}
