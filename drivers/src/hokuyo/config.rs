//! Configuration of a Hokuyo scanner.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use hal::settings::{ConfigValue, Kind, OutOfRange};
use serde::{Deserialize, Serialize};

use super::HokuyoError;
use crate::scip::Model;

/// The port on which the Ethernet models listen (UST-10LX, communication protocol specification).
const TCP_PORT: u16 = 10_940;

/// The connection to the scanner: `/dev/serial/by-id/...` or `tcp:192.168.0.10:10940`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Port {
    /// A serial port or USB CDC-ACM device. Use a path that stays the same after the device was unplugged.
    Serial(PathBuf),
    /// An Ethernet model at a TCP address.
    Tcp {
        /// Address or host name.
        host: String,
        /// TCP port; the scanners listen on 10940 unless it was changed.
        port: u16,
    },
}

impl ConfigValue for Port {
    const KIND: Kind = Kind::Text;
}

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
        let Some(address) = text.strip_prefix("tcp:") else {
            return if text.starts_with('/') {
                Ok(Self::Serial(text.into()))
            } else {
                Err(not_a_port(text))
            };
        };
        let (host, port) = match address.rsplit_once(':') {
            Some((host, port)) => (host, port.parse().map_err(|_| not_a_port(text))?),
            None => (address, TCP_PORT),
        };
        if host.is_empty() {
            return Err(not_a_port(text));
        }
        Ok(Self::Tcp { host: host.to_owned(), port })
    }
}

fn not_a_port(text: &str) -> HokuyoError {
    HokuyoError::Config {
        what: format!(
            "port = `{text}`: must be a path like /dev/serial/by-id/... or tcp:HOST or tcp:HOST:PORT"
        ),
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
    fn a_port_is_a_path_or_an_address_and_is_written_as_it_was_read() {
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
