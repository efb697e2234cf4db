//! Where the scanner is connected, and how it is mounted.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::HokuyoError;
use crate::scip::Model;

/// The port on which the Ethernet models listen (UST-10LX, communication protocol specification).
const TCP_PORT: u16 = 10_940;

/// What the scanner is connected by: `/dev/serial/by-id/...` or `tcp:192.168.0.10:10940`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Port {
    /// A serial port or USB CDC-ACM device. Use a path that stays the same when the device is plugged in again.
    Serial(PathBuf),
    /// An Ethernet model.
    Tcp {
        /// Address or name.
        host: String,
        /// Port, 10940 unless somebody changed it.
        port: u16,
    },
}

/// A Hokuyo scanner as configured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HokuyoConfig {
    /// What it is connected by.
    pub port: Port,
    /// Which model it is. Another one is refused, because its beams would be misunderstood.
    pub model: Model,
    /// Bits a second on RS-232; USB and Ethernet do not care.
    pub baud: u32,
    /// Whether it hangs upside down, so that its beams run the other way.
    pub upside_down: bool,
    /// Good scans in a row before it counts as alive, after each time that it was not.
    pub good_scans: u32,
}

impl Default for HokuyoConfig {
    /// The first USB scanner of a computer that has one.
    fn default() -> Self {
        Self::new(Port::Serial("/dev/ttyACM0".into()))
    }
}

impl HokuyoConfig {
    /// A UTM-30LX, upright.
    #[must_use]
    pub fn new(port: Port) -> Self {
        Self { port, model: Model::default(), baud: 115_200, upside_down: false, good_scans: 3 }
    }

    /// Refuses what cannot work.
    ///
    /// # Errors
    /// [`HokuyoError::Config`] with the value and its limits.
    pub fn validate(&self) -> Result<(), HokuyoError> {
        let refuse = |what: String| Err(HokuyoError::Config { what });
        if !(1..=100).contains(&self.good_scans) {
            return refuse(format!("good_scans = {}: must be 1 to 100", self.good_scans));
        }
        if !(9_600..=4_000_000).contains(&self.baud) {
            return refuse(format!(
                "baud = {}: must be 9600 to 4000000; the URG-04LX starts with 19200",
                self.baud
            ));
        }
        Ok(())
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(path) => write!(f, "{}", path.display()),
            Self::Tcp { host, port } => write!(f, "tcp:{host}:{port}"),
        }
    }
}

impl FromStr for Port {
    type Err = HokuyoError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || HokuyoError::Config {
            what: format!(
                "port = `{text}`: must be a path like /dev/serial/by-id/... or tcp:HOST or tcp:HOST:PORT"
            ),
        };
        let Some(address) = text.strip_prefix("tcp:") else {
            return if text.starts_with('/') {
                Ok(Self::Serial(text.into()))
            } else {
                Err(wrong())
            };
        };
        let (host, port) = match address.rsplit_once(':') {
            Some((host, port)) => (host, port.parse().map_err(|_| wrong())?),
            None => (address, TCP_PORT),
        };
        if host.is_empty() { Err(wrong()) } else { Ok(Self::Tcp { host: host.to_owned(), port }) }
    }
}

impl TryFrom<String> for Port {
    type Error = HokuyoError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Port> for String {
    fn from(port: Port) -> Self {
        port.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_paths_or_addresses_and_come_back_as_they_were_written() {
        for text in ["/dev/serial/by-id/usb-Hokuyo", "tcp:192.168.0.10:10940", "tcp:localhost:7"] {
            assert_eq!(text.parse::<Port>().unwrap().to_string(), text);
        }
        assert_eq!("tcp:robot".parse::<Port>().unwrap().to_string(), "tcp:robot:10940");
        for text in ["", "ttyACM0", "tcp:", "tcp::7", "tcp:robot:lidar", "tcp:robot:99999"] {
            assert!(
                text.parse::<Port>().unwrap_err().to_string().contains("/dev/serial/by-id"),
                "{text}"
            );
        }
    }

    #[test]
    fn a_configuration_needs_no_more_than_a_port() {
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
    fn values_that_cannot_work_are_refused_with_their_limits() {
        let config = HokuyoConfig::new("/dev/lidar".parse().unwrap());
        assert!(config.validate().is_ok());
        let error = HokuyoConfig { good_scans: 0, ..config.clone() }.validate().unwrap_err();
        assert!(error.to_string().contains("1 to 100"));
        assert!(HokuyoConfig { baud: 300, ..config }.validate().is_err());
    }
}
