//! Where a scanner is connected.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use hal::settings::{ConfigValue, Kind};
use serde::{Deserialize, Serialize};

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

/// A text that is not the connection of a scanner.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("port = `{text}`: must be a path like /dev/serial/by-id/... or tcp:HOST or tcp:HOST:PORT")]
pub struct PortError {
    text: String,
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
    type Err = PortError;

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

fn not_a_port(text: &str) -> PortError {
    PortError { text: text.to_owned() }
}

impl TryFrom<String> for Port {
    type Error = PortError;

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
}
